"""How missions fly: the references of legs against their limits and closed forms."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.flight.reference import Limits, Reference
from sitl.mission_flight import corner_speed, pass_by
from sitl.plan import Item, Kind, Plans, place
from tests.sitl.plans import ORIGIN

LIMITS = Limits(5.0, 3.0, 1.5, 3.0, 4.0, 3.0, 4.0)
DT = 0.01
near = st.floats(-60, 60)
points = st.tuples(near, near, st.floats(-40, 0))


def test_corner_speed_at_known_angles():
    """sqrt(a r tan(alpha/2)): a right angle gives sqrt(a r), 60 degrees back sqrt(a r / sqrt 3), a reversal nothing."""
    corner = (0.0, 0.0, -5.0)
    assert corner_speed((-20, 0, -5), corner, (0, 30, -5), 3.0, 2.0) == pytest.approx(math.sqrt(6.0))
    sharp = (-10 * math.cos(math.pi / 3), 10 * math.sin(math.pi / 3), -5.0)
    assert corner_speed((-20, 0, -5), corner, sharp, 3.0, 2.0) == pytest.approx(math.sqrt(6.0 / math.sqrt(3.0)))
    assert corner_speed((-20, 0, -5), corner, (-10, 0, -5), 3.0, 2.0) == pytest.approx(0.0, abs=1e-3)
    assert corner_speed((-20, 0, -5), corner, (20, 0, -5), 3.0, 2.0) > 50.0  # straight on: no limit of its own
    assert corner_speed(corner, corner, (20, 0, -5), 3.0, 2.0) == 0.0


@settings(max_examples=60, deadline=None)
@given(points, points, st.floats(0.0, 5.0))
def test_a_leg_keeps_its_limits_and_arrives_on_its_line(start, target, end_speed):
    """A vehicle that follows its reference exactly: never faster than the limits, never off the straight line."""
    reference = Reference(start, (0.0, 0.0, 0.0))
    length = math.dist(start, target)
    seconds = 0.0
    while math.dist(reference.position, target) > 0.3 and seconds < 120.0:
        before = reference
        reference = pass_by(reference, target, end_speed, reference.position, LIMITS, DT)
        seconds += DT
        vx, vy, vz = reference.velocity
        assert math.hypot(vx, vy) <= LIMITS.speed_xy + 1e-6
        assert -LIMITS.speed_up - 1e-6 <= vz <= LIMITS.speed_down + 1e-6
        change = math.dist(before.velocity[:2], reference.velocity[:2])
        assert change <= LIMITS.acceleration_xy * DT + 1e-9
        if length > 1e-3:
            share = sum((reference.position[i] - start[i]) * (target[i] - start[i]) for i in range(3)) / length**2
            foot = [start[i] + share * (target[i] - start[i]) for i in range(3)]
            assert math.dist(foot, reference.position) < 1e-6
    assert seconds < 120.0
    if end_speed == 0.0:
        for _ in range(800):
            reference = pass_by(reference, target, 0.0, reference.position, LIMITS, DT)
        assert math.dist(reference.position, target) < 0.02
        assert math.hypot(*reference.velocity) < 0.05


@given(near, near, st.floats(-50, 50))
def test_places_of_items(north, east, up):
    """Relative altitudes are above home, others above mean sea level; 0, 0 is here."""
    latitude, longitude = ORIGIN.globe(north, east)
    home, here = (3.0, 4.0, -2.0), (7.0, 8.0, -9.0)
    x, y = round(latitude * 1e7), round(longitude * 1e7)
    above_home = place(Item(6, 16, (0, 0, 0, 0), x, y, up), ORIGIN, home, here)
    assert above_home == pytest.approx((north, east, -2.0 - up), abs=0.02)
    amsl = place(Item(0, 16, (0, 0, 0, 0), x, y, ORIGIN.altitude + up), ORIGIN, home, here)
    assert amsl == pytest.approx((north, east, -up), abs=0.02)
    assert place(Item(3, 16, (0, 0, 0, 0), 0, 0, up), ORIGIN, home, here) == (7.0, 8.0, -2.0 - up)


def test_plans_begin_at_their_first_item():
    plans = Plans(first=1)
    assert not plans.flyable
    plans.store(Kind.MISSION, (Item(0, 16, (0, 0, 0, 0), 0, 0, 0.0),))
    assert not plans.flyable  # home alone
    plans.store(Kind.MISSION, (Item(0, 16, (0, 0, 0, 0), 0, 0, 0.0),) * 3)
    assert plans.flyable
    assert plans.current == 1
    plans.go_to(2)
    plans.finished, plans.speed, plans.jumps = True, 3.0, {1: 4}
    assert plans.begun
    plans.rewind()
    assert (plans.current, plans.finished, plans.speed, plans.jumps) == (1, False, None, {})
    plans.go_to(0)
    assert plans.current == 1
    before = plans.mission_changes
    plans.store(Kind.FENCE, ())
    assert plans.mission_changes == before
