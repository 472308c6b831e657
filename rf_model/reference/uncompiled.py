"""The reference's closed form in tensors.

It gives what `solve.closed_form` gives, for who needs a few slots once: the compiled one takes half a second to load,
and compiles for 15 to 20 s the first time on a machine.
"""

import math

import torch
from torch import Tensor

from rf_model.channels import Channels
from rf_model.link import effective_channel
from rf_model.reference.elements import Element, elements_of
from rf_model.scenario import Scenario
from rf_model.star_ris import Coefficients, IndependentTrc, Trc


def closed_form(scenario: Scenario, channels: Channels) -> tuple[Coefficients, Tensor]:
    """Coefficients [..., N] and beams W [..., M, J] sqrt(W) for finite channels with batch dimensions `...`.

    Each element maximises Re(c_r phi_r + c_t phi_t), where c of a side is the sum over its users of h_s[j, n] (H v)[n]
    turned back by the phase of h_b,j v, and v is the strongest right singular vector of H. With `phase_bits` each
    phase is then the nearest there is. Beams are those of regularised zero forcing.
    """
    strongest = torch.linalg.svd(channels.bs_ris, full_matrices=False).Vh[..., :1, :].mH
    arriving = (channels.bs_ris @ strongest).mT
    direct = channels.direct @ strongest
    turned = torch.polar(torch.ones_like(direct.real), torch.angle(direct))
    pull = (channels.ris_user * arriving).conj() * turned
    beyond = channels.transmission.unsqueeze(-1)
    trc = _nearest(scenario, torch.where(beyond, 0.0, pull).sum(-2), torch.where(beyond, pull, 0.0).sum(-2))
    return trc, zero_forcing(scenario, effective_channel(channels, trc))


def zero_forcing(scenario: Scenario, channel: Tensor) -> Tensor:
    """Beams [..., M, J] of equal power p for g_j [..., J, M]: along (sigma^2 / p I + sum of conj(g) g^T)^-1 conj(g)."""
    power = scenario.p_max_w if scenario.p_max == "per_user" else scenario.p_max_w / scenario.users
    outer = channel.mH @ channel
    loading = torch.eye(outer.shape[-1], dtype=outer.dtype, device=outer.device) * (scenario.noise_w / power)
    beams: Tensor = torch.linalg.solve(outer + loading, channel.mH)
    sizes = torch.linalg.vector_norm(beams, dim=-2, keepdim=True)
    return beams * (math.sqrt(power) / torch.where(sizes > 0, sizes, 1.0))


def _nearest(scenario: Scenario, reflection: Tensor, transmission: Tensor) -> Coefficients:
    """What the surface can have that is nearest to a point, complex [..., N] on each side."""
    if scenario.surface == "independent":
        split = torch.atan2(reflection.abs(), transmission.abs())
        return IndependentTrc(_phase(scenario, reflection), split, _phase(scenario, transmission))
    if scenario.surface == "coupled":
        beside = (transmission.conj() * reflection).imag
        excess = transmission.abs().square() - reflection.abs().square()
        split = torch.atan2(2.0 * beside.abs(), excess) / 2.0
        quarter_turn = torch.where(beside > 0, 1.0j, -1.0j).to(reflection.dtype)
        common = torch.cos(split) * transmission - torch.sin(split) * quarter_turn * reflection
        return Trc(_phase(scenario, quarter_turn * common), split, -quarter_turn.imag)
    reflecting = elements_of(scenario.surface, scenario.elements) == Element.REFLECTING
    split = torch.where(reflecting, math.pi / 2, 0.0).to(reflection.real.dtype).expand(reflection.shape)
    phase = _phase(scenario, torch.where(reflecting, reflection, -1.0j * transmission))  # theta_T = theta_R + pi/2
    return Trc(phase, split, torch.ones_like(phase))


def _phase(scenario: Scenario, value: Tensor) -> Tensor:
    theta = torch.angle(value)
    if scenario.phase_bits is None:
        return theta
    step = 2 * math.pi / 2**scenario.phase_bits
    nearest: Tensor = torch.round(theta / step) * step
    return nearest
