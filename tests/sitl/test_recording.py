"""Reading recordings that hold more than frames, and references with limited jerk."""

import gzip
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sitl.arducopter.shaper import eased_speed
from sitl.flight.reference import Limits, Reference, eased
from sitl.links.frames import frame, pack
from sitl.recording import events, motion, on_vehicle_time, read


def stamped(wall_us: int, raw: bytes) -> bytes:
    return wall_us.to_bytes(8, "big") + raw


def position(boot_ms: int, north: float) -> bytes:
    fields = dict.fromkeys(("y", "z", "vx", "vy", "vz"), 0.0)
    return frame(pack("LOCAL_POSITION_NED", time_boot_ms=boot_ms, x=north, **fields), 0, 1, 1)


def beat(armed: bool) -> bytes:
    mode = 0x80 if armed else 0
    fields = {"type": 2, "autopilot": 12, "custom_mode": 0, "system_status": 3, "mavlink_version": 3}
    return frame(pack("HEARTBEAT", base_mode=mode, **fields), 0, 1, 1)


def test_frames_are_found_between_a_boot_loaders_words(tmp_path):
    """ArduCopter's recording begins with text, a byte per stamp; a frame cut off at the end is left out."""
    words = b"".join(stamped(100 + k, bytes((letter,))) for k, letter in enumerate(b"Init ArduCopter\n\xfd"))
    file = tmp_path / "flight.tlog"
    file.write_bytes(words + stamped(2_000_000, position(500, 1.0)) + stamped(2_100_000, position(600, 2.0))[:-3])
    (found,) = read(file)
    assert found.time_s == 2.0
    assert found.message.x == 1.0


@given(st.binary(max_size=400))
def test_reading_survives_any_bytes(tmp_path_factory, garbage):
    file = tmp_path_factory.mktemp("any") / "flight.tlog"
    file.write_bytes(garbage)
    assert isinstance(read(file), list)


def test_vehicle_time_follows_a_clock_that_drifts_and_messages_that_come_late(tmp_path):
    """A vehicle whose clock runs 1 % slow and one of whose frames was held up for 0.3 s; what the client sends is
    stamped by the least delayed frame around."""
    raw = b""
    for k in range(200):
        boot_ms = 50 * k
        late = 300_000 if k == 100 else 0
        raw += stamped(round(boot_ms * 1000 * 1.01) + 5_000_000 + late, position(boot_ms, 0.0))
    raw += stamped(
        round(5_000_000 * 1.01) + 5_000_000,
        frame(pack("PING", seq=1, time_usec=0, target_system=0, target_component=0), 0, 240, 191),
    )
    file = tmp_path / "flight.tlog.gz"
    file.write_bytes(gzip.compress(raw))
    told = on_vehicle_time(read(file))
    (ping,) = (one for one in told if one.frame.system == 240)
    assert ping.time_s == pytest.approx(5.0, abs=0.02)  # 1 % of the second around
    assert motion(told).times == pytest.approx(np.arange(200) * 0.05)


def test_an_event_lies_between_the_last_time_it_was_not_and_the_first_time_it_was(tmp_path):
    file = tmp_path / "flight.tlog"
    file.write_bytes(
        stamped(1_000_000, beat(armed=False))
        + stamped(2_000_000, beat(armed=False))
        + stamped(3_000_000, beat(armed=True))
        + stamped(4_000_000, beat(armed=True))
    )
    assert events(read(file)) == [("armed 1", 2.0, 3.0)]


@pytest.mark.parametrize(("top", "acceleration", "jerk"), [(10.0, 2.5, 1.0), (3.0, 2.5, 1.0), (10.0, 2.5, 20.0)])
def test_s_curve_brakes_in_the_time_and_distance_of_its_closed_form(top, acceleration, jerk):
    """From `top` to rest in v/a + a/j over half of that times v, where a is reached at all."""
    peak = min(acceleration, math.sqrt(jerk * top))
    lasts = top / peak + peak / jerk
    whole = 0.5 * top * lasts
    assert eased_speed(whole, top, acceleration, jerk) == pytest.approx(top, rel=1e-6)
    assert eased_speed(0.999 * whole, top, acceleration, jerk) < top
    took, _ = quad(lambda d: 1.0 / eased_speed(d, top, acceleration, jerk), 0.0, whole, limit=200)
    assert took == pytest.approx(lasts, rel=1e-3)


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-20, 20), st.floats(-4, 4))
def test_a_reference_with_limited_jerk_stays_inside_its_limits_and_arrives(north, east, down, speed):
    limits = Limits(5.0, 3.0, 1.5, 3.0, 4.0, 3.0, 4.0)
    reference = Reference((0.0, 0.0, 0.0), (speed, 0.0, 0.0))
    dt = 0.02
    for _ in range(2000):
        before = reference
        reference = eased(reference, (north, east, down), reference.position, limits, dt)
        change = [(b - a) / dt for a, b in zip(before.acceleration, reference.acceleration, strict=True)]
        assert math.hypot(change[0], change[1]) <= limits.jerk + 1e-6
        assert abs(change[2]) <= limits.jerk + 1e-6
        assert math.hypot(reference.acceleration[0], reference.acceleration[1]) <= limits.acceleration_xy + 1e-6
    assert math.dist(reference.position, (north, east, down)) < 0.05
