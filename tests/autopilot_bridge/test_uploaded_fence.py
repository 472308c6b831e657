"""Fences uploaded to the autopilot: read by both back ends (test_vehicle_contract.py), judged here before a flight."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.fence import Box
from autopilot_bridge.uploaded_fence import FenceItem, areas, objection
from sitl.origin import Origin

INSIDE, OUTSIDE = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
ROUND_INSIDE, ROUND_OUTSIDE = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
ORIGIN = Origin()
HOME = (ORIGIN.latitude, ORIGIN.longitude, ORIGIN.altitude)
BOX = Box(x=(20.0, 60.0), y=(-20.0, 20.0), z=(8.0, 40.0))
START = (40.0, 0.0)


def polygon(command, *corners):
    """Corners are east, north [m]."""
    return [(command, float(len(corners)), *ORIGIN.globe(north, east)) for east, north in corners]


def rectangle(command, west, east, south, north):
    return polygon(command, (west, south), (east, south), (east, north), (west, north))


def circle(command, radius, east=0.0, north=0.0):
    return [(command, radius, *ORIGIN.globe(north, east))]


def said(*uploads, any_inclusion=True, box=BOX, start=START):
    items = [FenceItem(*item) for upload in uploads for item in upload]
    return objection(areas(items, HOME), any_inclusion, box, start, 2.0)


def test_what_was_uploaded_is_where_it_was_drawn():
    items = rectangle(INSIDE, -10, 90, -50, 50) + circle(ROUND_OUTSIDE, 12.0, 70.0, -30.0)
    first, second = areas([FenceItem(*item) for item in items], HOME)
    assert first.inclusion
    assert not second.inclusion
    assert np.array(first.shape.polygon) == pytest.approx(
        np.array([(-10, -50), (90, -50), (90, 50), (-10, 50)]), abs=0.01
    )
    assert second.shape.centre == pytest.approx((70, -30), abs=0.01)
    assert str(second) == "exclusion circle of 12.0 m about (70.0, -30.0)"


@pytest.mark.parametrize(
    "uploads",
    [
        [],
        [rectangle(INSIDE, -10, 90, -50, 50)],
        [circle(ROUND_INSIDE, 70.0)],
        [rectangle(OUTSIDE, 63, 90, -50, 50)],
        [circle(ROUND_OUTSIDE, 10.0, 73.0, 0.0)],
        [polygon(OUTSIDE, (5, 5), (18, 25), (5, 60))],  # between the way and the box's corner
        [[(mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT, 0.0, *ORIGIN.globe(0, 0))]],
    ],
)
def test_what_holds_the_flight(uploads):
    assert said(*uploads) == ""


@pytest.mark.parametrize(
    ("uploads", "told"),
    [
        ([rectangle(INSIDE, -10, 61, -50, 50)], "inclusion polygon of 4 corners from (-10.0, -50.0) must hold the box"),
        ([rectangle(INSIDE, 10, 90, -50, 50)], "the way from home to the start"),  # home is outside
        ([polygon(INSIDE, (-10, -50), (90, -50), (90, 50), (40, 0), (-10, 50))], "must hold"),  # a notch into the box
        ([circle(ROUND_INSIDE, 64.0)], "inclusion circle of 64.0 m"),
        ([rectangle(OUTSIDE, 35, 45, -5, 5)], "exclusion polygon"),  # wholly in the box
        ([rectangle(OUTSIDE, -500, 500, -500, 500)], "exclusion polygon"),  # all over it
        ([rectangle(OUTSIDE, 30, 35, -100, 100)], "exclusion polygon"),  # across it, no corner in the other
        ([rectangle(OUTSIDE, 5, 10, -1, 1)], "exclusion polygon"),  # on the way
        ([circle(ROUND_OUTSIDE, 10.0, 71.0, 0.0)], "exclusion circle of 10.0 m about (71.0, 0.0) must be 2 m away"),
        ([circle(ROUND_OUTSIDE, 4.0, 10.0, 5.0)], "exclusion circle"),
        ([rectangle(INSIDE, -10, 90, -50, 50), circle(ROUND_OUTSIDE, 1.0, 40.0, 10.0)], "exclusion circle"),
    ],
)
def test_what_does_not_is_told(uploads, told):
    assert told in said(*uploads)


def test_one_of_several_inclusions_is_enough_for_px4_not_for_arducopter():
    two = [rectangle(INSIDE, -10, 90, -50, 50), rectangle(INSIDE, 200, 300, 0, 100)]
    assert said(*two, any_inclusion=True) == ""
    assert "from (200.0, 0.0) must hold" in said(*two, any_inclusion=False)
    assert "must hold" in said(two[1], any_inclusion=True)


@given(
    st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100)), min_size=3, max_size=3, unique=True),
    st.tuples(st.floats(20, 60), st.floats(-20, 20)),
    st.booleans(),
)
def test_no_place_in_the_box_is_forbidden_when_there_is_no_objection(corners, place, inclusion):
    """Against a second implementation, of triangles by signs."""
    command = INSIDE if inclusion else OUTSIDE
    try:
        wrong = said(polygon(command, *corners))
    except ValueError:
        return
    sides = [
        (bx - ax) * (place[1] - ay) - (by - ay) * (place[0] - ax)
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    within = all(side > 1.0 for side in sides) or all(side < -1.0 for side in sides)
    without = min(sides) < -1.0 and max(sides) > 1.0
    if (inclusion and without) or (not inclusion and within):
        assert wrong


@pytest.mark.parametrize(
    ("items", "told"),
    [
        (polygon(INSIDE, (0, 0), (10, 0), (10, 10))[:2], "its last polygon has 2 corners"),
        (polygon(INSIDE, (0, 0), (10, 10), (10, 0), (0, 10)), "a polygon of 4 corners"),
        (circle(ROUND_INSIDE, 0.0), "a circle's radius is 0 m"),
        (circle(ROUND_INSIDE, math.nan), "a circle's radius is nan m"),
        ([(16, 0.0, 0.0, 0.0)], "MAV_CMD 16 fences nothing that is known"),
    ],
)
def test_what_is_no_fence_is_told(items, told):
    with pytest.raises(ValueError, match=told):
        areas([FenceItem(*item) for item in items], HOME)


PX4 = ("--speed", "10", "--param", "COM_OF_LOSS_T=10")
COPTER = ("--speed", "10", "--personality", "arducopter", "--tcp-port", "0", "--param", "FENCE_ENABLE=1")


@pytest.mark.parametrize("options", [PX4, COPTER], ids=["px4", "arducopter"])
def test_a_flight_that_does_not_fit_into_the_uploaded_fence_is_refused(sitl, fly, bridge_config, options):
    autopilot = sitl(*options)
    autopilot.upload_fence(rectangle(INSIDE, -60, 60, -60, 60) + circle(ROUND_OUTSIDE, 5.0, 53.0, 0.0))
    flight = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 10.0}))
    assert flight.wait() == 1
    (error,) = flight.told("error")
    assert error.startswith("the fence uploaded to the autopilot: exclusion circle of 5.0 m about (53.0, ")
    assert "arming" not in flight.phases
    autopilot.upload_fence(rectangle(INSIDE, -60, 60, -60, 60))
    flight = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 10.0}, autostart=False))
    flight.until_phase("ready")
    assert any("inside the fence uploaded" in text for text in flight.told("preflight"))
    assert flight.command("land").accepted
    assert flight.wait() == 3
