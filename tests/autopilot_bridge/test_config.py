import pytest
from pydantic import ValidationError

from autopilot_bridge.config import BridgeConfig

GOOD = {
    "clock": {"kind": "paced"},
    "slots": 60,
    "start_position_enu": (0, 0, 60),
    "box": {"x": (-100, 100), "y": (-100, 100), "z": (30, 120)},
}

LOCKSTEP = {"kind": "lockstep", "control": "127.0.0.1:4560"}


def test_the_default_fence_is_the_box_and_a_margin():
    config = BridgeConfig(**GOOD)
    assert config.slot_fence.spans == ((-110, 110), (-110, 110), (25, 125))
    assert config.flight_fence.contains((0, 0, 0))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"autopilot": "usb://127.0.0.1:5760"}, "autopilot.*must be udpin://HOST:PORT, udpout.*tcp.*serial"),
        ({"autopilot": "tcp://127.0.0.1"}, "autopilot.*must be udpin"),
        ({"autopilot": "tcp://127.0.0.1:0"}, "autopilot.*port 0 can only be listened on"),
        ({"autopilot": "serial:///dev/ttyACM0"}, r"autopilot.*serial://DEVICE:BAUD, e\.g"),
        ({"autopilot": "tcp://127.0.0.1:5760", "clock": LOCKSTEP}, "autopilot.*clock 'lockstep', which needs udpin"),
        ({"backend": "mavsdk", "clock": LOCKSTEP}, "backend: 'mavsdk' needs clock 'paced'.*not lockstep"),
        ({"backend": "mavsdk", "clock": {"kind": "paced", "speed": 2}}, "backend: 'mavsdk'.*not paced, speed 2"),
        ({"backend": "mavsdk", "signing_key": "key"}, "signing_key: backend 'mavsdk' cannot sign"),
        ({"backend": "mavros"}, "backend"),
        ({"dialect": "betaflight"}, "dialect"),
        ({"autopilot": "udpin://127.0.0.1:99999"}, "Port out of range"),
        ({"clock": {"kind": "lockstep", "control": "4560"}}, "HOST:PORT"),
        ({"clock": {"kind": "sundial"}}, "clock"),
        ({"slots": 0}, "slots"),
        ({"slot_s": 1.03}, "multiple of 0.1"),
        ({"v_max_mps": float("inf")}, "v_max_mps"),
        ({"start_position_enu": (0, 0, 10)}, "outside the box"),
        ({"box": {"x": (1, 1), "y": (0, 1), "z": (0, 1)}}, "minimum must be below"),
        ({"fence": {"x": (-100, 100), "y": (-100, 100), "z": (40, 120)}}, "fence.z"),
        (
            {"fence": {"polygon": [(-100, -100), (100, -100), (100, 100), (-100, 100)], "altitude": (29, 121)}}
            | {"box": {"x": (10, 60), "y": (10, 60), "z": (30, 120)}, "start_position_enu": (5, 10, 60)},
            "outside the box",
        ),
        (
            {"fence": {"polygon": [(5, -100), (5, 100), (110, 100), (110, -100)], "altitude": (29, 121)}}
            | {"box": {"x": (10, 60), "y": (10, 60), "z": (30, 120)}, "start_position_enu": (10, 10, 60)},
            r"straight way from home \(0, 0\) to the start \(10, 10\)",
        ),
        (
            {"box": {"x": (-9, 9), "y": (-9, 9), "z": (1, 3)}, "start_position_enu": (0, 0, 2)}
            | {"takeoff_altitude_m": 8.5},
            "takeoff_altitude_m: 8.5 is above the fence, which ends at 8",
        ),
        ({"grace": 3}, "grace"),
        ({"require": ["geofence"], "allow_without": ["geofence"]}, "allow_without: 'geofence' is also in require"),
        ({"allow_without": ["parachute"]}, "battery_failsafe"),
    ],
)
def test_bad_input_is_named(change, told):
    with pytest.raises(ValidationError, match=f"(?s){told}"):
        BridgeConfig(**(GOOD | change))
