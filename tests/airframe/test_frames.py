import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airframe.frames import enu_to_ned, ned_to_enu, wrap, yaw_enu_to_ned, yaw_ned_to_enu

finite = st.floats(-1e6, 1e6)


@given(finite, finite, finite)
def test_vectors_come_back_from_the_other_frame(x, y, z):
    assert ned_to_enu(*enu_to_ned(x, y, z)) == (x, y, z)


def test_axes():
    assert enu_to_ned(1.0, 2.0, 3.0) == (2.0, 1.0, -3.0)


@pytest.mark.parametrize(
    ("enu_deg", "ned_deg"), [(0, 90), (90, 0), (45, 45), (-90, -180), (180, -90), (-30, 120)]
)  # compass bearings of the ENU headings
def test_yaw_against_the_compass(enu_deg, ned_deg):
    assert yaw_enu_to_ned(math.radians(enu_deg)) == pytest.approx(math.radians(ned_deg))


@given(st.floats(-100, 100))
def test_yaw_comes_back_and_is_wrapped(yaw):
    back = yaw_ned_to_enu(yaw_enu_to_ned(yaw))
    assert -math.pi <= back <= math.pi
    assert math.cos(back - yaw) == pytest.approx(1.0)


@given(st.floats(-3, 3), st.floats(0.1, 10))
def test_a_heading_points_the_same_way_in_both_frames(yaw, length):
    ahead = (length * math.cos(yaw), length * math.sin(yaw), 0.0)
    north, east, _ = enu_to_ned(*ahead)
    assert wrap(math.atan2(east, north) - yaw_enu_to_ned(yaw)) == pytest.approx(0.0, abs=1e-9)
