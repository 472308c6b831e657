"""The way home must always be left in the battery."""

import numpy as np
import pytest

from airframe.power import RotaryWing, hover_power, total_power
from autopilot_bridge.config import Limits
from autopilot_bridge.energy import Endurance
from autopilot_bridge.envelope import Envelope
from autopilot_bridge.fence import Box

WING = RotaryWing()
ENDURANCE = Endurance(pack_j=266e3, margin=0.0)
FENCE = Box(x=(-2000, 2000), y=(-2000, 2000), z=(5, 200))
LIMITS = Limits(acceleration_mps2=3)
STILL = np.zeros(3)


def gate(endurance=ENDURANCE):
    return Envelope(LIMITS, FENCE, 0.5, 0.05, lambda velocity, yaw: None, endurance=endurance)


def test_above_home_only_the_descent_counts():
    assert ENDURANCE.needed_j(np.array([0, 0, 60.0])) == pytest.approx(hover_power(WING) * 60 / 0.7)


def test_below_the_return_altitude_the_climb_counts_too():
    climb = total_power(WING, ENDURANCE.panel, 0.0, 0.0, 3.0, 1.0, 0.0) * 20 / 3
    assert ENDURANCE.needed_j(np.array([0, 0, 10.0])) == pytest.approx(climb + hover_power(WING) * 30 / 0.7)


def test_every_metre_of_distance_costs_the_same_and_the_margin_is_on_all_of_it():
    near, far = (ENDURANCE.needed_j(np.array([x, 0, 50.0])) for x in (100.0, 200.0))
    cruise = total_power(WING, ENDURANCE.panel, 5.0, 0.0, 0.0, 1.0, 0.0)
    assert far - near == pytest.approx(100 * cruise / 5)
    with_margin = ENDURANCE.model_copy(update={"margin": 0.5})
    assert with_margin.needed_j(np.array([100.0, 0, 50])) == pytest.approx(1.5 * near)


def test_no_commands_take_it_to_where_there_is_no_way_home_from():
    """Energy falls by the power model as it flies outward and up; whenever it is enough for now, it is for the stop."""
    position, velocity, energy_j = np.array([0, 0, 40.0]), STILL, 30e3
    envelope, clipped = gate(), False
    while energy_j >= ENDURANCE.needed_j(envelope.stop(position, velocity)):
        sent = envelope.clip(np.array([9.0, 3.0, 2.0]), position, velocity, energy_j=energy_j)
        clipped |= "energy" in sent.reasons
        change = sent.velocity - velocity
        new = velocity + change * min(1.0, 3 * 0.05 / max(np.linalg.norm(change), 1e-9))
        position, velocity = position + (velocity + new) / 2 * 0.05, new
        energy_j -= total_power(WING, ENDURANCE.panel, *velocity.tolist(), 1.0, 0.0) * 0.05
    assert clipped
    # One step's power at most is missing when it is told to return.
    assert ENDURANCE.needed_j(envelope.stop(position, velocity)) - energy_j < 30.0


def test_the_way_home_stays_open_when_there_is_too_little():
    out = np.array([1500.0, 0, 50.0])
    home = np.array([-1.0, 0, 0])
    assert gate().clip(home, out, STILL, energy_j=1e3).reasons == ()
    further = gate().clip(-home, out, STILL, energy_j=1e3)
    assert further.reasons == ("energy",)
    assert further.velocity == pytest.approx(STILL, abs=1e-3)


def test_energy_is_no_matter_without_a_pack():
    assert gate(None).clip(np.array([1.0, 0, 0]), np.array([1500.0, 0, 50]), STILL, energy_j=1e3).reasons == ()


def test_a_battery_that_does_not_tell_is_taken_to_be_empty():
    assert ENDURANCE.left_j(0.5) == 133e3
    assert ENDURANCE.left_j(None) < 0
