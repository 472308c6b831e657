"""PX4 parameters: the real names, types and defaults of those that act on this vehicle or that clients ask for."""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass

INT32 = 6
"""MAV_PARAM_TYPE_INT32."""
REAL32 = 9
"""MAV_PARAM_TYPE_REAL32."""


class ParameterError(ValueError):
    """An unknown name or a value that is not allowed; the text names both and says what is."""


@dataclass(frozen=True)
class Parameter:
    """One parameter and the values it may take."""

    name: str
    default: float
    low: float
    high: float
    integer: bool = False
    among: tuple[int, ...] = ()
    """Allowed values of an enumeration; empty = all in [low, high]."""

    @property
    def mav_type(self) -> int:
        return INT32 if self.integer else REAL32

    def checked(self, value: float) -> float:
        """The value as it will be held (float32 or int32). Raises ParameterError."""
        allowed = f"one of {', '.join(map(str, self.among))}" if self.among else f"{self.low:g} to {self.high:g}"
        if not math.isfinite(value) or (self.integer and value != int(value)):
            raise ParameterError(f"parameter {self.name}: {value:g} is not allowed, {allowed} is")
        if (self.among and int(value) not in self.among) or not self.low <= value <= self.high:
            raise ParameterError(f"parameter {self.name}: {value:g} is not allowed, {allowed} is")
        return float(int(value)) if self.integer else float(struct.unpack("<f", struct.pack("<f", value))[0])


def _real(name: str, default: float, low: float, high: float) -> Parameter:
    return Parameter(name, default, low, high)


def _int(name: str, default: int, low: int, high: int, among: tuple[int, ...] = ()) -> Parameter:
    return Parameter(name, default, low, high, integer=True, among=among)


# Defaults as recorded from PX4 (tests compare them with the recording), except where a comment says otherwise.
_TABLE = (
    _real("BAT1_CAPACITY", 5000.0, 1.0, 100000.0),  # [mAh]; PX4: -1 = unknown, which could not drain
    _int("BAT1_N_CELLS", 4, 1, 24),
    _real("BAT1_V_CHARGED", 4.05, 2.0, 6.0),
    _real("BAT1_V_EMPTY", 3.6, 2.0, 6.0),
    _real("BAT_CRIT_THR", 0.07, 0.05, 0.5),
    _real("BAT_EMERGEN_THR", 0.05, 0.03, 0.5),
    _real("BAT_LOW_THR", 0.15, 0.12, 0.5),
    _int("CAL_ACC0_ID", 1310988, 0, 2**31 - 1),  # ground stations take 0 for "not calibrated"
    _int("CAL_GYRO0_ID", 1310988, 0, 2**31 - 1),
    _int("CAL_MAG0_ID", 197388, 0, 2**31 - 1),
    _real("COM_DISARM_LAND", 2.0, -1.0, 20.0),
    _real("COM_DISARM_PRFLT", 10.0, -1.0, 100.0),
    _real("COM_FAIL_ACT_T", 5.0, 0.0, 25.0),
    _int("COM_LOW_BAT_ACT", 0, 0, 3, among=(0, 2, 3)),  # PX4's default; its SIH airframe sets 3
    _int("COM_OBL_RC_ACT", 0, 0, 5, among=(0, 3, 4, 5)),
    _real("COM_OF_LOSS_T", 1.0, 0.1, 60.0),
    _real("COM_SPOOLUP_TIME", 1.0, 0.0, 30.0),
    _real("LNDMC_TRIG_TIME", 1.0, 0.1, 10.0),
    _int("MAV_COMP_ID", 1, 1, 1, among=(1,)),
    _int("MAV_SYS_ID", 1, 1, 250),
    _int("MAV_TYPE", 2, 0, 22),
    _real("MC_PITCHRATE_D", 0.003, 0.0, 0.05),
    _real("MC_PITCHRATE_I", 0.2, 0.0, 2.0),
    _real("MC_PITCHRATE_MAX", 220.0, 1.0, 1800.0),
    _real("MC_PITCHRATE_P", 0.15, 0.01, 0.6),
    _real("MC_PITCH_P", 6.5, 0.1, 12.0),
    _real("MC_PR_INT_LIM", 0.3, 0.0, 10.0),
    _real("MC_ROLLRATE_D", 0.003, 0.0, 0.05),
    _real("MC_ROLLRATE_I", 0.2, 0.0, 2.0),
    _real("MC_ROLLRATE_MAX", 220.0, 1.0, 1800.0),
    _real("MC_ROLLRATE_P", 0.15, 0.01, 0.6),
    _real("MC_ROLL_P", 6.5, 0.1, 12.0),
    _real("MC_RR_INT_LIM", 0.3, 0.0, 10.0),
    _real("MC_YAWRATE_D", 0.0, 0.0, 0.05),
    _real("MC_YAWRATE_I", 0.1, 0.0, 2.0),
    _real("MC_YAWRATE_MAX", 200.0, 1.0, 1800.0),
    _real("MC_YAWRATE_P", 0.2, 0.0, 0.6),
    _real("MC_YAW_P", 2.8, 0.1, 5.0),
    _real("MC_YAW_TQ_CUTOFF", 2.0, 0.0, 10.0),
    _real("MC_YAW_WEIGHT", 0.4, 0.0, 1.0),
    _real("MC_YR_INT_LIM", 0.3, 0.0, 10.0),
    _real("MIS_TAKEOFF_ALT", 2.5, 0.0, 1000.0),
    _real("MPC_ACC_DOWN_MAX", 3.0, 2.0, 15.0),
    _real("MPC_ACC_HOR", 3.0, 2.0, 15.0),
    _real("MPC_ACC_UP_MAX", 4.0, 2.0, 15.0),
    _real("MPC_JERK_AUTO", 4.0, 1.0, 80.0),
    _real("MPC_LAND_ALT1", 10.0, 0.0, 100.0),
    _real("MPC_LAND_ALT2", 5.0, 0.0, 100.0),
    _real("MPC_LAND_ALT3", 1.0, 0.0, 100.0),
    _real("MPC_LAND_CRWL", 0.3, 0.1, 5.0),
    _real("MPC_LAND_SPEED", 0.7, 0.6, 5.0),
    _real("MPC_THR_HOVER", 0.5, 0.1, 0.8),
    _real("MPC_THR_MAX", 1.0, 0.3, 1.0),
    _real("MPC_THR_MIN", 0.12, 0.05, 0.5),
    _real("MPC_THR_XY_MARG", 0.3, 0.0, 0.5),
    _real("MPC_TILTMAX_AIR", 45.0, 20.0, 80.0),
    _real("MPC_TKO_RAMP_T", 3.0, 0.1, 5.0),
    _real("MPC_TKO_SPEED", 1.5, 1.0, 5.0),
    _int("MPC_USE_HTE", 1, 0, 1),
    _real("MPC_VELD_LP", 5.0, 0.0, 50.0),
    _real("MPC_XY_CRUISE", 5.0, 3.0, 20.0),
    _real("MPC_XY_P", 0.95, 0.0, 2.0),
    _real("MPC_XY_VEL_D_ACC", 0.2, 0.1, 2.0),
    _real("MPC_XY_VEL_I_ACC", 0.4, 0.0, 60.0),
    _real("MPC_XY_VEL_MAX", 12.0, 0.5, 20.0),
    _real("MPC_XY_VEL_P_ACC", 1.8, 1.2, 5.0),
    _real("MPC_YAWRAUTO_MAX", 45.0, 5.0, 360.0),
    _real("MPC_Z_P", 1.0, 0.1, 1.5),
    _real("MPC_Z_VEL_D_ACC", 0.0, 0.0, 2.0),
    _real("MPC_Z_VEL_I_ACC", 2.0, 0.2, 3.0),
    _real("MPC_Z_VEL_MAX_DN", 1.5, 0.5, 4.0),
    _real("MPC_Z_VEL_MAX_UP", 3.0, 0.5, 8.0),
    _real("MPC_Z_VEL_P_ACC", 4.0, 2.0, 15.0),
    _real("MPC_Z_V_AUTO_DN", 1.5, 0.5, 4.0),
    _real("MPC_Z_V_AUTO_UP", 3.0, 0.5, 8.0),
    _real("NAV_ACC_RAD", 2.0, 0.05, 200.0),
    _int("NAV_DLL_ACT", 0, 0, 0, among=(0,)),
    _real("NAV_MC_ALT_RAD", 0.8, 0.05, 200.0),
    _int("RTL_CONE_ANG", 45, 0, 90, among=(0, 25, 45, 65, 80, 90)),
    _real("RTL_DESCEND_ALT", 10.0, 0.0, 1000.0),
    _real("RTL_LAND_DELAY", 0.0, 0.0, 1000.0),
    _real("RTL_MIN_DIST", 10.0, 0.5, 100.0),
    _real("RTL_RETURN_ALT", 30.0, 0.0, 1000.0),
    _real("SIH_IXX", 0.025, 0.001, 10.0),
    _real("SIH_IYY", 0.025, 0.001, 10.0),
    _real("SIH_IZZ", 0.03, 0.001, 10.0),
    _real("SIH_KDV", 1.0, 0.0, 100.0),
    _real("SIH_KDW", 0.025, 0.0, 10.0),
    _real("SIH_L_PITCH", 0.2, 0.01, 5.0),
    _real("SIH_L_ROLL", 0.2, 0.01, 5.0),
    _real("SIH_MASS", 1.0, 0.1, 100.0),
    _real("SIH_Q_MAX", 0.1, 0.001, 100.0),
    _real("SIH_T_MAX", 5.0, 0.1, 1000.0),
    _real("SIH_T_TAU", 0.05, 0.01, 1.0),
    _int("SYS_AUTOSTART", 10040, 0, 9999999),
)


class Parameters:
    """The vehicle's parameters by name, in PX4's alphabetical order."""

    def __init__(self) -> None:
        self._known = {parameter.name: parameter for parameter in sorted(_TABLE, key=lambda p: p.name)}
        self._values = {name: parameter.checked(parameter.default) for name, parameter in self._known.items()}
        self.names = list(self._known)
        self.changes = 0
        """Grows with every change, so that what is derived from parameters knows when to follow."""

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._known.values())

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def parameter(self, name: str) -> Parameter:
        """Raises ParameterError when there is no such parameter."""
        if name not in self._known:
            raise ParameterError(f"parameter {name}: unknown name; known are {', '.join(self.names)}")
        return self._known[name]

    def set(self, name: str, value: float) -> None:
        """Raises ParameterError for an unknown name or a value that is not allowed; nothing changes then."""
        self._values[name] = self.parameter(name).checked(value)
        self.changes += 1

    def assign(self, assignment: str) -> None:
        """`NAME=VALUE` from a command line. Raises ParameterError."""
        name, equals, text = assignment.partition("=")
        parameter = self.parameter(name.strip()) if equals else None
        if parameter is None:
            raise ParameterError(f"parameter: {assignment!r} is not NAME=VALUE")
        try:
            value = float(text)
        except ValueError:
            raise ParameterError(f"parameter {parameter.name}: {text!r} is not a number") from None
        self.set(parameter.name, value)


def to_wire(parameter: Parameter, value: float) -> bytes:
    """PARAM_VALUE.param_value, 4 bytes: PX4 puts an integer's bytes where the float would be."""
    return struct.pack("<i", int(value)) if parameter.integer else struct.pack("<f", value)


def from_wire(parameter: Parameter, wire: bytes) -> float:
    """The other way round."""
    return float(struct.unpack("<i" if parameter.integer else "<f", wire)[0])
