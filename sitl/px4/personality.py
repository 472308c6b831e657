"""PX4's facts, as recorded from its SIH quadrotor."""

import math

from sitl.flight.physics import euler
from sitl.links.frames import Payload
from sitl.links.frames import pack as packed
from sitl.parameters import Parameters
from sitl.personality import Answers, FlightMode, Missions, Personality, Result, Version
from sitl.plan import Verdict
from sitl.px4.arming import BOOT
from sitl.px4.commander import Commander
from sitl.px4.modes import NAMES, custom_mode, mode_number
from sitl.px4.parameters import TABLE
from sitl.px4.streams import COMPANION_RATES_HZ, GCS_RATES_HZ
from sitl.px4.vehicle_setup import gains, pack, rotorcraft, world
from sitl.telemetry import MESSAGES
from sitl.transfer import Rules
from sitl.vehicle import Vehicle

NAN = math.nan

# SYS_STATUS bit masks as recorded: while the estimator has no position, once it has one, and once the vehicle may arm.
SENSORS_PRESENT = (0, 0x0300400D, 0x0300402D)
SENSORS_ENABLED = (0, 0x0301400D, 0x0301402D)
SENSORS_HEALTH = (0x2321C83F, 0x2320883F, 0x2320C83F)
GPS = 0x20
PREARM_CHECK = 0x10000000
"""MAV_SYS_STATUS_PREARM_CHECK, once the vehicle may arm."""

ESTIMATOR_WAITING = 1152
ESTIMATOR_READY = 831
"""ESTIMATOR_STATUS.flags before a position is known, and after."""


def sensors(v: Vehicle) -> tuple[int, int, int]:
    """SYS_STATUS: sensors present, enabled, healthy."""
    stage = (v.now_ms >= BOOT.position_ms) + (v.now_ms >= BOOT.armable_ms)
    health = SENSORS_HEALTH[stage] | (PREARM_CHECK if v.commander.ready else 0)
    if not v.model.estimator.gps:
        health &= ~GPS
    return SENSORS_PRESENT[stage], SENSORS_ENABLED[stage], health


def vehicle_type(p: Parameters) -> int:
    return int(p["MAV_TYPE"])


def estimator_status(v: Vehicle) -> Payload:
    ready = v.located
    good = 0.02 if ready else NAN
    return packed(
        "ESTIMATOR_STATUS",
        time_usec=v.now_ms * 1000,
        flags=ESTIMATOR_READY if ready else ESTIMATOR_WAITING,
        vel_ratio=good,
        pos_horiz_ratio=good,
        pos_vert_ratio=good,
        mag_ratio=good,
        hagl_ratio=good,
        tas_ratio=NAN,
        pos_horiz_accuracy=0.3 if ready else 14.14,
        pos_vert_accuracy=0.3 if ready else 4.47,
    )


def position_target_global_int(v: Vehicle) -> Payload | None:
    """The place that an automatic mode flies to; other fields as recorded."""
    place = commander(v).destination
    if place is None:
        return None
    latitude, longitude = v.origin.globe(place[0], place[1])
    return packed(
        "POSITION_TARGET_GLOBAL_INT",
        time_boot_ms=v.now_ms,
        coordinate_frame=5,
        type_mask=0,
        lat_int=round(latitude * 1e7),
        lon_int=round(longitude * 1e7),
        alt=v.origin.altitude - place[2],
        vx=NAN,
        vy=NAN,
        vz=NAN,
        afx=0.0,
        afy=0.0,
        afz=100.0,
        yaw=euler(v.controller.attitude_setpoint)[2],
        yaw_rate=0.0,
    )


def commander(v: Vehicle) -> Commander:
    assert isinstance(v.commander, Commander)
    return v.commander


PX4 = Personality(
    name="px4",
    autopilot=12,
    capabilities=0xE8FF,
    version=Version(flight=0x01100000, middleware=0x01100000, operating_system=0),
    timeline=BOOT,
    answers=Answers(
        unknown_message=Result.DENIED,
        unknown_interval=Result.FAILED,
        bad_arm_value=None,
        set_mode=True,
        any_component=False,
        numbers_short_texts=True,
    ),
    missions=Missions(
        Rules(capacity=(2000, 64), retry_ms=250, timeout_ms=5000, busy=Verdict.ERROR),
        home_first=False,
        integer_frames=True,
    ),
    modes=tuple(FlightMode(custom_mode(mode), *NAMES[mode]) for mode in NAMES),
    companion_rates_hz=COMPANION_RATES_HZ,
    gcs_rates_hz=GCS_RATES_HZ,
    tcp_port=None,
    stream_groups={},
    table=TABLE,
    system_id="MAV_SYS_ID",
    integers_bytewise=True,
    vehicle_type=vehicle_type,
    gains=gains,
    craft=rotorcraft,
    pack=pack,
    world=world,
    mode_number=mode_number,
    sensors=sensors,
    messages={
        **MESSAGES,
        "ESTIMATOR_STATUS": estimator_status,
        "POSITION_TARGET_GLOBAL_INT": position_target_global_int,
    },
    commander=Commander,
)
