"""The state of paper eq. 22, and what `state_extra` adds to it: one function for environment, flight and data sets."""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from bus.messages import ChannelState
from rf_model.channels import Channels
from rf_model.scenario import Scenario, StateExtra
from rf_model.world import reference_gains


class ObservationError(ValueError):
    """A channel state that is not of the scenario's sizes; the text names the field."""


@dataclass(frozen=True)
class Normalisation:
    """What `state_norm` divides by: constants of a scenario."""

    centre: Tensor
    """[3] m"""
    half_size: Tensor
    """[3] m: half the box's edges."""
    bs_ris: float
    direct: float
    ris_user: float
    """Root mean gains of the links."""
    sizes: tuple[int, int, int]
    """N, M, J"""
    extra: tuple[StateExtra, ...]
    slots: int
    """The time of a slot is relative to this many."""

    @cached_property
    def scale(self) -> Tensor:
        """What each number of a state [S] is multiplied by, the position being normalised already."""
        elements, antennas, users = self.sizes
        parts = (
            (1.0, 3),
            (1.0 / self.bs_ris, 2 * elements * antennas),
            (1.0 / self.direct, 2 * users * antennas),
            (1.0 / self.ris_user, 2 * users * elements),
        )
        with torch.inference_mode(False):  # what is kept may be needed for gradients later
            scales = [self.centre.new_full((size,), factor, dtype=torch.float32) for factor, size in parts]
            if "users" in self.extra:
                scales.append((1.0 / self.half_size).to(torch.float32).repeat(users))
            if "time" in self.extra:
                scales.append(self.centre.new_full((1,), 1.0 / self.slots, dtype=torch.float32))
            return torch.cat(scales)

    @classmethod
    def of(cls, scenario: Scenario, device: torch.device | None = None) -> "Normalisation":
        """Those of a scenario, for positions on a device."""
        sizes = (scenario.elements, scenario.antennas, scenario.users)
        extra, slots = scenario.state_extra, scenario.slots
        if scenario.state_norm == "raw":
            return cls(torch.zeros(3, device=device), torch.ones(3, device=device), 1.0, 1.0, 1.0, sizes, extra, slots)
        low, high = torch.tensor(scenario.box_enu, device=device).unbind(-1)
        gains = reference_gains(scenario)
        centre, half_size = (low + high) / 2, (high - low) / 2
        return cls(centre, half_size, gains.bs_ris, gains.direct, gains.ris_user, sizes, extra, slots)


def channel_size(scenario: Scenario) -> int:
    """MN + MJ + NJ complex numbers."""
    elements, antennas, users = scenario.elements, scenario.antennas, scenario.users
    return antennas * elements + antennas * users + elements * users


def state_size(scenario: Scenario) -> int:
    """3 + 2MN + 2MJ + 2NJ (paper, above eq. 22), and what `state_extra` adds: 3J for users, 1 for time."""
    added = {"users": 3 * scenario.users, "time": 1}
    return 3 + 2 * channel_size(scenario) + sum(added[name] for name in scenario.state_extra)


def ends(observation: Tensor) -> Tensor:
    """Whether states [..., S] that have the time are those after the last slot, [...]."""
    return observation[..., -1] >= 1


def observe(
    position_enu: Tensor, users_enu: Tensor, slot: int, channels: Channels, normalisation: Normalisation
) -> Tensor:
    """State [..., S] of vehicle positions [..., 3], user positions [..., J, 3] and channels at a slot, float32.

    In this order: position; H [N, M]; h_b [J, M]; h_s [J, N]; each complex number as (re, im), users in their order in
    the scenario (those that start in the reflection region come first, as in eq. 22). Then, where `state_extra` says
    so, the users' positions relative to the vehicle [J, 3] and slot / slots.
    """
    position = (position_enu - normalisation.centre) / normalisation.half_size
    parts = [position, _flat(channels.bs_ris), _flat(channels.direct), _flat(channels.ris_user)]
    if "users" in normalisation.extra:
        parts.append((users_enu - position_enu.unsqueeze(-2)).flatten(-2))
    if "time" in normalisation.extra:
        parts.append(position.new_full((*position.shape[:-1], 1), min(slot, normalisation.slots)))
    state = torch.cat(parts, dim=-1)
    return state.mul_(normalisation.scale).to(torch.float32)  # in place: a new tensor of this size costs more


def observe_message(message: ChannelState, normalisation: Normalisation) -> Tensor:
    """State [S] of a message on the bus. Raises ObservationError when its sizes are not the scenario's."""
    elements, antennas, users = normalisation.sizes
    channels = Channels(
        direct=_complex("direct", message.direct, (users, antennas)),
        bs_ris=_complex("bs_ris", message.bs_ris, (elements, antennas)),
        ris_user=_complex("ris_user", message.ris_user, (users, elements)),
        transmission=torch.tensor([region == "transmission" for region in message.regions]),
    )
    if len(message.users_enu) != users:
        raise ObservationError(f"users_enu: {len(message.users_enu)} positions, the scenario has {users} users")
    position = torch.tensor(message.position_enu, dtype=torch.float64)
    of_users = torch.tensor(message.users_enu, dtype=torch.float64)
    return observe(position, of_users, message.slot, channels, normalisation)


def _flat(values: Tensor) -> Tensor:
    return torch.view_as_real(values).flatten(-3)


def _complex(name: str, rows: list[list[tuple[float, float]]], shape: tuple[int, int]) -> Tensor:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        got = f"{len(rows)} x {len(rows[0]) if rows else 0}"
        raise ObservationError(f"{name}: {got} numbers, the scenario has {shape[0]} x {shape[1]}")
    return torch.view_as_complex(torch.tensor(rows, dtype=torch.float64))
