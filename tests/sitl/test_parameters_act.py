"""No dead options: every parameter of the PX4 table, changed, changes a flight.

Each is flown in a scenario that it belongs to, once with its default and once with another value; what is compared is
all that a pilot could see: the path, modes, texts, charge.
"""

import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.autopilot import Autopilot
from sitl.injection import inject
from sitl.links.link import Link
from sitl.links.network import Network
from sitl.links.signing import Signing
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.plan import Item, Kind
from sitl.px4.modes import Mode, custom_mode
from sitl.px4.parameters import TABLE
from sitl.px4.personality import PX4
from sitl.services.failure_injection import inject_failure
from sitl.targets import AttitudeTarget, PositionTarget, Sticks

NAN = math.nan
ZERO = (0.0, 0.0, 0.0)
DATA = Path(__file__).parent / "data"
IDENTITY = {"CAL_ACC0_ID", "CAL_GYRO0_ID", "CAL_MAG0_ID", "MAV_COMP_ID", "MAV_SYS_ID", "MAV_TYPE", "SYS_AUTOSTART"}
"""What clients ask for; acts on nothing that flies."""


class Flight:
    """An autopilot without links, flown by its commander; `seen` is what a pilot could see."""

    def __init__(self, parameters: dict[str, float]) -> None:
        p = Parameters(TABLE)
        for name, value in parameters.items():
            p.set(name, value)
        self.autopilot = Autopilot(PX4, p, Origin(), Network((), 1, Signing()), 0, 0)
        self.commander = self.autopilot.vehicle.commander
        self.seen: list[object] = []
        self.commander._say = lambda text, severity: self.seen.append(text)

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        for _ in range(round(seconds / 0.1)):
            if each is not None:
                each()
            self.autopilot.advance(100)
            c, v = self.commander, self.autopilot.vehicle
            place = tuple(round(float(x), 4) for x in (*v.model.truth.position, *v.body.attitude))
            self.seen.append((place, c.custom_mode, c.armed, c.landed, round(c.battery.voltage, 3), v.located))

    def take_off(self, altitude: float = 500.0) -> None:
        self.run(5)
        self.commander.arm()
        self.commander.takeoff(altitude)
        self.run(16)

    def velocity(self, north: float, east: float, down: float, yaw: float = 0.0) -> None:
        velocity = (float(north), float(east), float(down))
        self.commander.receive(PositionTarget(1, 2503, ZERO, velocity, ZERO, yaw, 0.0))

    def position(self, north: float, east: float, down: float, yaw: float = 0.0) -> None:
        self.commander.receive(PositionTarget(1, 2552, (north, east, down), ZERO, ZERO, yaw, 0.0))

    def mode(self, mode: Mode) -> None:
        self.seen.append(self.commander.set_mode(custom_mode(mode)))

    def sticks(self, forward: float = 0.0, right: float = 0.0, throttle: float = 0.0, yaw: float = 0.0) -> None:
        self.commander.pilot(Sticks(forward, right, throttle, yaw), radio=False)


def offboard(f: Flight) -> None:
    """Velocity steps on all axes with turns, then a position."""
    f.take_off()
    for seconds, (vn, ve, vd, yaw) in [
        (0.2, (0, 0, 0, 0)),
        (2.0, (14.0, 0, 0, 0)),
        (2.0, (0, 9.0, 0, 1.5)),
        (1.5, (0, 0, -6.0, 1.5)),
        (1.5, (-6.0, 2.0, 3.0, -1.5)),
    ]:
        f.run(seconds, lambda vn=vn, ve=ve, vd=vd, yaw=yaw: f.velocity(vn, ve, vd, yaw))
        if f.commander.mode is not Mode.OFFBOARD:
            f.mode(Mode.OFFBOARD)
    f.run(4, lambda: f.position(5.0, 5.0, -12.0))


def rates(f: Flight) -> None:
    """Body rates beyond all limits, full thrust, none."""
    f.take_off(520.0)
    turn = AttitudeTarget(128, (1.0, 0.0, 0.0, 0.0), (9.0, 9.0, 9.0), 0.9)
    f.run(0.3, lambda: f.commander.receive_attitude(turn))
    f.mode(Mode.OFFBOARD)
    f.run(0.4, lambda: f.commander.receive_attitude(turn))
    f.run(1.5, lambda: f.velocity(0, 0, 0))


def out_and_home(f: Flight, north: float = 20.0) -> None:
    """Away, return, land, disarm."""
    f.take_off(495.0)
    f.run(0.3, lambda: f.position(north, 0.0, -6.0, 2.0))
    f.mode(Mode.OFFBOARD)
    f.run(6, lambda: f.position(north, 0.0, -6.0, 2.0))
    f.mode(Mode.RTL)
    f.run(75)


def near_home(f: Flight) -> None:
    """Return from inside the cone."""
    out_and_home(f, 7.0)


def hop(f: Flight) -> None:
    """The default takeoff, hold, land, and arming without takeoff."""
    f.run(5)
    f.commander.arm()
    f.commander.takeoff(NAN)
    f.run(20)
    f.commander.land()
    f.run(15)
    f.commander.arm(force=True)
    f.run(14)


def brake(f: Flight) -> None:
    """From full speed into hold."""
    f.take_off()
    f.run(0.3, lambda: f.velocity(8.0, 0, -2.0))
    f.mode(Mode.OFFBOARD)
    f.run(3, lambda: f.velocity(8.0, 0, -2.0))
    f.mode(Mode.LOITER)
    f.run(5)


def takeoff_with_mission(f: Flight) -> None:
    """A takeoff that is not the mission's."""
    f.run(5)
    x, y = (round(degrees * 1e7) for degrees in f.autopilot.vehicle.origin.globe(18.0, 0.0))
    f.commander.plans.store(Kind.MISSION, (Item(3, 16, (0.0, 0.0, 0.0, NAN), x, y, 8.0),))
    f.commander.arm()
    f.commander.takeoff(494.0)
    f.run(15)


def position_sticks(f: Flight) -> None:
    """POSCTL: pushes, let go, climb, turn; then the sticks are lost."""
    f.take_off()
    f.run(0.3, f.sticks)
    f.mode(Mode.POSCTL)
    f.run(3, lambda: f.sticks(forward=0.8))
    f.run(3, lambda: f.sticks(forward=0.12))
    f.run(4, f.sticks)
    f.run(1.5, lambda: f.sticks(throttle=0.6, yaw=0.5))
    f.run(1.5, lambda: f.sticks(throttle=-0.6))
    f.run(3, f.sticks)
    f.run(8)


def other_sticks(f: Flight) -> None:
    """ALTCTL and STABILIZED."""
    f.take_off()
    f.run(0.3, f.sticks)
    f.mode(Mode.ALTCTL)
    f.run(1.5, lambda: f.sticks(forward=0.7, yaw=0.4))
    f.mode(Mode.STABILIZED)
    f.run(1, lambda: f.sticks(throttle=-1.0, right=0.5))


def touched_sticks(f: Flight) -> None:
    """A pilot touches the sticks, little and much, in hold and in OFFBOARD."""
    f.take_off()
    f.run(1, lambda: f.sticks(forward=0.25))
    f.run(1, lambda: f.sticks(forward=0.5))
    f.run(0.5, lambda: (f.velocity(0, 0, 0), f.sticks()))
    f.mode(Mode.OFFBOARD)
    f.run(1, lambda: (f.velocity(0, 0, 0), f.sticks(forward=0.5)))


def sticks_gone(f: Flight) -> None:
    """Sticks that were there are lost in hold."""
    f.take_off()
    f.run(0.5, f.sticks)
    f.run(8)


def silence(f: Flight) -> None:
    """OFFBOARD without its stream."""
    f.take_off()
    f.run(0.3, lambda: f.velocity(1.0, 0, 0))
    f.mode(Mode.OFFBOARD)
    f.run(1, lambda: f.velocity(1.0, 0, 0))
    f.run(8)


def no_ground(f: Flight) -> None:
    """The ground station falls silent."""
    f.run(4.9)
    f.commander.hear_ground(255, 6)
    f.take_off()
    f.commander.hear_ground(255, 6)
    f.run(26)


def low_battery(f: Flight) -> None:
    f.take_off()
    for share in (0.3, 0.14, 0.065, 0.04):
        inject(f.autopilot, f"battery {share}")
        f.run(7)
    inject(f.autopilot, "battery 0.1")


def arming(f: Flight) -> None:
    """With a battery that is not full, no mission, no ground station."""
    inject(f.autopilot, "battery 0.4")
    f.run(5)
    f.seen.append(f.commander.arm())
    f.run(2)


def fence(f: Flight) -> None:
    """Over the limits that the scenario sets."""
    f.take_off()
    f.run(0.3, lambda: f.velocity(4.0, 0, -2.0))
    f.mode(Mode.OFFBOARD)
    f.run(4, lambda: f.velocity(4.0, 0, -2.0))
    f.run(8)


def no_gps(f: Flight) -> None:
    f.take_off()
    f.run(0.3, f.sticks)
    f.mode(Mode.POSCTL)
    inject(f.autopilot, "gps_loss")
    f.run(9, f.sticks)


def dead_motor(f: Flight) -> None:
    f.take_off(509.0)
    inject(f.autopilot, "motor 2 fail")
    f.run(4)


def dead_motor_pitching(f: Flight) -> None:
    """Both motors on the nose: it pitches over."""
    f.take_off(509.0)
    inject(f.autopilot, "motor 1 0")
    inject(f.autopilot, "motor 3 0")
    f.run(4)


def dead_motor_rolling(f: Flight) -> None:
    """Both motors on the right."""
    f.take_off(509.0)
    inject(f.autopilot, "motor 1 0")
    inject(f.autopilot, "motor 4 0")
    f.run(4)


def dead_motor_early(f: Flight) -> None:
    f.run(5)
    f.commander.arm()
    f.commander.takeoff(520.0)
    f.run(4.0)
    for motor in (1, 4):
        inject(f.autopilot, f"motor {motor} fail")
    f.run(4)


def long_flight(f: Flight) -> None:
    f.take_off(492.0)
    f.run(30)


def windy(f: Flight) -> None:
    f.take_off()
    inject(f.autopilot, "wind 8,0,0")
    f.run(9)


def mavlink_failure(f: Flight) -> None:
    from sitl.services.command import Command

    f.take_off(492.0)
    link = Link("companion", {}, 1, Signing(), lambda raw: True, talks_first=False, now_ms=0)
    f.seen.append(inject_failure(f.autopilot.vehicle, link, Command(420, (4.0, 1.0, 0.0, 0.0), 0.0, 0.0, 0.0)))


def shown_noise(f: Flight) -> None:
    f.run(1)
    payload = f.autopilot.vehicle.personality.messages["HIGHRES_IMU"](f.autopilot.vehicle)
    f.seen.append(payload)


GAINS_AND_AIRFRAME = (
    "MC_PITCHRATE_D",
    "MC_PITCHRATE_I",
    "MC_PITCHRATE_K",
    "MC_PITCHRATE_P",
    "MC_PITCH_P",
    "MC_ROLLRATE_D",
    "MC_ROLLRATE_I",
    "MC_ROLLRATE_K",
    "MC_ROLLRATE_P",
    "MC_ROLL_P",
    "MC_YAWRATE_I",
    "MC_YAWRATE_K",
    "MC_YAWRATE_P",
    "MC_YAW_P",
    "MC_YAW_TQ_CUTOFF",
    "MC_YAW_WEIGHT",
    "MPC_VELD_LP",
    "MPC_XY_P",
    "MPC_XY_VEL_D_ACC",
    "MPC_XY_VEL_I_ACC",
    "MPC_XY_VEL_P_ACC",
    "MPC_Z_P",
    "MPC_Z_VEL_I_ACC",
    "MPC_Z_VEL_P_ACC",
    "SIH_IXX",
    "SIH_IYY",
    "SIH_IZZ",
    "SIH_KDV",
    "SIH_KDW",
    "SIH_L_PITCH",
    "SIH_L_ROLL",
    "SIH_MASS",
    "SIH_Q_MAX",
    "SIH_T_MAX",
    "SIH_T_TAU",
)

SCENARIOS: dict[Callable[[Flight], None], dict[str, float]] = {
    offboard: dict.fromkeys(GAINS_AND_AIRFRAME, math.nan)
    | {
        "MC_YAWRATE_D": 0.01,
        "MPC_THR_MAX": 0.6,
        "MPC_THR_MIN": 0.45,
        "MPC_THR_XY_MARG": 0.05,
        "MPC_TILTMAX_AIR": 25.0,
        "MPC_XY_VEL_MAX": 4.0,
        "MPC_Z_VEL_D_ACC": 0.2,
        "MPC_Z_VEL_MAX_DN": 0.7,
        "MPC_Z_VEL_MAX_UP": 1.0,
        "SITL_KDQ": 0.05,
        "SITL_PANEL_AREA": 0.1,
        "SITL_WIND_D": 1.0,
        "SITL_WIND_E": 3.0,
        "SITL_WIND_N": 3.0,
        "SITL_GUST_W20": 5.0,
        "SITL_EST_ERR": 1.0,
        "SITL_BAT_R": 0.01,
        "BAT1_N_CELLS": 6,
        "BAT1_V_CHARGED": 4.2,
        "BAT1_V_EMPTY": 3.3,
        "BAT1_CAPACITY": 500.0,
    },
    rates: {
        "MC_PITCHRATE_MAX": 60.0,
        "MC_ROLLRATE_MAX": 60.0,
        "MC_YAWRATE_MAX": 30.0,
        "MC_PR_INT_LIM": 0.005,
        "MC_RR_INT_LIM": 0.005,
        "MC_YR_INT_LIM": 0.001,
    },
    out_and_home: {
        "RTL_LAND_DELAY": 3.0,
        "RTL_RETURN_ALT": 15.0,
        "RTL_MIN_DIST": 100.0,
        "MPC_LAND_ALT1": 20.0,
        "MPC_LAND_ALT2": 8.0,
        "MPC_LAND_ALT3": 3.0,
        "MPC_LAND_CRWL": 0.6,
        "MPC_LAND_SPEED": 1.2,
        "MPC_YAWRAUTO_MAX": 10.0,
        "MPC_XY_CRUISE": 3.0,
        "MPC_ACC_UP_MAX": 2.0,
        "MPC_ACC_DOWN_MAX": 6.0,
        "MPC_Z_V_AUTO_DN": 0.8,
        "MPC_Z_V_AUTO_UP": 1.0,
        "NAV_ACC_RAD": 5.0,
        "NAV_MC_ALT_RAD": 0.2,
    },
    near_home: {"RTL_CONE_ANG": 80},
    hop: {
        "MIS_TAKEOFF_ALT": 5.0,
        "MPC_TKO_SPEED": 1.0,
        "MPC_TKO_RAMP_T": 1.0,
        "COM_SPOOLUP_TIME": 3.0,
        "COM_DISARM_LAND": 5.0,
        "COM_DISARM_PRFLT": 5.0,
        "LNDMC_TRIG_TIME": 3.0,
    },
    brake: {"MPC_ACC_HOR": 5.0, "MPC_JERK_AUTO": 12.0},
    position_sticks: {
        "MPC_ACC_HOR_MAX": 2.5,
        "MPC_HOLD_DZ": 0.3,
        "MPC_HOLD_MAX_XY": 0.05,
        "MPC_HOLD_MAX_Z": 0.01,
        "MPC_JERK_MAX": 2.0,
        "MPC_MAN_Y_MAX": 50.0,
        "MPC_VEL_MANUAL": 4.0,
        "MPC_XY_MAN_EXPO": 0.0,
        "MPC_YAW_EXPO": 0.0,
        "MPC_Z_MAN_EXPO": 0.0,
        "NAV_RCL_ACT": 3,
        "COM_RC_LOSS_T": 2.0,
        "COM_RC_IN_MODE": 4,
        "COM_FAIL_ACT_T": 1.0,
    },
    other_sticks: {"MPC_MAN_TILT_MAX": 20.0, "MPC_MANTHR_MIN": 0.3},
    touched_sticks: {"COM_RC_STICK_OV": 10.0, "COM_RC_OVERRIDE": 2},
    sticks_gone: {"COM_RCL_EXCEPT": 2},
    silence: {"COM_OBL_RC_ACT": 4, "COM_OF_LOSS_T": 3.0},
    no_ground: {"NAV_DLL_ACT": 3},
    low_battery: {"COM_LOW_BAT_ACT": 3, "BAT_LOW_THR": 0.35, "BAT_CRIT_THR": 0.145, "BAT_EMERGEN_THR": 0.066},
    arming: {"COM_ARMABLE": 0, "COM_ARM_BAT_MIN": 0.5, "COM_ARM_MIS_REQ": 1, "SIM_GPS_USED": 3},
    fence: {"GF_MAX_HOR_DIST": 6.0, "GF_MAX_VER_DIST": 14.0},
    no_gps: {"COM_POSCTL_NAVL": 1, "EKF2_NOAID_TOUT": 1000000},
    long_flight: {"COM_FLT_TIME_MAX": 10},
    windy: {"COM_WIND_WARN": 5.0},
    mavlink_failure: {"SYS_FAILURE_EN": 0},
    shown_noise: {"SITL_NOISE": 0.0},
}
"""Scenario -> parameter and its other value; NaN: 1.3 times the default."""

TOGETHER: list[tuple[Callable[[Flight], None], dict[str, float], str, float]] = [
    (fence, {"GF_MAX_HOR_DIST": 6.0}, "GF_ACTION", 3),
    (no_ground, {"NAV_DLL_ACT": 2}, "COM_DL_LOSS_T", 5),
    (offboard, {"MPC_USE_HTE": 0}, "MPC_THR_HOVER", 0.4),
    (offboard, {"MPC_THR_HOVER": 0.4}, "MPC_USE_HTE", 0),
    (offboard, {"SITL_PANEL_AREA": 0.1}, "SITL_PANEL_CD", 1.0),
    (windy, {"COM_WIND_MAX": 5.0}, "COM_WIND_MAX_ACT", 3),
    (windy, {"COM_WIND_MAX_ACT": 3}, "COM_WIND_MAX", 5.0),
    (dead_motor, {}, "CBRK_FLIGHTTERM", 0),
    (dead_motor, {}, "COM_ACT_FAIL_ACT", 4),
    (dead_motor, {"COM_ACT_FAIL_ACT": 4}, "FD_ACT_EN", 0),
    (dead_motor, {"COM_ACT_FAIL_ACT": 4}, "FD_ACT_MOT_THR", 0.95),
    (dead_motor, {"COM_ACT_FAIL_ACT": 4}, "FD_ACT_MOT_TOUT", 400),
    (dead_motor_pitching, {"CBRK_FLIGHTTERM": 0, "FD_FAIL_R": 0}, "FD_FAIL_P", 0),
    (dead_motor_pitching, {"CBRK_FLIGHTTERM": 0, "FD_FAIL_R": 0}, "FD_FAIL_P_TTRI", 0.05),
    (dead_motor_rolling, {"CBRK_FLIGHTTERM": 0, "FD_FAIL_P": 0}, "FD_FAIL_R", 0),
    (dead_motor_rolling, {"CBRK_FLIGHTTERM": 0, "FD_FAIL_P": 0}, "FD_FAIL_R_TTRI", 0.05),
    (dead_motor_early, {"MPC_TKO_RAMP_T": 0.2, "COM_LKDOWN_TKO": 5.0}, "COM_LKDOWN_TKO", 0.0),
    (out_and_home, {"RTL_LAND_DELAY": 2.0}, "RTL_DESCEND_ALT", 5.0),
    (takeoff_with_mission, {}, "COM_TAKEOFF_ACT", 1),
]
"""Scenario, what else must be set, parameter, its other value."""

CASES = [
    (scenario, {}, name, Parameters(TABLE)[name] * 1.3 if math.isnan(value) else value)
    for scenario, values in SCENARIOS.items()
    for name, value in values.items()
] + TOGETHER


@cache
def flown(scenario: Callable[[Flight], None], parameters: tuple[tuple[str, float], ...]) -> list[object]:
    flight = Flight(dict(parameters))
    scenario(flight)
    return flight.seen


@pytest.mark.parametrize(("scenario", "others", "name", "value"), CASES, ids=[case[2] for case in CASES])
def test_changing_it_changes_the_flight(scenario, others, name, value):
    """Issue 4, item 2: "parameters (about 120 real names with real defaults that act on the simulation)"."""
    assert Parameters(TABLE)[name] != value or name in others
    assert flown(scenario, tuple(others.items())) != flown(scenario, tuple({**others, name: value}.items()))


def test_none_is_left_out():
    assert {case[2] for case in CASES} | IDENTITY == {parameter.name for parameter in TABLE}


def test_about_120_real_names_act():
    recorded = json.loads((DATA / "px4_params.json").read_text())
    assert len({case[2] for case in CASES} & set(recorded)) >= 120


def test_identity_is_what_clients_are_shown():
    flight = Flight({"MAV_TYPE": 13})
    flight.run(2)
    payload = flight.autopilot.vehicle.personality.messages["HEARTBEAT"](flight.autopilot.vehicle)
    assert payload is not None
    assert mavlink.MAV_TYPE_HEXAROTOR == 13
    assert 13 in payload.data
