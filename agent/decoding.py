"""From what the actors say to what is done: the one decoding, for the environment and for flight (paper eq. 23, 29-32).

Every finite raw action becomes a feasible one by construction; consumers only check.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from airframe.displacement import clip_norm, limit_climb, spherical
from rf_model.scenario import Scenario


class RawActionError(ValueError):
    """A raw action that means nothing: wrong size, NaN or infinite."""


@dataclass(frozen=True)
class PhysicalAction:
    """A decision in physical terms, with leading batch dimensions `...`."""

    displacement_enu: Tensor
    """[..., 3] m: at most V_max times the slot, climb limits kept."""
    theta_reflection: Tensor
    """[..., N] rad in [-pi, pi]."""
    split_angle: Tensor
    """[..., N] rad in [0, pi/2]: beta_R = sin x, beta_T = cos x."""
    sign: Tensor
    """[..., N] -1 or +1: theta_T = wrap(theta_R + sign pi/2)."""
    beamforming: Tensor
    """[..., M, J] complex, sqrt(W): the squares add up to at most P_max."""


def continuous_size(scenario: Scenario) -> int:
    """3 + 2N + 2MJ: size of the continuous half (paper, below eq. 23)."""
    return 3 + 2 * scenario.elements + 2 * scenario.antennas * scenario.users


def action_size(scenario: Scenario) -> int:
    """3 + 3N + 2MJ: both halves."""
    return continuous_size(scenario) + scenario.elements


def require_finite(raw: Tensor, scenario: Scenario) -> None:
    """Raise RawActionError unless `raw` is [..., 3 + 3N + 2MJ] and finite."""
    size = action_size(scenario)
    if raw.shape[-1] != size:
        raise RawActionError(f"raw action: {raw.shape[-1]} numbers, the scenario takes {size} (3 + 3N + 2MJ)")
    if not torch.isfinite(raw).all():
        index = int((~torch.isfinite(raw)).any(dim=tuple(range(raw.ndim - 1))).nonzero()[0])
        raise RawActionError(f"raw action: number {index} is not finite")


def decode(raw: Tensor, scenario: Scenario) -> PhysicalAction:
    """Decode raw actions [..., 3 + 3N + 2MJ]: motion (3), theta_R (N), split (N), W (2MJ: [M, J, re/im]), signs (N).

    Everything but the signs is clipped to [-1, 1] first. Limits are kept exactly even when the result is later read
    in double precision: each is approached from below by a few units of rounding. W uses all of P_max, except that
    numbers below 1e-12 count as silence. Differentiable except in the signs. Raises RawActionError.
    """
    require_finite(raw, scenario)
    elements, antennas, users = scenario.elements, scenario.antennas, scenario.users
    motion, theta, split, beams, discrete = torch.split(
        raw, [3, elements, elements, 2 * antennas * users, elements], dim=-1
    )
    below = 1 - 2 * torch.finfo(raw.dtype).eps
    return PhysicalAction(
        displacement_enu=_displacement(motion.clip(-1, 1), scenario),
        theta_reflection=theta.clip(-1, 1) * (math.pi * below),
        split_angle=(split.clip(-1, 1) + 1) * (math.pi / 4 * below),
        sign=torch.where(discrete > 0, 1.0, -1.0),
        beamforming=_beamforming(beams.clip(-1, 1), scenario),
    )


def _displacement(motion: Tensor, scenario: Scenario) -> Tensor:
    """[..., 3] in [-1, 1] to metres: (distance, elevation, azimuth) or a vector, then the limits."""
    reach = scenario.v_max_mps * scenario.slot_s
    first, second, third = motion.unbind(-1)
    if scenario.motion == "spherical":
        dx, dy, dz = spherical((first + 1) * (reach / 2), second * (math.pi / 2), (third + 1) * math.pi)
    else:
        dx, dy, dz = first * reach, second * reach, third * reach
    below = 1 - 8 * torch.finfo(motion.dtype).eps
    dx, dy, dz = clip_norm(dx, dy, dz, reach * below)
    up = (scenario.climb_up_mps or scenario.v_max_mps) * below
    down = (scenario.climb_down_mps or scenario.v_max_mps) * below
    dz = limit_climb(dz, scenario.slot_s, up, down)
    return torch.stack([dx, dy, dz], dim=-1)


def _beamforming(beams: Tensor, scenario: Scenario) -> Tensor:
    """[..., 2MJ] in [-1, 1] to W [..., M, J] of full power, over all users or for each (constraint 21g)."""
    parts = beams.reshape(*beams.shape[:-1], scenario.antennas, scenario.users, 2)
    within = (-3, -2, -1) if scenario.p_max == "total" else (-3, -1)
    largest = parts.abs().amax(dim=within, keepdim=True).clip(min=1e-12)
    unit = parts / largest  # squares of what is left neither overflow nor vanish
    norm = unit.square().sum(dim=within, keepdim=True).clip(min=1).sqrt()
    rounding = beams.shape[-1] * torch.finfo(beams.dtype).eps
    return torch.view_as_complex(unit * (math.sqrt(scenario.p_max_w) * (1 - rounding) / norm))
