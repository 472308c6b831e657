import numpy as np
import pytest
import torch

from agent.environment import Environment
from agent.inertia import reachable
from airframe.slot_profile import SpeedLimits, reach
from rf_model.scenario import preset

SMALL = preset("physical_small")


@pytest.mark.parametrize("acceleration", [1.0, 3.0, 20.0])
@pytest.mark.parametrize("slot_s", [0.5, 1.0])
def test_it_plans_as_the_bridge_does(acceleration, slot_s):
    """The scalar profile that flies, over chains of random moves."""
    scenario = preset("physical_small", slot_s=slot_s)
    limits = SpeedLimits(scenario.v_max_mps, scenario.climb_up_mps, scenario.climb_down_mps)
    rng = np.random.default_rng(0)
    for _ in range(20):
        velocity = np.zeros(3)
        for _ in range(10):
            wanted = rng.uniform(-1, 1, 3) * scenario.v_max_mps * slot_s * rng.choice([0.1, 0.5])
            wanted[2] = np.clip(wanted[2], -limits.down * slot_s, limits.up * slot_s)
            profile = reach(np.zeros(3), velocity, wanted, slot_s, acceleration, limits)
            made, after = reachable(torch.tensor(velocity), torch.tensor(wanted), acceleration, scenario)
            np.testing.assert_allclose(made, profile.displacement(slot_s), atol=1e-9)
            velocity = profile.at(slot_s).velocity
            np.testing.assert_allclose(after, velocity, atol=1e-9)


def test_an_environment_with_inertia_gathers_speed_and_stops_at_the_box():
    environment = Environment(SMALL, batch=1, seed=0, acceleration_mps2=3.0)
    environment.reset()
    raw = torch.zeros(1, 83)
    raw[0, 1] = 1.0  # north at 10 m a slot
    norths = [0.0]
    for _ in range(16):
        environment.step(raw)
        norths.append(environment.world.position_enu[0, 1].item())
    assert norths[1:4] == pytest.approx([1.5, 6.0, 13.5])
    assert max(np.diff(norths)) <= 10 + 1e-4
    assert norths[-1] == 100
    assert environment.world.velocity_enu[0].tolist() == [0, 0, 0]
