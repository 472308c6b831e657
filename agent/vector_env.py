"""The Gymnasium front of many worlds: `gymnasium.make_vec("AerialStar-v0", num_envs=1024)`."""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space, iterate
from torch import Tensor

from agent.environment import Environment, Step
from agent.spaces import Arrays, Form, Interface, Tensors, as_arrays
from rf_model.scenario import Scenario, preset


class AerialStarVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """B worlds of `agent.gym_env.AerialStarEnv`, stepped together as tensors; spaces, rewards and ends are its.

    ## Autoreset
    All worlds start together and are truncated together. What then follows is declared in `metadata`:

    - `AutoresetMode.SAME_STEP`: that step returns the first observations of the next episode, and in `info` the last
      ones of this episode as `final_obs` and its own `info` as `final_info`, with Gymnasium's masks `_final_obs` and
      `_final_info`.
    - `AutoresetMode.NEXT_STEP`: that step returns the last observations; the next one ignores its actions, gives no
      reward and returns the first observations of the next episode. Gymnasium's observation wrappers ask for this one.

    ## Randomness
    One `torch.Generator`, on the device: the same seed, batch size and device give the same rollout, bit for bit. No
    row feels what is done in another. With `num_envs=1` the worlds are those of `AerialStarEnv` for that seed.

    ## Arguments
    Those of `AerialStarEnv`, and

    | name | default | what |
    | --- | --- | --- |
    | `device` | `"cpu"` | where the worlds live: `"cpu"`, `"cuda"`, `"cuda:1"` |
    | `tensors` | `False` | return tensors on the device instead of NumPy arrays; then also `final_obs` is batched |
    | `autoreset_mode` | `SAME_STEP` | or `NEXT_STEP` |

    Actions may be NumPy arrays or tensors in either case. `info` of a step holds `rate_bps` [B, J], `power_w` [B] and
    `position_enu` [B, 3]. A raw action that is not finite raises `RawActionError` whichever row it is in.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Scenario | str = "physical_small",
        action_form: Form = "flat",
        observation_form: Form = "flat",
        acceleration_mps2: float | None = None,
        device: str | torch.device = "cpu",
        tensors: bool = False,
        autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs: {num_envs} must be at least 1")
        if autoreset_mode not in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
            raise ValueError(f"autoreset_mode: {autoreset_mode!r} is not SAME_STEP or NEXT_STEP")
        self.metadata = {"render_modes": [], "autoreset_mode": autoreset_mode}
        self.num_envs = num_envs
        self.scenario = preset(scenario) if isinstance(scenario, str) else scenario
        self.device = torch.device(device)
        self._tensors = tensors
        self._environment = Environment(self.scenario, num_envs, 0, acceleration_mps2, self.device)
        self._interface = Interface(self.scenario, action_form, observation_form)
        self.single_action_space = self._interface.action_space
        self.single_observation_space = self._interface.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every world; a seed fixes all that follow. Raises ValueError for a reset of some."""
        if options is not None and "reset_mask" in options:
            raise ValueError("reset_mask: not possible, all worlds start and end together")
        super().reset(seed=seed)
        with torch.no_grad():
            return self._given(self._interface.observed(self._begun())), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:  # noqa: ANN401 - as the space has it
        with torch.no_grad():
            if self._environment.slot == self.scenario.slots:  # only in NEXT_STEP
                return self._returned(self._begun(), torch.zeros(self.num_envs, device=self.device), False, {})
            step = self._environment.step(self._interface.raw(actions, self.device))
            observation, info = step.observation, self._info(step)
            if step.truncated and self.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP:
                info = _masked({"final_obs": self._final(observation), "final_info": info}, self.num_envs)
                observation = self._begun()
            return self._returned(observation, step.reward, step.truncated, info)

    def _returned(
        self, observation: Tensor, reward: Tensor, truncated: bool, info: dict[str, Any]
    ) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        never = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        return (
            self._given(self._interface.observed(observation)),
            self._given(reward),
            self._given(never),
            self._given(torch.full_like(never, truncated)),
            info,
        )

    def _begun(self) -> Tensor:
        self._environment.generator.manual_seed(int(self.np_random.integers(2**63)))
        return self._environment.reset()

    def _info(self, step: Step) -> dict[str, Any]:
        assert self._environment.world is not None
        info = {
            "rate_bps": step.rates.rate_bps,
            "power_w": step.power_w,
            "position_enu": self._environment.world.position_enu.clone(),
        }
        return _masked({name: self._given(values) for name, values in info.items()}, self.num_envs)

    def _final(self, observation: Tensor) -> Any:  # noqa: ANN401 - as the space has it
        """Last observations of an episode; as arrays, an object for each world, as Gymnasium's wrappers expect."""
        last = self._given(self._interface.observed(observation))
        if self._tensors:
            return last
        rows = np.full(self.num_envs, None, dtype=object)
        for row, of_world in enumerate(iterate(self.observation_space, last)):
            rows[row] = of_world
        return rows

    def _given(self, values: Tensors) -> Tensors | Arrays:
        return values if self._tensors else as_arrays(values)


def _masked(info: dict[str, Any], worlds: int) -> dict[str, Any]:
    """With Gymnasium's masks of which worlds have each entry (all)."""
    return info | {f"_{name}": np.ones(worlds, np.bool_) for name in info}
