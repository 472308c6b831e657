"""Harmonic against Jain's fairness index: of rates that spread, and as what a system is optimised for.

Of J rates with coefficient of variation c, JFI is 1 / (1 + c^2) whatever they are; HFI depends on how they spread. It
does not change when every rate R becomes 1 / R: it minds one poor user just as much as one rich one. Where one user has
y times what each other one has, JFI is the stricter index exactly for 1 < y < (J - 1)^2.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor

from agent.experiments.intervals import Interval, mean_interval
from agent.experiments.snapshots import snapshots
from rf_model.channels import Channels
from rf_model.fairness import hfi, jfi
from rf_model.link import effective_channel, rate_bps, sinr
from rf_model.reference.solve import closed_form
from rf_model.scenario import Scenario, preset
from rf_model.star_ris import Trc

SCENARIO = "prototype_s4"
USERS = (2, 4, 8, 16)
POWERS_DBM = (15.0, 20.0, 23.0, 26.0, 29.0, 35.0)
STEPS = 200
STEP_SIZE = 0.05
_MBPS = 1e6


@dataclass(frozen=True)
class Spread:
    """Indices of one family of rate vectors against their coefficient of variation."""

    family: str
    users: int
    variation: Tensor
    """c [S], increasing."""
    hfi: Tensor
    """[S]"""
    jfi: Tensor
    """[S]"""


def spreads(points: int = 200) -> list[Spread]:
    """Families of rates in which one user is poor, one is rich, or all are spread evenly or exponentially.

    `one poor` and `one rich`: one user has x < 1, or 1 / x, times what each other one has; `even`: equal steps of rate;
    `exponential`: equal factors. Each for each number of `USERS`. Nothing is random.
    """
    x = torch.logspace(0, -3, points, dtype=torch.float64).unsqueeze(-1)
    found = []
    for users in USERS:
        others, steps = x.new_ones(points, users - 1), torch.linspace(0, 1, users, dtype=torch.float64)
        found += [
            _spread("one poor", torch.cat((x, others), dim=-1)),
            _spread("even", x + (1 - x) * steps),
            _spread("exponential", (1 / x) ** steps),
            _spread("one rich", torch.cat((1 / x, others), dim=-1)),
        ]
    return found


def _spread(family: str, rates: Tensor) -> Spread:
    variation = rates.std(-1, correction=0) / rates.mean(-1)
    return Spread(family, rates.shape[-1], variation, hfi(rates * _MBPS), jfi(rates * _MBPS))


def _log_fair(rates: Tensor) -> Tensor:
    return -rates.clamp_min(1e-6).reciprocal().sum(-1).log()


def _log_jain(rates: Tensor) -> Tensor:
    return 3 * rates.sum(-1).log() - rates.square().sum(-1).log()


def _log_sum(rates: Tensor) -> Tensor:
    return rates.sum(-1).log()


OBJECTIVES: Mapping[str, Callable[[Tensor], Tensor]] = MappingProxyType(
    {"hfi": _log_fair, "jfi": _log_jain, "sum_rate": _log_sum}
)
"""Logarithms, up to a constant, of HFI sum R, JFI sum R and sum R, of rates [..., J] Mbit/s."""


@dataclass(frozen=True)
class Violations:
    """What optimising one objective at one transmission power gives."""

    objective: str
    p_max_dbm: float
    below_qos: Interval
    """Share of the users below the QoS rate."""
    sum_rate_bps: Interval
    worst_rate_bps: Interval
    """Of the worst user."""


def violations(worlds: int, seed: int) -> list[Violations]:
    """Share of users below the QoS rate for each objective and power, in the same worlds, hovering."""
    found = []
    for p_max_dbm in POWERS_DBM:
        scenario = preset(SCENARIO, p_max_dbm=p_max_dbm)
        for objective, rates in optimised_rates(scenario, snapshots(scenario, worlds, seed)).items():
            found.append(
                Violations(
                    objective,
                    p_max_dbm,
                    mean_interval((rates < scenario.qos_bps).double().mean(-1)),
                    mean_interval(rates.sum(-1)),
                    mean_interval(rates.amin(-1)),
                )
            )
    return found


def optimised_rates(scenario: Scenario, channels: Channels) -> Mapping[str, Tensor]:
    """Rates [worlds, J] bit/s after gradient ascent (Adam) on each objective from the closed form.

    Over beamforming, phases and energy split of a coupled surface; the +-pi/2 signs stay those of the closed form. The
    reference has no JFI objective, so all three are climbed in the same plain way.
    """
    start = closed_form(scenario, channels)
    trc = start.trc
    theta, split, beams = (
        tensor.expand(len(OBJECTIVES), *tensor.shape).clone().requires_grad_()
        for tensor in (trc.theta_reflection, trc.split_angle, torch.view_as_real(_unit(start.beamforming)))
    )

    def rates() -> Tensor:
        beamforming = _unit(torch.view_as_complex(beams)) * math.sqrt(scenario.p_max_w)
        received = effective_channel(channels, Trc(theta, split, trc.sign)) @ beamforming
        return rate_bps(sinr(received, scenario.noise_w), scenario.bandwidth_hz)

    climber = torch.optim.Adam([theta, split, beams], lr=STEP_SIZE)
    for _ in range(STEPS):
        climber.zero_grad()
        climbed = zip(OBJECTIVES.values(), rates() / _MBPS, strict=True)
        torch.autograd.backward(-torch.stack([objective(rate).sum() for objective, rate in climbed]).sum())
        climber.step()
    return dict(zip(OBJECTIVES, rates().detach(), strict=True))


def _unit(beamforming: Tensor) -> Tensor:
    """Beams [..., M, J] of total power 1."""
    return beamforming / torch.view_as_real(beamforming).square().sum((-3, -2, -1)).sqrt()[..., None, None]
