"""No dead options: every parameter of the ArduCopter table but those declared SHOWN, changed, changes a flight.

Each is flown in a scenario that it belongs to, once with its default and once with another value; what is compared is
all that a pilot could see: the path, modes, texts, charge. Flights begin in a copy of a vehicle, standing or hovering.
"""

import math
from collections.abc import Callable
from functools import cache

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.arducopter.modes import Mode
from sitl.arducopter.parameters import ACTING, SHOWN, TABLE
from sitl.flight.world import OWN
from sitl.injection import inject
from sitl.parameters import Parameters
from sitl.plan import Item, Kind
from tests.sitl.copter import copter
from tests.sitl.fuzzing import prepared

NAN = math.nan
STATUSTEXT, GPS_RAW_INT, RAW_IMU = 253, 24, 27


class Flight:
    """A vehicle in GUIDED 10 m up, or one that may be armed; `seen` is what a pilot could see."""

    def __init__(self, parameters: dict[str, float], flying: bool) -> None:
        self.prey = prepared("arducopter", flying)
        self.autopilot = self.prey.autopilot
        for name, value in parameters.items():
            self.autopilot.vehicle.parameters.set(name, value)
        self.seen: list[object] = []
        self.shown = STATUSTEXT

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        for _ in range(round(seconds / 0.1)):
            if each is not None:
                each()
            self.prey.wire.sent.clear()
            self.prey.wait(100)
            v = self.autopilot.vehicle
            c = v.commander
            place = tuple(round(float(x), 4) for x in (*v.model.truth.position, *v.body.attitude))
            self.seen.append((place, c.custom_mode, c.armed, c.landed, round(c.battery.voltage, 3), v.located))
            self.seen += (
                raw[10:-2] for raw in self.prey.wire.sent if int.from_bytes(raw[7:10], "little") == self.shown
            )

    def command(self, number: int, *p: float) -> None:
        values = [*p, *([0.0] * (7 - len(p)))]
        self.prey.say(mavlink.MAVLink_command_long_message(1, 1, number, 0, *values))
        self.run(0.1)

    def mode(self, mode: Mode) -> None:
        self.command(176, 1, mode.value)

    def velocity(self, north: float, east: float, down: float, yaw: float = 0.0) -> None:
        self._target(2503, (0.0, 0.0, 0.0), (north, east, down), yaw)

    def position(self, north: float, east: float, down: float, yaw: float = 0.0) -> None:
        self._target(2552, (north, east, down), (0.0, 0.0, 0.0), yaw)

    def _target(self, mask: int, place: tuple[float, ...], velocity: tuple[float, ...], yaw: float) -> None:
        self.prey.say(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, mask, *place, *velocity, 0.0, 0.0, 0.0, yaw, 0.0
            )
        )

    def sticks(self, forward: float = 0.0, throttle: float = 0.0, yaw: float = 0.0) -> None:
        x, z, r = round(1000 * forward), round(500 + 500 * throttle), round(1000 * yaw)
        self.prey.say(mavlink.MAVLink_manual_control_message(1, x, 0, z, r, 0))

    def inject(self, what: str) -> None:
        inject(self.autopilot, what)


def steps(f: Flight) -> None:
    """Velocity steps on all axes with turns; then the stream stops."""
    for seconds, north, east, down, yaw in [
        (2.5, 14, 0, 0, 0),
        (2, 0, 9, 0, 1.5),
        (2, 0, 0, -6, 1.5),
        (2, -6, 2, 3, -1),
    ]:
        f.run(seconds, lambda v=(north, east, down, yaw): f.velocity(*v))
    f.run(5)


def places(f: Flight) -> None:
    """A far place, then one below it."""
    f.position(60.0, 20.0, -20.0, 1.0)
    f.run(14)
    f.position(60.0, 20.0, -8.0, -1.0)
    f.run(8)


def home(f: Flight) -> None:
    """A return from above and beside, with landing and disarming."""
    f.position(12.0, 3.0, -12.0, 2.0)
    f.run(8)
    f.mode(Mode.RTL)
    f.run(50)


def near_home(f: Flight) -> None:
    """A return from inside the cone."""
    f.position(2.5, 0.0, -3.0)
    f.run(8)
    f.mode(Mode.RTL)
    f.run(25)


def land(f: Flight) -> None:
    """From 20 m."""
    f.position(0.0, 0.0, -20.0)
    f.run(9)
    f.mode(Mode.LAND)
    f.run(35)


def by_sticks(f: Flight) -> None:
    """LOITER, then ALT_HOLD; then the sticks are lost."""
    f.run(0.3, f.sticks)
    f.mode(Mode.LOITER)
    f.run(3, lambda: f.sticks(forward=1.0))
    f.run(1.5, lambda: f.sticks(throttle=1.0, yaw=0.5))
    f.run(1.5, lambda: f.sticks(throttle=-1.0))
    f.mode(Mode.ALT_HOLD)
    f.run(1.5, lambda: f.sticks(forward=1.0))
    f.run(5)


def attitude(f: Flight) -> None:
    """SET_ATTITUDE_TARGET whose thrust is a climb rate."""
    for thrust in (0.8, 0.3):
        message = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, (1.0, 0.05, 0.0, 0.0), 0.0, 0.0, 0.0, thrust)
        f.run(1.5, lambda message=message: f.prey.say(message))


def idle(f: Flight) -> None:
    """Armed without takeoff."""
    f.mode(Mode.GUIDED)
    f.command(400, 1)
    f.run(12)


def blind_arming(f: Flight) -> None:
    """Armed without a position."""
    f.inject("estimator_loss")
    f.run(1)
    idle(f)


def auto(f: Flight) -> None:
    """Armed in AUTO, with a mission whose waypoint is near."""
    x, y = (round(degrees * 1e7) for degrees in f.autopilot.vehicle.origin.globe(18.0, 0.0))
    f.autopilot.vehicle.commander.plans.store(
        Kind.MISSION, (Item(3, 22, (0.0, 0.0, 0.0, NAN), 0, 0, 8.0), Item(3, 16, (0.0, 0.0, 0.0, NAN), x, y, 8.0))
    )
    f.mode(Mode.AUTO)
    f.command(400, 1)
    f.run(8)


def flat(f: Flight) -> None:
    """A battery that is nearly empty, for 12 s."""
    f.inject("battery 0.02")
    f.run(12)


def ground_silent(f: Flight) -> None:
    """A ground station is heard, then not; the vehicle is flown by sticks."""
    heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    f.run(0.5, lambda: f.prey.say(heartbeat))
    f.run(0.5, f.sticks)
    f.mode(Mode.LOITER)
    f.run(8, f.sticks)


def lost(f: Flight) -> None:
    """No position."""
    f.inject("estimator_loss")
    f.run(5)


def wreck(f: Flight) -> None:
    """A motor fails in the air."""
    f.inject("motor 1 fail")
    f.run(10)


def to_the_fence(f: Flight) -> None:
    """50 m north and 30 m up."""
    f.run(12, lambda: f.velocity(8.0, 0.0, -2.0))
    f.run(4, lambda: f.velocity(0.0, 0.0, 4.0))


def down_to_the_fence(f: Flight) -> None:
    f.run(9, lambda: f.velocity(0.0, 0.0, 1.5))


def two_areas(f: Flight) -> None:
    """Inside one of two areas that one may be in."""
    vehicle = f.autopilot.vehicle
    for_all = []
    for north in (0.0, 200.0):
        x, y = (round(degrees * 1e7) for degrees in vehicle.origin.globe(north, 0.0))
        for_all.append(Item(0, 5003, (50.0, 0.0, 0.0, 0.0), x, y, 0.0))
    vehicle.commander.plans.store(Kind.FENCE, tuple(for_all))
    f.run(3)


def gps(f: Flight) -> None:
    """What the receiver tells."""
    f.shown = GPS_RAW_INT
    f.prey.wire.links[0].set_interval("GPS_RAW_INT", 200_000.0, f.autopilot.now_ms)
    f.run(2)


def imu(f: Flight) -> None:
    """What the accelerometers and gyros tell."""
    f.shown = RAW_IMU
    f.prey.wire.links[0].set_interval("RAW_IMU", 200_000.0, f.autopilot.now_ms)
    f.run(1)


ON_THE_GROUND = (idle, blind_arming, auto)
FENCED = {"FENCE_ENABLE": 1, "FENCE_RADIUS": 40.0, "AVOID_ENABLE": 0}

SCENARIOS: dict[Callable[[Flight], None], dict[str, float]] = {
    steps: {
        **{p.name: NAN for p in ACTING if p.name.startswith(("ATC_ANG_", "ATC_RAT_", "PSC_")) and p.default},
        "ANGLE_MAX": 1200,
        "ATC_ANG_PIT_P": 10.0,  # ATC_INPUT_TC makes at least 6.7
        "ATC_ANG_RLL_P": 10.0,
        "ATC_INPUT_TC": 0.5,
        "ATC_RATE_FF_ENAB": 0,
        "ATC_RATE_P_MAX": 10.0,
        "ATC_RATE_R_MAX": 10.0,
        "ATC_RATE_Y_MAX": 10.0,
        "ATC_RAT_PIT_IMAX": 0.0,
        "ATC_RAT_RLL_IMAX": 0.0,
        "ATC_RAT_YAW_IMAX": 0.0,
        "ATC_RAT_YAW_D": 0.01,
        "ATC_SLEW_YAW": 2000.0,
        "BATT_CAPACITY": 2000,
        "GUID_TIMEOUT": 1.0,
        "PSC_ANGLE_MAX": 12.0,
        "PSC_VELXY_I": 0.2,
        "PSC_VELZ_D": 0.3,
        "PSC_VELZ_I": 1.0,
        "SIM_BATT_VOLTAGE": 12.0,
        "SIM_ENGINE_FAIL": 1,
        "SIM_WIND_SPD": 5.0,
        "SIM_WIND_TURB": 1.0,
        "SITL_BAT_R": 0.01,
        "SITL_GUST_W20": 5.0,
        "SITL_KDQ": 0.1,
        "SITL_PANEL_AREA": 0.1,
        "SITL_WIND_D": 1.0,
        "SITL_WIND_E": 3.0,
        "SITL_WIND_N": 3.0,
        "WPNAV_ACCEL": 150.0,
        "WPNAV_ACCEL_Z": 60.0,
        "WPNAV_SPEED_DN": 100.0,
        "WPNAV_SPEED_UP": 150.0,
    },
    places: {"WPNAV_JERK": 2.0, "WPNAV_SPEED": 400.0},
    home: {
        "RTL_ALT": 2000,
        "RTL_ALT_FINAL": 500,
        "RTL_CLIMB_MIN": 500,
        "RTL_LOIT_TIME": 2000,
        "RTL_SPEED": 200,
        "WP_YAW_BEHAVIOR": 1,
    },
    near_home: {"RTL_CONE_SLOPE": 1.0},
    land: {"LAND_ALT_LOW": 500, "LAND_SPEED": 80, "LAND_SPEED_HIGH": 300},
    by_sticks: {
        "LOIT_SPEED": 500.0,
        "PILOT_SPEED_DN": 100,
        "PILOT_SPEED_UP": 150,
        "PILOT_Y_RATE": 60.0,
        "RC_OVERRIDE_TIME": 1.0,
    },
    attitude: {"GUID_OPTIONS": 8},
    idle: {"BATT_ARM_VOLT": 13.0, "DISARM_DELAY": 5},
    blind_arming: {"ARMING_CHECK": 0},
    auto: {"AUTO_OPTIONS": 3},
    flat: {
        "BATT_CRT_MAH": 200.0,
        "BATT_CRT_VOLT": 10.5,
        "BATT_FS_LOW_ACT": 2,
        "BATT_LOW_MAH": 200.0,
        "BATT_LOW_TIMER": 3,
        "BATT_LOW_VOLT": 9.0,
    },
    ground_silent: {"FS_GCS_ENABLE": 1},
    lost: {"FS_EKF_ACTION": 2, "FS_EKF_THRESH": 0.0},
    wreck: {"FS_CRASH_CHECK": 0},
    gps: {"SIM_GPS1_ENABLE": 0, "SIM_GPS1_NOISE": 3.0},
    imu: {"SITL_NOISE": 0.0},
}
"""Scenario -> parameter and its other value; NaN: 0.7 times the default."""

TOGETHER: list[tuple[Callable[[Flight], None], dict[str, float], str, float]] = [
    (steps, {"SIM_ENGINE_FAIL": 1, "SIM_ENGINE_MUL": 0.9}, "SIM_ENGINE_MUL", 0.7),
    (steps, {"SIM_WIND_SPD": 5.0}, "SIM_WIND_DIR", 90.0),
    (steps, {"SITL_PANEL_AREA": 0.1}, "SITL_PANEL_CD", 1.0),
    (flat, {"BATT_CRT_MAH": 200.0}, "BATT_FS_CRT_ACT", 1),
    (ground_silent, {"FS_GCS_ENABLE": 1, "FS_OPTIONS": 0}, "FS_GCS_TIMEOUT", 3.0),
    (ground_silent, {"FS_GCS_ENABLE": 1, "FS_OPTIONS": 0}, "FS_OPTIONS", 16),
    (ground_silent, {"FS_GCS_ENABLE": 1, "FS_OPTIONS": 0}, "MAV_GCS_SYSID", 254),
    (to_the_fence, FENCED, "FENCE_ENABLE", 0),
    (to_the_fence, FENCED, "FENCE_RADIUS", 50.0),
    (to_the_fence, FENCED, "FENCE_ACTION", 2),
    (to_the_fence, FENCED, "FENCE_TYPE", 5),
    (to_the_fence, FENCED, "FENCE_ALT_MAX", 15.0),
    (to_the_fence, FENCED, "AVOID_ENABLE", 1),
    (to_the_fence, {**FENCED, "AVOID_ENABLE": 1}, "FENCE_MARGIN", 6.0),
    (down_to_the_fence, {"FENCE_ENABLE": 1, "FENCE_TYPE": 8}, "FENCE_ALT_MIN", 5.0),
    (two_areas, {"FENCE_ENABLE": 1}, "FENCE_OPTIONS", 2),
    (home, {}, "WPNAV_RADIUS", 5.0),
]
"""Scenario, what else must be set, parameter, its other value."""

CASES = [
    (scenario, {}, name, Parameters(TABLE)[name] * 0.7 if math.isnan(value) else value)
    for scenario, values in SCENARIOS.items()
    for name, value in values.items()
] + TOGETHER


@cache
def flown(scenario: Callable[[Flight], None], parameters: tuple[tuple[str, float], ...]) -> list[object]:
    flight = Flight(dict(parameters), flying=scenario not in ON_THE_GROUND)
    scenario(flight)
    return flight.seen


@pytest.mark.parametrize(("scenario", "others", "name", "value"), CASES, ids=[case[2] for case in CASES])
def test_changing_it_changes_the_flight(scenario, others, name, value):
    """Issue 4, item 2: parameters act on the simulation."""
    assert Parameters(TABLE)[name] != value or name in others
    assert flown(scenario, tuple(others.items())) != flown(scenario, tuple({**others, name: value}.items()))


def test_none_is_left_out():
    assert {case[2] for case in CASES} == {parameter.name for parameter in (*ACTING, *OWN)} - {"SITL_EST_ERR"}


def test_the_estimate_errs():
    """SITL_EST_ERR, read at start."""
    with copter(SITL_EST_ERR=2.0) as vehicle:
        vehicle.boot()
        model = vehicle.autopilot.vehicle.model
        assert math.dist(vehicle.position, model.truth.position) > 0.1


def test_what_is_only_shown_acts_on_nothing():
    """All of them at another value: the same flights, so that none acts without being declared."""
    named = {p.name: p for p in SHOWN}
    other = {
        name: next(value for value in (p.default + 1, p.default - 1, p.high) if p.low <= value <= p.high)
        for name, p in named.items()
    }
    del other["MAV_SYSID"]  # another vehicle, who is not spoken to
    for scenario in (steps, by_sticks, home, auto, flat):
        assert flown(scenario, tuple(other.items())) == flown(scenario, ())
