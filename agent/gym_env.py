"""The Gymnasium front of the environment: `gymnasium.make("AerialStar-v0", scenario="physical_small")`."""

from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from agent.decoding import action_size
from agent.environment import Environment
from agent.observation import state_size
from rf_model.scenario import Scenario, preset

Floats = NDArray[np.float32]


class AerialStarEnv(gymnasium.Env[Floats, Floats]):
    """One UAV-borne STAR-RIS serving J users from a base station for an episode of slots.

    ## Action Space
    `Box(-1, 1, (3 + 3N + 2MJ,))`, decoded by `agent.decoding.decode`; any finite numbers are allowed.

    | num | action |
    | --- | --- |
    | 0-2 | motion: distance, elevation, azimuth (`motion: spherical`), or a vector (`cartesian`) |
    | next N | phase theta_R of each element, times pi |
    | next N | split angle x of each element, from all transmission (-1) to all reflection (1) |
    | next 2MJ | beamforming W [M, J, (re, im)], scaled to full power |
    | last N | sign of theta_T - theta_R = +-pi/2: + where the number is positive |

    ## Observation Space
    `Box(-inf, inf, (3 + 2MN + 2MJ + 2NJ,))`: position and channels (paper eq. 22), see `agent.observation.observe`.

    ## Rewards
    alpha HFI sum R [Mbit/s] - beta P / P_hover for each slot.

    ## Starting State
    The vehicle at the scenario's start, users drawn in their sectors.

    ## Truncation
    After the scenario's `slots`; episodes never terminate.

    ## Arguments
    `scenario`: a `Scenario`, or the name of a preset. `info` holds `rate_bps`, `power_w` and `position_enu`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, scenario: Scenario | str = "physical_small") -> None:
        self.scenario = preset(scenario) if isinstance(scenario, str) else scenario
        self._environment = Environment(self.scenario, batch=1, seed=0)
        self.action_space = gymnasium.spaces.Box(-1, 1, (action_size(self.scenario),), np.float32)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (state_size(self.scenario),), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        super().reset(seed=seed)
        self._environment.generator.manual_seed(int(self.np_random.integers(2**63)))
        return self._environment.reset()[0].numpy(), {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        step = self._environment.step(torch.as_tensor(action, dtype=torch.float32).unsqueeze(0))
        assert self._environment.world is not None
        info = {
            "rate_bps": step.rates.rate_bps[0].numpy(),
            "power_w": step.power_w.item(),
            "position_enu": self._environment.world.position_enu[0].numpy(),
        }
        return step.observation[0].numpy(), step.reward.item(), False, step.truncated, info
