"""From what the actors say to what is done: the one decoding, for the environment and for flight (paper eq. 23, 29-32).

Every finite raw action becomes a feasible one by construction; consumers only check.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from airframe.displacement import spherical
from rf_model.geometry import constant
from rf_model.scenario import Scenario
from rf_model.star_ris import Coefficients
from rf_model.surfaces import surface_of


class RawActionError(ValueError):
    """A raw action that means nothing: wrong size, NaN or infinite."""


@dataclass(frozen=True)
class PhysicalAction:
    """A decision in physical terms, with leading batch dimensions `...`."""

    displacement_enu: Tensor
    """[..., 3] m: at most V_max times the slot, climb limits kept."""
    trc: Coefficients
    """[..., N] what the scenario's surface is set to."""
    beamforming: Tensor
    """[..., M, J] complex, sqrt(W): the squares add up to at most P_max."""

    @property
    def theta_reflection(self) -> Tensor:
        """[..., N] rad in [-pi, pi]."""
        return self.trc.theta_reflection

    @property
    def split_angle(self) -> Tensor:
        """[..., N] rad in [0, pi/2]: beta_R = sin x, beta_T = cos x."""
        return self.trc.split_angle

    @property
    def sign(self) -> Tensor:
        """[..., N] -1 or +1: theta_T = wrap(theta_R + sign pi/2) on a coupled surface."""
        return self.trc.sign


def continuous_size(scenario: Scenario) -> int:
    """Size of the continuous half: 3 + 2N + 2MJ (paper, below eq. 23), or as many a element as the surface takes."""
    per_element = surface_of(scenario).continuous
    return 3 + per_element * scenario.elements + 2 * scenario.antennas * scenario.users


def discrete_size(scenario: Scenario) -> int:
    """Size of the discrete half: N signs, or none when the surface has none."""
    return surface_of(scenario).signs * scenario.elements


def action_size(scenario: Scenario) -> int:
    """Both halves: 3 + 3N + 2MJ for the coupled surface."""
    return continuous_size(scenario) + discrete_size(scenario)


def require_finite(raw: Tensor, scenario: Scenario) -> None:
    """Raise RawActionError unless `raw` is [..., action_size(scenario)] and finite."""
    size = action_size(scenario)
    if raw.shape[-1] != size:
        raise RawActionError(f"raw action: {raw.shape[-1]} numbers, the scenario takes {size}")
    if math.isfinite(raw.sum().item()):  # much the cheapest; of finite numbers only huge ones have no finite sum
        return
    wrong = (~torch.isfinite(raw)).any(dim=tuple(range(raw.ndim - 1)))
    if wrong.any():
        raise RawActionError(f"raw action: number {int(wrong.nonzero()[0])} is not finite")


def decode(raw: Tensor, scenario: Scenario) -> PhysicalAction:
    """Decode raw actions [..., 3 + 3N + 2MJ]: motion (3), theta_R (N), split (N), W (2MJ: [M, J, re/im]), signs (N).

    Other surfaces than the coupled one take other numbers in place of theta_R, split and signs (`rf_model.surfaces`).
    Everything but the signs is clipped to [-1, 1] first. Limits are kept exactly even when the result is later read
    in double precision: each is approached from below by a few units of rounding. W uses all of P_max, except that
    numbers of a norm below 1e-12 count as silence. Differentiable except in the signs. Raises RawActionError.
    """
    require_finite(raw, scenario)
    surface = surface_of(scenario)
    N, beams = scenario.elements, 2 * scenario.antennas * scenario.users
    motion, coefficients, weights, signs = torch.split(
        raw.clip(-1, 1), [3, surface.continuous * N, beams, surface.signs * N], dim=-1
    )
    return PhysicalAction(
        displacement_enu=_displacement(motion, scenario),
        trc=surface.decode(coefficients, signs),
        beamforming=_beamforming(weights, scenario),
    )


def encode(action: PhysicalAction, scenario: Scenario) -> Tensor:
    """Raw actions [..., action_size(scenario)] of which `decode` makes these decisions, to rounding.

    Of what it never makes there is no such raw action: W of less than full power comes back at full power, other
    coefficients than the surface can have and moves beyond the limits as something near.
    """
    coefficients, signs = surface_of(scenario).encode(action.trc)
    beams = torch.view_as_real(action.beamforming).flatten(-3)
    largest = beams.abs().amax(dim=-1, keepdim=True).clamp_min(1e-12)
    return torch.cat((_motion(action.displacement_enu, scenario), coefficients, beams / largest, signs), dim=-1)


def _motion(displacement_enu: Tensor, scenario: Scenario) -> Tensor:
    """`_displacement` undone for moves [..., 3] within the limits."""
    reach = scenario.v_max_mps * scenario.slot_s
    if scenario.motion == "cartesian":
        return (displacement_enu / reach).clip(-1, 1)
    east, north, up = displacement_enu.unbind(-1)
    horizontal = torch.hypot(east, north)
    elevation, azimuth = torch.atan2(up, horizontal), torch.atan2(north, east).remainder(2 * math.pi)
    distance = torch.hypot(horizontal, up)
    parts = (distance * (2 / reach) - 1, elevation / (math.pi / 2), azimuth / math.pi - 1)
    return torch.stack(parts, dim=-1).clip(-1, 1)


def _displacement(motion: Tensor, scenario: Scenario) -> Tensor:
    """[..., 3] in [-1, 1] to metres: (distance, elevation, azimuth) or a vector, then the limits.

    First of speed (constraint 21h), which keeps the direction, then of climb and descent, which keep the horizontal
    part.
    """
    slot_s = scenario.slot_s
    reach = scenario.v_max_mps * slot_s
    if scenario.motion == "spherical":
        first, second, third = motion.unbind(-1)
        parts = spherical((first + 1) * (reach / 2), second * (math.pi / 2), (third + 1) * math.pi)
        wanted = torch.stack(parts, dim=-1)
    else:
        wanted = motion * reach
    below = 1 - 8 * torch.finfo(motion.dtype).eps
    too_far = torch.linalg.vector_norm(wanted, dim=-1, keepdim=True) * (1 / (reach * below))
    up = (scenario.climb_up_mps or math.inf) * slot_s * below
    down = (scenario.climb_down_mps or math.inf) * slot_s * below
    lowest = constant((-math.inf, -math.inf, -down), motion.dtype, motion.device)
    highest = constant((math.inf, math.inf, up), motion.dtype, motion.device)
    return torch.clamp(wanted / too_far.clamp_min(1), lowest, highest)


def _beamforming(beams: Tensor, scenario: Scenario) -> Tensor:
    """[..., 2MJ] in [-1, 1] to W [..., M, J] of full power, over all users or for each (constraint 21g)."""
    parts = beams.reshape(*beams.shape[:-1], scenario.antennas, scenario.users, 2)
    within = (-3, -2, -1) if scenario.p_max == "total" else (-3, -1)
    norm = torch.linalg.vector_norm(parts, dim=within, keepdim=True).clamp_min(1e-12)  # squares of 1e-12 do not vanish
    rounding = beams.shape[-1] * torch.finfo(beams.dtype).eps
    return torch.view_as_complex(parts / (norm * (1 / (math.sqrt(scenario.p_max_w) * (1 - rounding)))))
