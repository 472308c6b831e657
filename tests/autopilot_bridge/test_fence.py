"""Fences of every shape, and what the envelope promises about them, against geometry written apart."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from autopilot_bridge.config import Limits
from autopilot_bridge.envelope import Envelope
from autopilot_bridge.fence import Box, Cylinder, Polygon, outside_m

LIMITS = Limits(horizontal_mps=10, up_mps=3, down_mps=1.5, acceleration_mps2=2.5, vertical_acceleration_mps2=1.0)
BAND = (5.0, 35.0)
STEP_S = 0.05
SLACK_M = 1e-3

SQUARE = ((-30, -20), (30, -20), (30, 20), (-30, 20))
ELL = ((0, 0), (40, 0), (40, 12), (12, 12), (12, 40), (0, 40))
NOTCH = ((-30, -30), (30, -30), (30, 30), (0.2, 30), (0, -20), (-0.2, 30), (-30, 30))
"""A slit of 0.4 m reaches deep into it."""
SPIKES = ((0, 0), (20, 1), (40, 0), (39, 20), (40, 40), (21, 12), (19, 39), (0, 40), (8, 22))
CLOCKWISE = ELL[::-1]
STRAIGHT_ON = ((0, 0), (10, 0), (20, 0), (40, 0), (40, 20), (40, 40), (20, 40), (20, 20), (0, 20))
"""Corners on straight sides."""
AISLE = ((-40, 0), (40, 0), (40, 0.3), (-40, 0.3))


def winding_number(point, vertices):
    """Turns of the boundary about the point, from angles."""
    angles = [math.atan2(y - point[1], x - point[0]) for x, y in vertices]
    turns = sum(math.remainder(b - a, math.tau) for a, b in zip(angles, angles[1:] + angles[:1], strict=True))
    return round(turns / math.tau)


def distance_to_boundary(point, vertices):
    fine = np.linspace(0, 1, 4001)[:, None]
    sides = zip(map(np.array, vertices), map(np.array, vertices[1:] + vertices[:1]), strict=True)
    return min(np.hypot(*(a + fine * (b - a) - point).T).min() for a, b in sides)


def polygon_contains(vertices, slack_m=0.0):
    def contains(point):
        return winding_number(point, vertices) != 0 or (
            slack_m > 0 and distance_to_boundary(np.asarray(point), vertices) <= slack_m + 0.01
        )

    return contains


def inside(fence, position, slack_m=0.0):
    """Written apart from the fences."""
    x, y, z = position
    if not fence.altitude[0] - slack_m <= z <= fence.altitude[1] + slack_m:
        return False
    if isinstance(fence, Box):
        return all(
            low - slack_m <= c <= high + slack_m for c, (low, high) in zip((x, y), (fence.x, fence.y), strict=True)
        )
    if isinstance(fence, Cylinder):
        return math.dist((x, y), fence.centre) <= fence.radius + slack_m
    return polygon_contains(fence.polygon, slack_m)((x, y))


@st.composite
def stars(draw):
    """Simple polygons with as many notches as spikes."""
    radii = draw(st.lists(st.floats(2, 40), min_size=5, max_size=12))
    angles = np.arange(len(radii)) * math.tau / len(radii)
    return tuple((r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True))


polygons = st.sampled_from([SQUARE, ELL, NOTCH, SPIKES, CLOCKWISE, STRAIGHT_ON, AISLE]) | stars()
fences = (
    st.builds(Polygon, polygon=polygons, altitude=st.just(BAND))
    | st.builds(Cylinder, centre=st.just((5.0, -3.0)), radius=st.floats(3, 40), altitude=st.just(BAND))
    | st.builds(Box, x=st.just((-30, 30)), y=st.just((-20, 20)), z=st.just(BAND))
)
commands = arrays(float, 3, elements=st.floats(-100, 100) | st.sampled_from([np.nan, np.inf, -np.inf, 0.0]))
sequences = st.lists(st.tuples(commands, st.integers(1, 50)), min_size=1, max_size=4)


def fly(position, velocity, command, shares_out, substeps=5):
    """Positions and the velocity after one step of a vehicle by small Euler steps.

    `shares_out`: the velocity goes straight to the command; else level and vertical parts each at their own limit.
    """
    dt = STEP_S / substeps
    most = np.array([2.5, 2.5, 1.0])
    track = []
    for _ in range(substeps):
        change = command - velocity
        if shares_out:
            effort = np.linalg.norm(change / most) / dt
            new = velocity + change / max(1.0, effort)
        else:
            level = np.hypot(*change[:2]) / (2.5 * dt)
            new = velocity + np.append(change[:2] / max(1.0, level), np.clip(change[2], -dt, dt))
        position, velocity = position + (velocity + new) / 2 * dt, new
        track.append(position)
    return track, velocity


@st.composite
def places(draw):
    """A fence and a position inside it, often right at a wall."""
    fence = draw(fences)
    east, north = (np.linspace(-41, 41, 14) + draw(st.floats(-2.5, 2.5)) for _ in range(2))
    height = draw(st.floats(*BAND))
    grid = [np.array([x, y, height]) for x in east for y in north if inside(fence, (x, y, height))]
    position = grid[draw(st.integers(0, len(grid) - 1))] if grid else np.array([0.01, 0.01, height])
    heading, share = draw(st.floats(0, math.tau)), draw(st.sampled_from([0.0, 0.5, 1.0]))
    steps = [np.array([math.cos(heading), math.sin(heading), 0.0]) * length for length in np.arange(0, 60, 0.2)]
    reach = next(i for i, step in enumerate(steps) if not inside(fence, position + step) or i == len(steps) - 1)
    return fence, position + steps[int(share * max(reach - 1, 0))]


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(places(), arrays(float, 3, elements=st.floats(-8, 8)), sequences, st.sampled_from([0.0, 0.5]), st.booleans())
def test_from_a_state_that_can_stop_inside_no_commands_lead_out(placed, velocity, sequence, reaction_s, shares_out):
    fence, position = placed
    assume(inside(fence, position))
    gate = Envelope(LIMITS, fence, reaction_s, STEP_S, lambda velocity, yaw: None)
    shares = np.linspace(0, 1, 400)[:, None]
    for _ in range(12):  # until it can stop inside
        effort = np.linalg.norm(velocity / [2.5, 2.5, 1.0])
        stop = velocity * (reaction_s + effort / 2)
        if all(inside(fence, point) for point in position + shares * stop):
            break
        velocity = velocity / 2
    else:
        velocity = np.zeros(3)
    for command, steps in sequence:
        for _ in range(steps):
            sent = gate.clip(command, position, velocity)
            assert np.isfinite(sent.velocity).all()
            track, velocity = fly(position, velocity, sent.velocity, shares_out)
            position = track[-1]
            assert all(inside(fence, point, SLACK_M) for point in track)


def left_of(a, b, c):
    """Whether c lies to the left of the line from a to b."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0


def distance_to_segment(point, segment):
    a, b = segment
    return np.hypot(*(a + np.linspace(0, 1, 1001)[:, None] * (b - a) - point).T).min()


@given(polygons, arrays(float, (2, 2), elements=st.floats(-45, 45)))
def test_a_polygon_holds_a_line_that_begins_inside_and_crosses_no_side(vertices, line):
    assume(all(distance_to_boundary(end, vertices) > 0.05 for end in line))
    assume(all(distance_to_segment(vertex, line) > 0.05 for vertex in vertices))
    p, q = line
    crosses = any(
        left_of(a, b, p) != left_of(a, b, q) and left_of(p, q, a) != left_of(p, q, b)
        for a, b in zip(vertices, vertices[1:] + vertices[:1], strict=True)
    )
    held = Polygon(polygon=vertices, altitude=BAND).holds(line.tolist())
    assert held == (winding_number(p, vertices) != 0 and not crosses)


@given(fences, arrays(float, 2, elements=st.floats(-45, 45)), arrays(float, (4, 2), elements=st.floats(-15, 15)))
def test_what_is_near_tells_of_paths_near_it_as_much_as_the_whole(fence, place, steps):
    path = [(east, north) for east, north in (place + steps).tolist()]
    radius = max(math.dist(place, point) for point in path)
    near = fence.near(tuple(place.tolist()), radius)
    assert fence.holds(path) == (near is None or near.holds(path))
    if near is None:
        assert all(inside(fence, (*point, 20.0)) for point in path)


@given(polygons, arrays(float, 2, elements=st.floats(-45, 45)), st.floats(0, 40))
@example(((2, 0), (1, 1.7), (-2.5, 4.330127018922194), (-2, 2.5e-16), (-1, -1.7), (1, -1.7)), np.array([-8.0, 0]), 0.0)
def test_how_far_outside(vertices, place, height):
    assume(distance_to_boundary(place, vertices) > 0.05)
    fence = Polygon(polygon=vertices, altitude=BAND)
    sideways = 0.0 if winding_number(place, vertices) else distance_to_boundary(place, vertices)
    expected = max(sideways, BAND[0] - height, height - BAND[1], 0)
    assert outside_m(fence, np.append(place, height)) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(
    "fence", [Polygon(polygon=ELL, altitude=BAND), Cylinder(centre=(6, 6), radius=6, altitude=BAND)]
)
def test_slides_along_a_slanting_or_round_wall(fence):
    """Pushed against it for long, the vehicle neither leaves nor stops."""
    position, velocity = np.array([6.0, 6.0, 20.0]), np.zeros(3)
    gate = Envelope(LIMITS, fence, 0.5, STEP_S, lambda velocity, yaw: None)
    travelled = 0.0
    for step in range(400):
        sent = gate.clip(np.array([2.0, 1.0 if step < 200 else -1.0, 0.0]), position, velocity)
        track, velocity = fly(position, velocity, sent.velocity, shares_out=True)
        travelled += math.dist(position, track[-1])
        position = track[-1]
        assert inside(fence, position, SLACK_M)
    assert travelled > 8.0


def test_a_vehicle_a_hair_outside_may_not_go_further_out_on_its_way_to_the_other_side():
    """At the slit's wall, with a stop beyond the slit: the way there is 0.2 m outside."""
    gate = Envelope(LIMITS, Polygon(polygon=NOTCH, altitude=BAND), 0.0, STEP_S, lambda velocity, yaw: None)
    wall = -0.2 * (20 + 20) / 50
    sent = gate.clip(np.array([1.5, 0.0, 0.0]), np.array([wall + 2e-5, 20.0, 20.0]), np.array([1.5, 0.0, 0.0]))
    assert sent.reasons == ("fence",)
    assert sent.velocity[0] <= 0.0


def test_a_slit_is_not_jumped_over():
    fence = Polygon(polygon=NOTCH, altitude=BAND)
    gate = Envelope(LIMITS, fence, 0.0, STEP_S, lambda velocity, yaw: None)
    position, velocity = np.array([-5.0, 20.0, 20.0]), np.zeros(3)
    for _ in range(200):
        sent = gate.clip(np.array([10.0, 0.0, 0.0]), position, velocity)
        track, velocity = fly(position, velocity, sent.velocity, shares_out=True)
        position = track[-1]
    assert -0.5 < position[0] < 0.0
    assert "fence" in sent.reasons


@pytest.mark.parametrize(
    "fence",
    [
        Box(x=(-30, 30), y=(-20, 20), z=BAND),
        Cylinder(centre=(0, 0), radius=30, altitude=BAND),
        Polygon(polygon=SQUARE, altitude=BAND),
    ],
)
def test_a_vehicle_that_was_blown_out_may_come_back_but_not_go_further(fence):
    gate = Envelope(LIMITS, fence, 0.5, STEP_S, lambda velocity, yaw: None)
    out = np.array([30.8, 0.0, 20.0])
    assert gate.clip(np.array([-1.0, 0.0, 0.0]), out, np.zeros(3)).reasons == ()
    further = gate.clip(np.array([1.0, 0.0, 0.0]), out, np.zeros(3))
    assert further.velocity == pytest.approx(np.zeros(3), abs=1e-3)
    assert further.reasons == ("fence",)


@pytest.mark.parametrize("beside", [-1.0, 0.0, 1.0])
def test_a_vehicle_blown_out_past_a_sharp_corner_is_called_straight_back(beside):
    """Against the normal of either side it would be sent past the corner."""
    needle = Polygon(polygon=((0, 0), (-60, -4), (-60, 4)), altitude=BAND)
    gate = Envelope(LIMITS, needle, 0.5, STEP_S, lambda velocity, yaw: None)
    out, velocity = np.array([3.0, beside, 20.0]), np.array([0.5, 0.0, 0.0])
    sent = gate.clip(np.array([2.0, 0.0, 0.0]), out, velocity)
    stop = gate.stop(out, velocity)[:2]
    assert sent.reasons == ("fence",)
    assert sent.velocity[:2] / np.linalg.norm(sent.velocity) == pytest.approx(-stop / np.linalg.norm(stop), abs=0.01)


@pytest.mark.parametrize(
    ("shape", "fields", "told"),
    [
        (Polygon, {"polygon": [(0, 0), (1, 0)]}, "at least 3"),
        (Polygon, {"polygon": [(0, 0), (10, 10), (10, 0), (0, 10)]}, r"sides from \(0.0, 0.0\) and from \(10.0, 0.0\)"),
        (Polygon, {"polygon": [(0, 0), (10, 0), (10, 10), (5, 0)]}, "must not meet"),
        (Polygon, {"polygon": [(0, 0), (10, 0), (5, 0)]}, "must not meet"),
        (Polygon, {"polygon": [(0, 0), (10, 0), (10, 0), (0, 10)]}, "0.01 m apart"),
        (Polygon, {"polygon": [(0, 0), (10, 0), (float("nan"), 10)]}, "finite"),
        (Polygon, {"polygon": [(0, 0), (10, 0), ("10", 10)]}, "valid number"),
        (Polygon, {"polygon": ELL, "altitude": (30, 5)}, "minimum must be below"),
        (Cylinder, {"centre": (0, 0), "radius": 0}, "greater than 0"),
        (Cylinder, {"centre": (0, 0)}, "radius"),
    ],
)
def test_what_is_no_fence_is_refused(shape, fields, told):
    with pytest.raises(ValidationError, match=told):
        shape(**({"altitude": BAND} | fields))


def test_a_polygon_may_be_closed_by_hand():
    assert Polygon(polygon=(*ELL, ELL[0]), altitude=BAND) == Polygon(polygon=ELL, altitude=BAND)
