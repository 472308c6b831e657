"""Fence geometry against winding numbers and brute force."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.geofence import Breach, Circle, Fence, Polygon, areas, bent, stoppable
from sitl.origin import Origin
from sitl.plan import CIRCLE_EXCLUSION, POLYGON_INCLUSION, Item

HOME = (0.0, 0.0, 0.0)
coordinates = st.floats(-100, 100)
points = st.tuples(coordinates, coordinates)


@st.composite
def star_polygons(draw):
    """Polygons around the origin: one vertex per direction, so they do not cross themselves."""
    count = draw(st.integers(3, 9))
    radii = draw(st.lists(st.floats(5, 80), min_size=count, max_size=count))
    return tuple(
        (r * math.cos(2 * math.pi * i / count), r * math.sin(2 * math.pi * i / count)) for i, r in enumerate(radii)
    )


def winding(vertices, point):
    """Turns of the line around a point, from the sum of angles."""
    total = 0.0
    for i, b in enumerate(vertices):
        a = vertices[i - 1]
        start = math.atan2(a[1] - point[1], a[0] - point[0])
        end = math.atan2(b[1] - point[1], b[0] - point[0])
        total += math.remainder(end - start, 2 * math.pi)
    return round(total / (2 * math.pi))


@given(star_polygons(), points)
def test_inside_is_where_the_line_winds_round(vertices, point):
    polygon = Polygon(vertices, inclusion=True)
    if min(math.dist(wall, point) for wall in polygon.nearest(point)) > 1e-6:
        assert polygon.contains(point) == (winding(vertices, point) != 0)


@settings(max_examples=50)
@given(star_polygons(), points)
def test_nearest_point_of_a_polygon_is_the_nearest_of_many(vertices, point):
    polygon = Polygon(vertices, inclusion=True)
    samples = [
        (a[0] + s / 200 * (b[0] - a[0]), a[1] + s / 200 * (b[1] - a[1]))
        for a, b in zip(vertices, (*vertices[1:], vertices[0]), strict=True)
        for s in range(201)
    ]
    best = min(math.dist(sample, point) for sample in samples)
    found = min(math.dist(wall, point) for wall in polygon.nearest(point))
    assert found <= best + 1e-9
    assert found == pytest.approx(best, abs=1.0)


def test_inclusions_exclusions_and_limits():
    left, right = Circle((0.0, -10.0), 15.0, True), Circle((0.0, 10.0), 15.0, True)
    hole = Circle((0.0, 0.0), 2.0, False)
    anywhere = Fence((left, right, hole))
    assert anywhere.breach((0.0, 20.0, -5.0), HOME) is Breach.NONE
    assert anywhere.breach((0.0, 1.0, -5.0), HOME) is Breach.BOUNDARY
    assert anywhere.breach((0.0, 30.0, -5.0), HOME) is Breach.BOUNDARY
    everywhere = Fence((left, right, hole), any_inclusion=False)
    assert everywhere.breach((0.0, 20.0, -5.0), HOME) is Breach.BOUNDARY
    assert everywhere.breach((0.0, 4.0, -5.0), HOME) is Breach.NONE
    limited = Fence(radius=50.0, height_max=30.0, height_min=-5.0)
    assert limited.breach((0.0, 51.0, -5.0), HOME) is Breach.BOUNDARY
    assert limited.breach((0.0, 0.0, -30.5), HOME) is Breach.MAXALT
    assert limited.breach((0.0, 0.0, -29.5), (0.0, 0.0, -2.0)) is Breach.NONE  # heights are above home
    assert limited.breach((0.0, 0.0, 6.0), HOME) is Breach.MINALT
    assert not Fence().there
    assert Fence().breach((1e6, 1e6, -1e6), HOME) is Breach.NONE


def test_areas_of_uploaded_items():
    origin = Origin()

    def at(command, north, east, p1):
        latitude, longitude = origin.globe(north, east)
        return Item(0, command, (p1, 0.0, 0.0, 0.0), round(latitude * 1e7), round(longitude * 1e7), 0.0)

    corners = ((10.0, 0.0), (-10.0, 10.0), (-10.0, -10.0))
    triangle = tuple(at(POLYGON_INCLUSION, n, e, 3.0) for n, e in corners)
    polygon, circle = areas((*triangle, at(CIRCLE_EXCLUSION, 5.0, 6.0, 7.5)), origin)
    assert isinstance(polygon, Polygon)
    for vertex, corner in zip(polygon.vertices, corners, strict=True):
        assert vertex == pytest.approx(corner, abs=0.02)
    assert isinstance(circle, Circle)
    assert circle.centre == pytest.approx((5.0, 6.0), abs=0.02)
    assert (polygon.inclusion, circle.inclusion, circle.radius) == (True, False, 7.5)


@settings(max_examples=40, deadline=None)
@given(star_polygons(), st.floats(-6, 6), st.floats(-6, 6), st.floats(-3, 3))
def test_a_vehicle_that_obeys_the_bent_velocity_never_leaves(vertices, north, east, down):
    fence = Fence((Polygon(vertices, True),), any_inclusion=False, radius=60.0, height_max=25.0)
    place = (0.0, 0.0, -10.0)
    if fence.breach(place, HOME) is not Breach.NONE:
        return
    for _ in range(400):
        v = bent((north, east, down), place, HOME, fence, 0.5, 1.0, 2.5)
        assert math.hypot(v[0], v[1]) <= math.hypot(north, east) + 1e-9  # never faster than asked
        place = (place[0] + 0.1 * v[0], place[1] + 0.1 * v[1], min(place[2] + 0.1 * v[2], 0.0))
        assert fence.breach(place, HOME) is Breach.NONE


def test_bending_slides_along_and_leaves_the_way_back_alone():
    fence = Fence((Circle((0.0, 0.0), 20.0, True),))
    assert bent((5.0, 5.0, 0.0), (18.0, 0.0, -5.0), HOME, fence, 2.0, 1.0, 2.5) == pytest.approx((0.0, 5.0, 0.0))
    assert bent((-5.0, 1.0, 0.5), (18.0, 0.0, -5.0), HOME, fence, 2.0, 1.0, 2.5) == (-5.0, 1.0, 0.5)
    assert bent((5.0, 0.0, 0.0), (30.0, 0.0, -5.0), HOME, fence, 2.0, 1.0, 2.5) == (5.0, 0.0, 0.0)  # already outside


@given(st.floats(0.0, 50.0))
def test_stoppable_speed_stops_in_time(distance):
    """v^2 / 2a never exceeds the distance."""
    speed = stoppable(distance, 1.0, 2.5)
    assert speed * speed / 5.0 <= distance + 1e-9
