"""What a client must know of an autopilot to fly it: the numbers of its modes, how it takes off, what it is set by."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Autopilot:
    """Modes are `HEARTBEAT.custom_mode`."""

    name: str
    number: int
    """MAV_AUTOPILOT."""
    external: int
    """The mode that flies a client's setpoints: PX4's Offboard, ArduCopter's Guided."""
    hold: int
    """The mode that stays where it is, and that a flight may begin in."""
    mission: int
    needs_stream: bool
    """Whether `external` is entered, and kept, only with a stream of setpoints."""
    takeoff_amsl: bool
    """Whether NAV_TAKEOFF's altitude is above mean sea level, or above home."""
    thrust_is_climb: bool
    """Whether SET_ATTITUDE_TARGET.thrust is a climb rate with 0.5 for none, or the share of the full thrust."""
    integers_bytewise: bool
    """Whether integer parameters travel as their bytes in the float, or as its value (Parameter Protocol)."""
    home_first: bool
    """Whether item 0 of a mission is home."""
    one_component: bool
    """Whether commands to another component are not obeyed."""
    loss_parameter: str
    """How long after the last setpoint something is done about it [s]."""
    loss_settings: tuple[tuple[str, float], ...]
    """Set for the checks of a lost stream, so that the vehicle then stays where it is."""
    return_settings: tuple[tuple[str, float], ...]
    """Set so that a return does not climb far."""
    fence_settings: tuple[tuple[str, float], ...]
    """Set so that an uploaded fence holds."""
    ready_s: float
    """It may arm at most so long after boot."""

    def set_mode(self, mode: int) -> tuple[float, float, float]:
        """MAV_CMD_DO_SET_MODE's parameters."""
        if self.number == PX4_NUMBER:
            return 1.0, float(mode >> 16 & 0xFF), float(mode >> 24)
        return 1.0, float(mode), 0.0


PX4_NUMBER, ARDUPILOT_NUMBER = 12, 3


def px4_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


PX4 = Autopilot(
    name="px4",
    number=PX4_NUMBER,
    external=px4_mode(6),
    hold=px4_mode(4, 3),
    mission=px4_mode(4, 4),
    needs_stream=True,
    takeoff_amsl=True,
    thrust_is_climb=False,
    integers_bytewise=True,
    home_first=False,
    one_component=True,
    loss_parameter="COM_OF_LOSS_T",
    loss_settings=(("COM_OBL_RC_ACT", 5.0),),
    return_settings=(("RTL_RETURN_ALT", 12.0),),
    fence_settings=(("GF_ACTION", 2.0),),
    ready_s=60.0,
)
ARDUCOPTER = Autopilot(
    name="arducopter",
    number=ARDUPILOT_NUMBER,
    external=4,
    hold=4,
    mission=3,
    needs_stream=False,
    takeoff_amsl=False,
    thrust_is_climb=True,
    integers_bytewise=False,
    home_first=True,
    one_component=False,
    loss_parameter="GUID_TIMEOUT",
    loss_settings=(),
    return_settings=(("RTL_ALT", 1200.0), ("RTL_ALT_M", 12.0), ("RTL_LOIT_TIME", 1000.0)),
    fence_settings=(("FENCE_TYPE", 7.0), ("FENCE_ENABLE", 1.0)),
    ready_s=180.0,
)
KNOWN = (PX4, ARDUCOPTER)


def by_name(name: str) -> Autopilot:
    """One of `KNOWN`. Raises KeyError."""
    return {autopilot.name: autopilot for autopilot in KNOWN}[name]


def by_number(number: int) -> Autopilot | None:
    """The one with this MAV_AUTOPILOT."""
    return next((autopilot for autopilot in KNOWN if autopilot.number == number), None)
