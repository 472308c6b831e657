"""The flat map about the start."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl.origin import Origin

FAR = st.floats(-20_000.0, 20_000.0)


@given(st.floats(-80.0, 80.0), st.floats(-180.0, 180.0), FAR, FAR)
def test_a_point_comes_back_and_its_longitude_is_one(latitude, longitude, north, east):
    origin = Origin(latitude, longitude, 0.0)
    on_the_globe = origin.globe(north, east)
    assert abs(on_the_globe[1]) <= 180.0
    assert origin.local(*on_the_globe) == pytest.approx((north, east), abs=1e-6)


def test_the_date_line_is_no_border():
    """0.01 deg of longitude at the equator is 1112 m, to either side."""
    assert Origin(0.0, 179.995, 0.0).local(0.0, -179.995) == pytest.approx((0.0, 1111.9), abs=0.1)
    assert Origin(0.0, -179.995, 0.0).local(0.0, 179.995) == pytest.approx((0.0, -1111.9), abs=0.1)
