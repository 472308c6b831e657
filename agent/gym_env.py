"""The Gymnasium front of one world: `gymnasium.make("AerialStar-v0", scenario="physical_small")`."""

from typing import Any

import gymnasium
import torch

from agent.environment import Environment
from agent.spaces import Arrays, Form, Interface, as_arrays
from rf_model.scenario import Scenario, preset

CPU = torch.device("cpu")


class AerialStarEnv(gymnasium.Env[Arrays, Arrays]):
    """One UAV-borne STAR-RIS serving J users from a base station for an episode of slots.

    ## Action Space
    `Box(-1, 1, (3 + 3N + 2MJ,), float32)`, decoded by `agent.decoding.decode`, which makes a feasible action of any
    finite numbers. In this order:

    | num | part | min | max | decoded |
    | --- | --- | --- | --- | --- |
    | 3 | `motion` | -1 | 1 | distance, elevation, azimuth (`motion: spherical`), or a vector (`cartesian`) |
    | N | `theta_reflection` | -1 | 1 | phase of reflection of each element, times pi |
    | N | `split` | -1 | 1 | split angle of each element, from all transmission (-1) to all reflection (1) |
    | 2MJ | `beamforming` | -1 | 1 | W [M, J, (re, im)], scaled to full power |
    | N | `sign` | -1 | 1 | sign of theta_T - theta_R = +-pi/2: + where the number is positive |

    This is for `surface: coupled`. `independent` has no `sign` but N `theta_transmission` after `split`; `dual` and
    `conventional` have only `theta_reflection`.

    With `action_form="dict"`: a `Dict` of these parts, `beamforming` being [M, J, 2] and `sign` a `MultiBinary(N)`
    (1: +, 0: -). Most libraries of continuous control take only a `Box`.

    ## Observation Space
    `Box(-inf, inf, (3 + 2MN + 2MJ + 2NJ,), float32)`, the state of paper eq. 22. In this order:

    | num | part | min | max | what |
    | --- | --- | --- | --- | --- |
    | 3 | `position` | -1 | 1 | vehicle in the box, east, north, up |
    | 2NM | `bs_ris` | -inf | inf | H [N, M, (re, im)], base station to surface |
    | 2JM | `direct` | -inf | inf | h_b [J, M, (re, im)], base station to users |
    | 2JN | `ris_user` | -inf | inf | h_s [J, N, (re, im)], surface to users |

    The scenario's `state_extra: [users, time]` adds one or both of

    | num | part | min | max | what |
    | --- | --- | --- | --- | --- |
    | 3J | `users` | -inf | inf | users relative to the vehicle [J, 3], in units of half the box |
    | 1 | `time` | 0 | 1 | slots gone by, of all |

    Channels are relative to the root of their link's mean gain. (`state_norm: raw`: metres and channels as they are.)
    With `observation_form="dict"`: a `Dict` of these parts.

    ## Rewards
    alpha HFI sum R [Mbit/s] - beta P / P_hover for each slot.

    ## Starting State
    The vehicle at the scenario's start, at rest; users drawn evenly over the area of their sectors.

    ## Truncation
    After the scenario's `slots`; episodes never terminate, so learners bootstrap from the last observation.

    ## Arguments
    | name | default | what |
    | --- | --- | --- |
    | `scenario` | `"physical_small"` | a `Scenario`, or the name of a preset |
    | `action_form` | `"flat"` | `"flat"` or `"dict"` |
    | `observation_form` | `"flat"` | `"flat"` or `"dict"` |
    | `acceleration_mps2` | `None` | the vehicle's inertia, see `agent.environment.Environment` |

    `info` of a step holds `rate_bps` [J], `power_w` and `position_enu` [3]. Many worlds at once are faster:
    `agent.vector_env.AerialStarVectorEnv`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(
        self,
        scenario: Scenario | str = "physical_small",
        action_form: Form = "flat",
        observation_form: Form = "flat",
        acceleration_mps2: float | None = None,
    ) -> None:
        self.scenario = preset(scenario) if isinstance(scenario, str) else scenario
        self._environment = Environment(self.scenario, 1, 0, acceleration_mps2)
        self._interface = Interface(self.scenario, action_form, observation_form)
        self.action_space = self._interface.action_space
        self.observation_space = self._interface.observation_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Arrays, dict[str, Any]]:
        super().reset(seed=seed)
        self._environment.generator.manual_seed(int(self.np_random.integers(2**63)))
        with torch.inference_mode():
            return as_arrays(self._interface.observed(self._environment.reset()[0])), {}

    def step(self, action: Arrays) -> tuple[Arrays, float, bool, bool, dict[str, Any]]:
        with torch.inference_mode():
            step = self._environment.step(self._interface.raw(action, CPU).unsqueeze(0))
            assert self._environment.world is not None
            info = {
                "rate_bps": step.rates.rate_bps[0].numpy(),
                "power_w": step.power_w.item(),
                "position_enu": self._environment.world.position_enu[0].numpy().copy(),
            }
            observation = as_arrays(self._interface.observed(step.observation[0]))
        return observation, step.reward.item(), False, step.truncated, info
