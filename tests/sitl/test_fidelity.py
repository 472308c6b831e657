"""Recorded flights of real PX4 and ArduCopter, flown again frame by frame (benchmarks/sitl_fidelity.py; issue 4, 5)."""

import math

import numpy as np
import pytest

from benchmarks.sitl_fidelity import ARDUCOPTER, CLIENT, GOAL_RMS_MPS, GOAL_S, PX4, Flown
from sitl.recording import Stamped, cut, events, motion, on_vehicle_time, read, write


@pytest.fixture(scope="module")
def px4() -> Flown:
    return Flown(PX4)


@pytest.fixture(scope="module")
def arducopter() -> Flown:
    return Flown(ARDUCOPTER)


@pytest.mark.parametrize("name", ["px4", "arducopter"])
def test_velocity_is_as_recorded_over_everything_flown_by_setpoints(name, request, record_property):
    """Issue 4: at most 0.35 m/s RMS over each recorded flight's offboard part, its failsafes and oddities included."""
    flown = request.getfixturevalue(name)
    rms = flown.rms(flown.recording.offboard)
    record_property("rms_mps", rms)
    assert rms < GOAL_RMS_MPS


@pytest.mark.parametrize("part", PX4.parts)
def test_px4_flies_every_part_as_recorded(px4, part):
    """Takeoff, failsafes, return and landing no worse than what the goal allows for setpoints."""
    assert px4.rms(px4.recording.parts[part]) < GOAL_RMS_MPS


@pytest.mark.parametrize("part", ARDUCOPTER.parts)
def test_arducopter_flies_every_part_as_recorded(arducopter, part):
    assert arducopter.rms(arducopter.recording.parts[part]) < GOAL_RMS_MPS


@pytest.mark.parametrize("name", ["px4", "arducopter"])
def test_velocity_steps_are_half_done_when_recorded(name, request):
    """AUTOPILOT.md 4: t50 of every step."""
    steps = request.getfixturevalue(name)
    assert len(steps.steps) == 12
    for step in steps.steps:
        half = [step.reached(moved, 0.5) for moved in (steps.simulated, steps.recorded)]
        assert half[0] == pytest.approx(half[1], abs=GOAL_S), step


NEAR_THE_GROUND = ("mode 50593792", "landed 2", "RTL: land at destination", "landed 4", "Landing detected", "landed 1")
"""PX4's where the height and the velocity that its estimator erred by decide; see the test below."""
AFTER_LANDING = ("Disarmed by landing", "armed 0", "mode 393216", "status 0")
TOLD_LATE = "Arming denied: Resolve system health failures firs"
"""PX4 keeps the texts of its first 2.5 s to itself until then."""


def test_px4_does_what_it_was_recorded_to_do_when_it_was(px4):
    """Issue 4: within 0.1 s. AUTOPILOT.md 2: arming, takeoff detection, loss of the stream, its return, RTL."""
    late = {
        (event.what, event.by_s): late
        for event, late in px4.happened
        if event.what not in NEAR_THE_GROUND and not (event.what in AFTER_LANDING and event.by_s > 190.0)
    }
    late = {key: value for key, value in late.items() if key[0] != TOLD_LATE or key[1] > 2.7}
    assert {what for what, _ in late} >= {
        "Armed by external command",
        "Takeoff detected",
        "landed 3",
        "Failsafe activated",
        "mode 196608",
        "mode 393216",
        "Returning to launch",
    }
    assert not {key: value for key, value in late.items() if abs(value) > GOAL_S}


@pytest.mark.parametrize("what", NEAR_THE_GROUND)
@pytest.mark.xfail(
    strict=True,
    reason="the recorded estimate is decimetres off, home itself 0.25 m, and takes the landed vehicle for moving",
)
def test_px4_ends_takeoff_return_and_landing_when_it_was_recorded_to(px4, what):
    """Missed goals: 0.2 s late, 0.2 s early, 3.5 s early; docs/sitl.md says why."""
    assert abs(px4.late(what)) <= GOAL_S


def test_px4_disarms_as_long_after_landing_as_recorded(px4):
    """AUTOPILOT.md 2: auto-disarm 2 s after landing."""
    assert px4.late("Disarmed by landing") - px4.late("Landing detected") == pytest.approx(0.0, abs=GOAL_S)


def test_arducopter_does_what_it_was_recorded_to_do_when_it_was(arducopter):
    """Issue 4: within 0.1 s. AUTOPILOT.md 3: all of the boot, two takeoffs, return, landing and both disarmings."""
    assert {event.what for event, _ in arducopter.happened} >= {
        "ArduPilot Ready",
        "EKF3 IMU0 is using GPS",
        "Arming motors",
        "landed 3",
        "landed 2",
        "landed 4",
        "landed 1",
        "Disarming motors",
    }
    assert not [(event, late) for event, late in arducopter.happened if abs(late) > GOAL_S]


def test_braking_after_the_stream_stopped_begins_when_recorded(arducopter):
    """AUTOPILOT.md 3: last velocity for 3.0 s (GUID_TIMEOUT), then to zero."""
    braking = []
    for moved in (arducopter.simulated, arducopter.recorded):
        times = np.arange(120.0, 130.0, 0.01)
        braking.append(times[np.nonzero(moved.at(times).velocity[:, 0] < 2.5)[0][0]])
    assert braking[0] == pytest.approx(braking[1], abs=GOAL_S)
    assert arducopter.simulated.at(np.array([128.0])).velocity[0] == pytest.approx((0.0, 0.0, 0.0), abs=0.15)


@pytest.mark.parametrize("start", [57.42, 65.42, 71.42, 77.42])
def test_arducopter_ends_its_steps_when_recorded(arducopter, start):
    """AUTOPILOT.md 4: t90 2.35, 2.27, 2.8, 3.31 s of the first four steps."""
    step = next(step for step in arducopter.steps if abs(step.time_s - start) < 0.1)
    simulated, recorded = (step.reached(moved, 0.9) for moved in (arducopter.simulated, arducopter.recorded))
    assert simulated == pytest.approx(recorded, abs=0.3)


def greatest_tilt(frames: list[Stamped], start: float, end: float) -> float:
    """Of the ATTITUDEs told in a time [deg]."""
    told = [one.message for one in frames if one.frame.name == "ATTITUDE" and start <= one.time_s < end]
    return math.degrees(max(math.acos(math.cos(m.roll) * math.cos(m.pitch)) for m in told))


@pytest.mark.parametrize(
    ("start", "end", "asked", "overshoot", "tilt"),
    [(57.42, 65.4, 5.0, 0.021, 21.0), (77.42, 85.4, math.hypot(5.66, 5.66), 0.019, 28.0)],
)
def test_arducopter_overshoots_and_tilts_as_recorded(arducopter, start, end, asked, overshoot, tilt):
    """AUTOPILOT.md 4: overshoot 2.1 % and 21 deg to 5 m/s north, 1.9 % and 28 deg to 8 m/s diagonal."""
    velocity = arducopter.simulated.at(np.arange(start, end, 0.02)).velocity
    assert np.hypot(velocity[:, 0], velocity[:, 1]).max() / asked - 1.0 == pytest.approx(overshoot, abs=0.02)
    assert greatest_tilt(arducopter.said, start, end) == pytest.approx(tilt, abs=2.5)
    assert greatest_tilt(arducopter.frames, start, end) == pytest.approx(tilt, abs=1.5)


@pytest.mark.parametrize("height", [0.1, 5.0, 9.85])
def test_arducopter_is_at_a_height_of_its_takeoff_when_recorded(arducopter, height):
    """Lifted off 1.4 s after the command, at 9.85 m after 7.9 s, at 2.5 m/s in between."""
    times = np.arange(43.7, 54.4, 0.02)
    passed = [
        times[moved.at(times).position[:, 2] < -height][0] for moved in (arducopter.simulated, arducopter.recorded)
    ]
    assert passed[0] == pytest.approx(passed[1], abs=0.6)


def test_a_recording_cut_again_is_the_same(tmp_path):
    """Cutting keeps what a replay needs: motion, events and all that the client sent, on vehicle time."""
    whole = on_vehicle_time(read(PX4.path))
    again = cut(whole, CLIENT)
    write(tmp_path / "again.tlog.gz", again)
    back = on_vehicle_time(read(tmp_path / "again.tlog.gz"))
    assert [one.frame for one in back if one.frame.system == CLIENT] == [
        one.frame for one in whole if one.frame.system == CLIENT
    ]
    assert events(back) == events(whole)
    assert np.allclose(motion(back).velocity, motion(whole).velocity)
    assert math.isclose(back[-1].time_s, whole[-1].time_s, abs_tol=1e-3)


def test_a_recording_without_a_clock_is_refused():
    with pytest.raises(ValueError, match="no frame that tells"):
        on_vehicle_time([one for one in read(PX4.path) if one.frame.system == CLIENT])


def test_px4_falls_short_of_5_north_by_drag_as_recorded(px4):
    """SIH's drag keeps the velocity 10 to 13 % short of the command 8 s after the step."""
    step = next(step for step in px4.steps if step.after[0] == 5.0)
    ends = np.array([step.end_s])
    assert px4.simulated.at(ends).velocity[0, 0] == pytest.approx(px4.recorded.at(ends).velocity[0, 0], abs=0.2)
