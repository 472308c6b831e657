"""ArduCopter's facts, as recorded from ArduCopter 4.7-dev (commit 90700977) on its built-in quadrotor."""

from sitl.arducopter.arming import BOOT
from sitl.arducopter.commander import Commander
from sitl.arducopter.modes import STANDARD, Mode, mode_number
from sitl.arducopter.parameters import TABLE
from sitl.arducopter.streams import GROUPS, RATES_HZ
from sitl.arducopter.telemetry import MESSAGES, sensors
from sitl.arducopter.vehicle_setup import gains, pack, rotorcraft, world
from sitl.parameters import Parameters
from sitl.personality import Answers, FlightMode, Missions, Personality, Result, Version
from sitl.plan import Verdict
from sitl.transfer import Rules

QUADROTOR = 2
"""MAV_TYPE."""


def vehicle_type(_: Parameters) -> int:
    return QUADROTOR


ARDUCOPTER = Personality(
    name="arducopter",
    autopilot=3,
    capabilities=0xFBEF,
    version=Version(flight=0x04070000, middleware=0, operating_system=0, commit=b"90700977"),
    timeline=BOOT,
    answers=Answers(
        unknown_message=Result.FAILED,
        unknown_interval=Result.FAILED,
        bad_arm_value=Result.UNSUPPORTED,
        set_mode=False,
        any_component=True,
        numbers_short_texts=False,
    ),
    missions=Missions(
        Rules(capacity=(724, 84), retry_ms=1000, timeout_ms=8000, busy=Verdict.DENIED),
        home_first=True,
        integer_frames=False,
    ),
    modes=tuple(FlightMode(int(mode), mode.name, STANDARD.get(mode, 0)) for mode in Mode),
    companion_rates_hz=RATES_HZ,
    gcs_rates_hz=RATES_HZ,
    tcp_port=5760,
    stream_groups=GROUPS,
    table=TABLE,
    system_id="MAV_SYSID",
    integers_bytewise=False,
    vehicle_type=vehicle_type,
    gains=gains,
    craft=rotorcraft,
    pack=pack,
    world=world,
    mode_number=mode_number,
    sensors=sensors,
    messages=MESSAGES,
    commander=Commander,
)
