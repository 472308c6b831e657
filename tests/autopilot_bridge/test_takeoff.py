import pytest

from autopilot_bridge.deadman import Moment
from autopilot_bridge.takeoff import SETTLE_S, Takeoff
from autopilot_bridge.vehicle import Mode


def seen(*told):
    """What a takeoff to 4 m in PX4's way makes of (time, mode, height)."""
    takeoff = Takeoff(Mode.HOLD, 4.0)
    return [takeoff.broken_off(mode, height, Moment(time_s, time_s)) for time_s, mode, height in told]


def test_before_it_begins_and_at_its_height_the_same_mode_is_the_autopilots():
    assert not any(
        seen(
            (0, Mode.HOLD, 0.0),
            (9, Mode.HOLD, 0.0),
            (10, Mode.TAKEOFF, 0.0),
            (14, Mode.HOLD, 4.1),
            (99, Mode.HOLD, 5.0),
        )
    )


def test_below_its_height_somebody_has_ended_it():
    up = (1, Mode.TAKEOFF, 2.0)
    assert seen(up, (2, Mode.HOLD, 2.1), (2 + SETTLE_S, Mode.HOLD, 2.1), (2.1 + SETTLE_S, Mode.HOLD, 2.1)) == [
        False,
        False,
        False,
        True,
    ]


@pytest.mark.parametrize("between", [(4, Mode.HOLD, 4.0), (4, Mode.TAKEOFF, 2.0)])
def test_a_vehicle_that_settles_is_on_its_way(between):
    assert not any(seen((1, Mode.TAKEOFF, 2.0), (2, Mode.HOLD, 3.8), between, (6, Mode.HOLD, 3.9)))
