"""Greedy position search: where the reference flies, by large-scale gains only."""

import math

import torch
from torch import Tensor

from rf_model.channels import link_gains
from rf_model.fairness import fair_rate_bps
from rf_model.link import rate_bps
from rf_model.reward import reward
from rf_model.scenario import Scenario
from rf_model.world import slot_power

HORIZON_SLOTS = 6
"""A move is worth the gain that it brings over at most this many slots."""
CASCADE_EFFICIENCY = 0.35
"""K: how much of N^2 a configured surface is taken to give a user."""
DIRECT_EFFICIENCY = 0.6
"""How much of M beams are taken to give on the direct link."""
DISTANCES = (0.25, 0.5, 1.0)
"""Lengths of the moves tried, in V_max times the slot."""


def greedy_move(scenario: Scenario, position_enu: Tensor, yaw_rad: Tensor, users_enu: Tensor, slot: int) -> Tensor:
    """Displacement [..., 3] m of vehicles [..., 3] with yaw [...] for users [..., J, 3], made in `slot`.

    Among staying and 26 directions at three lengths, each cut to the box and the climb limits, the one that maximises
    alpha U_proxy min(6, slots left) - beta P / P_hover, in the reward's units.
    """
    position = position_enu.unsqueeze(-2)
    low, high = torch.tensor(scenario.box_enu, dtype=position.dtype, device=position.device).unbind(-1)
    moved = torch.clamp(position + _moves(scenario, position), low, high)
    made = moved - position
    power = slot_power(scenario, made / scenario.slot_s, yaw_rad.unsqueeze(-1))
    horizon = min(HORIZON_SLOTS, scenario.slots - 1 - slot)
    value = reward(scenario, horizon * proxy_fair_rate_bps(scenario, moved, users_enu.unsqueeze(-3)), power)
    choice = value.argmax(-1, keepdim=True).unsqueeze(-1)
    return made.gather(-2, choice.expand(*choice.shape[:-1], 3)).squeeze(-2)


def proxy_fair_rate_bps(scenario: Scenario, position_enu: Tensor, users_enu: Tensor) -> Tensor:
    """U_proxy [...]: fair rate that large-scale gains promise at positions [..., 3] to users [..., J, 3].

    Each user gets P_max / J and no interference; the surface gives K N^2 and the beams 0.6 M on the direct link.
    """
    gains = link_gains(scenario, position_enu, users_enu)
    cascade = gains.bs_ris_power.unsqueeze(-1) * gains.ris_user_power
    gain = CASCADE_EFFICIENCY * scenario.elements**2 * cascade
    if scenario.direct == "on":
        gain = gain + DIRECT_EFFICIENCY * scenario.antennas * gains.direct**2
    budget = scenario.p_max_w if scenario.p_max == "per_user" else scenario.p_max_w / scenario.users
    return fair_rate_bps(rate_bps(gain * (budget / scenario.noise_w), scenario.bandwidth_hz))


def _moves(scenario: Scenario, like: Tensor) -> Tensor:
    """Displacements tried [79, 3] m, within the speed and climb limits."""
    axis = torch.tensor([0.0, -1.0, 1.0], dtype=like.dtype, device=like.device)
    directions = torch.cartesian_prod(axis, axis, axis)[1:]
    directions = directions / directions.norm(dim=-1, keepdim=True)
    reach = scenario.v_max_mps * scenario.slot_s
    moves = torch.cat([torch.zeros_like(directions[:1]), *(directions * (reach * part) for part in DISTANCES)])
    up = (scenario.climb_up_mps or math.inf) * scenario.slot_s
    down = (scenario.climb_down_mps or math.inf) * scenario.slot_s
    return torch.cat([moves[:, :2], moves[:, 2:].clamp(-down, up)], dim=-1)
