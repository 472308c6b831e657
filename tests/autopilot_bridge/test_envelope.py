import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autopilot_bridge.config import Limits
from autopilot_bridge.envelope import RESPONSE_S, Envelope
from autopilot_bridge.fence import Box

FENCE = Box(x=(-30, 30), y=(-20, 20), z=(5, 25))
LIMITS = Limits(horizontal_mps=10, up_mps=3, down_mps=1.5, acceleration_mps2=3)
STEP_S = 0.05
MIDDLE = np.array([0.0, 0.0, 15.0])


def envelope(reaction_s=0.7, transmit=lambda velocity, yaw: None):
    return Envelope(LIMITS, FENCE, reaction_s, STEP_S, transmit)


def fly_ideally(position, velocity, command, acceleration, step_s, substeps=10):
    """An acceleration-limited vehicle by small Euler steps, written apart from the envelope's closed form."""
    dt = step_s / substeps
    for _ in range(substeps):
        change = command - velocity
        size = np.linalg.norm(change)
        new = velocity + change * min(1.0, acceleration * dt / size) if size > 0 else velocity
        position, velocity = position + (velocity + new) / 2 * dt, new
    return position, velocity


coordinates = st.tuples(st.floats(*FENCE.x), st.floats(*FENCE.y), st.floats(*FENCE.z)).map(np.array)
commands = arrays(float, 3, elements=st.floats(-100, 100) | st.sampled_from([np.nan, np.inf, -np.inf, 0.0]))


@given(
    coordinates,
    arrays(float, 3, elements=st.floats(-10, 10)),
    st.lists(st.tuples(commands, st.integers(1, 60)), min_size=1, max_size=4),
    st.sampled_from([0.0, 0.3, 0.7]),
)
def test_no_command_sequence_leaves_the_fence(position, velocity, sequence, reaction_s):
    speed = np.linalg.norm(velocity)
    stop = position + velocity * speed / (2 * LIMITS.acceleration_mps2)
    assume(FENCE.contains(tuple(stop)))
    gate = envelope(reaction_s)
    for command, steps in sequence:
        for _ in range(steps):
            sent = gate.clip(command, position, velocity)
            position, velocity = fly_ideally(position, velocity, sent.velocity, LIMITS.acceleration_mps2, STEP_S)
            assert FENCE.contains(tuple(position), margin=-0.01)


@given(coordinates, arrays(float, 3, elements=st.floats(-1.5, 1.5)), commands)
def test_what_is_sent_is_always_flyable(position, velocity, wanted):
    sent = envelope().clip(wanted, position, velocity)
    assert np.isfinite(sent.velocity).all()
    assert np.hypot(*sent.velocity[:2]) <= LIMITS.horizontal_mps + 1e-9
    assert -LIMITS.down_mps - 1e-9 <= sent.velocity[2] <= LIMITS.up_mps + 1e-9
    if "fence" not in sent.reasons and "altitude" not in sent.reasons and "not finite" not in sent.reasons:
        assert np.linalg.norm(sent.velocity - velocity) <= LIMITS.acceleration_mps2 * RESPONSE_S + 1e-9
    assert bool(sent.reasons) == (not np.array_equal(sent.velocity, wanted))


def test_a_harmless_command_passes_unchanged():
    wanted = np.array([2.0, -1.0, 0.5])
    assert envelope().clip(wanted, MIDDLE, np.zeros(3)).reasons == ()


@pytest.mark.parametrize(
    ("wanted", "position", "velocity", "reason"),
    [
        ((np.nan, 0, 0), MIDDLE, (0, 0, 0), "not finite"),
        ((1, 0, 0), (np.nan, 0, 15), (0, 0, 0), "not finite"),
        ((20, 0, 0), MIDDLE, (9, 0, 0), "speed"),
        ((0, 0, -3), MIDDLE, (0, 0, 0), "speed"),
        ((8, 0, 0), MIDDLE, (0, 0, 0), "acceleration"),
        ((4, 0, 0), (29.9, 0, 15), (0, 0, 0), "fence"),
        ((0, 0, -1), (0, 0, 5.01), (0, 0, 0), "altitude"),
    ],
)
def test_says_why(wanted, position, velocity, reason):
    sent = envelope().clip(np.array(wanted, float), np.array(position, float), np.array(velocity, float))
    assert reason in sent.reasons


def test_slides_along_the_fence_instead_of_stopping():
    sent = envelope().clip(np.array([3.0, 3.0, 0.0]), np.array([30.0, 0.0, 15.0]), np.zeros(3))
    assert sent.velocity[0] == pytest.approx(0.0, abs=1e-3)
    assert sent.velocity[1] == pytest.approx(3.0)


def test_only_the_way_back_is_open_to_a_vehicle_at_the_fence():
    inward = np.array([-3.0, 0.0, 0.0])
    assert envelope().clip(inward, np.array([30.0, 0.0, 15.0]), np.zeros(3)).reasons == ()


def test_send_transmits_what_it_returns():
    wire = []
    sent = envelope(transmit=lambda velocity, yaw: wire.append((velocity, yaw))).send(
        np.array([50.0, 0.0, 0.0]), 1.5, MIDDLE, np.zeros(3)
    )
    ((velocity, yaw),) = wire
    assert np.array_equal(velocity, sent.velocity)
    assert yaw == 1.5
