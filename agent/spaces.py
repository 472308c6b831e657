"""Actions and observations as a learner has them, flat or as dicts of named parts, and their Gymnasium spaces."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agent.decoding import RawActionError
from rf_model.scenario import Scenario
from rf_model.surfaces import surface_of

Form = Literal["flat", "dict"]
Arrays = NDArray[np.float32] | dict[str, NDArray[np.float32]]
Tensors = Tensor | dict[str, Tensor]


@dataclass(frozen=True)
class Layout:
    """Named parts of a vector, in their order in it."""

    shapes: Mapping[str, tuple[int, ...]]

    @property
    def size(self) -> int:
        """Length of the vector."""
        return sum(self._sizes)

    @property
    def _sizes(self) -> list[int]:
        return [math.prod(shape) for shape in self.shapes.values()]

    def split(self, vector: Tensor) -> dict[str, Tensor]:
        """Parts [..., *shape] of a vector [..., size]."""
        parts = torch.split(vector, self._sizes, dim=-1)
        return {
            name: torch.unflatten(part, -1, shape)
            for part, (name, shape) in zip(parts, self.shapes.items(), strict=True)
        }

    def join(self, parts: Mapping[str, Tensor]) -> Tensor:
        """Vector [..., size] of parts [..., *shape]. Raises RawActionError for other names or shapes."""
        if parts.keys() != self.shapes.keys():
            raise RawActionError(f"parts {', '.join(parts)}: must be {', '.join(self.shapes)}")
        for name, shape in self.shapes.items():
            if tuple(parts[name].shape[-len(shape) :]) != shape:
                raise RawActionError(f"{name}: shape {list(parts[name].shape)}, must end in {list(shape)}")
        return torch.cat([parts[name].flatten(-len(shape)) for name, shape in self.shapes.items()], dim=-1)


def action_layout(scenario: Scenario) -> Layout:
    """Parts of the raw action, see `agent.decoding.decode`; which ones of the surface depends on its kind."""
    N, M, J = scenario.elements, scenario.antennas, scenario.users
    surface = surface_of(scenario)
    of_elements = ("theta_reflection", "split", "theta_transmission")[: surface.continuous]
    shapes: dict[str, tuple[int, ...]] = {"motion": (3,), **dict.fromkeys(of_elements, (N,)), "beamforming": (M, J, 2)}
    return Layout(shapes | {"sign": (N,)} if surface.signs else shapes)


def observation_layout(scenario: Scenario) -> Layout:
    """Parts of the observation, see `agent.observation.observe`; the last dimension of channels is (re, im)."""
    N, M, J = scenario.elements, scenario.antennas, scenario.users
    extra: dict[str, tuple[int, ...]] = {"users": (J, 3), "time": (1,)}
    return Layout(
        {"position": (3,), "bs_ris": (N, M, 2), "direct": (J, M, 2), "ris_user": (J, N, 2)}
        | {name: extra[name] for name in scenario.state_extra}
    )


class Interface:
    """What a learner sees of a scenario: its spaces, and the way between their elements and flat tensors."""

    def __init__(self, scenario: Scenario, action_form: Form, observation_form: Form) -> None:
        for name, form in (("action_form", action_form), ("observation_form", observation_form)):
            if form not in ("flat", "dict"):
                raise ValueError(f"{name}: {form!r} is not one of flat, dict")
        self._actions, self._observations = action_layout(scenario), observation_layout(scenario)
        self._action_form, self._observation_form = action_form, observation_form

    @property
    def action_space(self) -> gymnasium.Space[Any]:
        """Of one world. In the dict form signs are binary, because nothing between them means anything."""
        if self._action_form == "flat":
            return _box(1, (self._actions.size,))
        spaces: dict[str, gymnasium.Space[Any]] = {
            name: gymnasium.spaces.MultiBinary(*shape) if name == "sign" else _box(1, shape)
            for name, shape in self._actions.shapes.items()
        }
        return gymnasium.spaces.Dict(spaces, sort_keys=False)

    @property
    def observation_space(self) -> gymnasium.Space[Any]:
        """Of one world."""
        if self._observation_form == "flat":
            return _box(np.inf, (self._observations.size,))
        boxes: dict[str, gymnasium.Space[Any]] = {
            name: _box(np.inf, shape) for name, shape in self._observations.shapes.items()
        }
        return gymnasium.spaces.Dict(boxes, sort_keys=False)

    def raw(self, action: Any, device: torch.device) -> Tensor:  # noqa: ANN401 - an array, a tensor or a dict of either
        """Raw actions [..., action_size] of an element of the action space, or of many. Raises RawActionError."""
        if self._action_form == "flat":
            return torch.as_tensor(action, dtype=torch.float32, device=device)
        if not isinstance(action, Mapping):
            raise RawActionError(f"action: {type(action).__name__}, action_form dict takes a dict")
        parts = {name: torch.as_tensor(part, dtype=torch.float32, device=device) for name, part in action.items()}
        return self._actions.join(parts)

    def observed(self, observation: Tensor) -> Tensors:
        """Observations [..., state_size] in the form that was asked for."""
        return observation if self._observation_form == "flat" else self._observations.split(observation)


def as_arrays(tensors: Tensors) -> Arrays:
    """NumPy's view of tensors on the CPU, or a copy of others."""
    if isinstance(tensors, dict):
        return {name: tensor.cpu().numpy() for name, tensor in tensors.items()}
    return tensors.cpu().numpy()


def _box(limit: float, shape: tuple[int, ...]) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-limit, limit, shape, np.float32)
