"""Communication efficiency against the size of the surface and the speed (paper fig. "efficiency variation")."""

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

from agent.experiments.intervals import Interval, mean_interval
from agent.experiments.snapshots import snapshots
from rf_model.channels import Channels
from rf_model.reference.solve import Solution, closed_form, solve
from rf_model.scenario import Scenario, preset
from rf_model.seeding import generator_of
from rf_model.world import slot_power, slot_rates

Method = Literal["closed_form", "sum_rate", "harmonic"]
METHODS: tuple[Method, ...] = get_args(Method)
SIDES = (4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 28, 32, 40, 48, 64)
SPEEDS_MPS = (0.0, 5.0, 7.5, 10.0, 15.0)
ITERATIONS = 10
RESAMPLES = 1000
_BOOTSTRAP = 3


@dataclass(frozen=True)
class Size:
    """Rates of one number of elements under one method."""

    method: Method
    elements: int
    sum_rates_bps: Tensor
    """[worlds]; the same users and lines of sight for every size."""

    @property
    def sum_rate_bps(self) -> Interval:
        return mean_interval(self.sum_rates_bps)


@dataclass(frozen=True)
class Best:
    """The number of elements with the highest efficiency."""

    method: Method
    speed_mps: float
    elements: int
    low: int
    high: int
    """95 % interval over worlds (bootstrap)."""

    @property
    def interior(self) -> bool:
        """Whether a larger surface was tried and was worse."""
        return self.elements < SIDES[-1] ** 2


def power_w(elements: int, speed_mps: float) -> float:
    """Power at a horizontal speed along the panel's normal."""
    velocity = torch.tensor([speed_mps, 0.0, 0.0], dtype=torch.float64)
    return slot_power(_scenario(elements), velocity, torch.zeros((), dtype=torch.float64)).item()


def sizes(worlds: int, seed: int) -> list[Size]:
    """Sum rates in `physical_1km`, hovering at the start, for each method and number of elements.

    `closed_form`: RZF and per-element coefficients; `sum_rate` and `harmonic`: the reference, which maximises the sum
    of rates or the fair rate. Only the power is that of the speed: the same worlds serve every speed.
    """
    return [Size(method, side**2, _sum_rates(method, side**2, worlds, seed)) for method in METHODS for side in SIDES]


def best(sizes: list[Size], seed: int) -> list[Best]:
    """For each method and speed, with the mean sum rate over the power as efficiency."""
    found = []
    for method in METHODS:
        of_method = [size for size in sizes if size.method == method]
        rates = torch.stack([size.sum_rates_bps for size in of_method])
        worlds = rates.shape[-1]
        drawn = torch.randint(worlds, (RESAMPLES, worlds), generator=generator_of(seed, _BOOTSTRAP))
        resampled = rates[:, drawn].mean(-1)
        for speed in SPEEDS_MPS:
            power = torch.tensor([power_w(size.elements, speed) for size in of_method], dtype=torch.float64)
            bests = (resampled / power.unsqueeze(-1)).argmax(0).sort().values
            low, high = (int(bests[round(share * (RESAMPLES - 1))]) for share in (0.025, 0.975))
            middle = int((rates.mean(-1) / power).argmax())
            elements = [of_method[index].elements for index in (middle, low, high)]
            found.append(Best(method, speed, *elements))
    return found


def _scenario(elements: int) -> Scenario:
    side = round(elements**0.5)
    return preset("physical_1km", rows=side, columns=side)


def _sum_rates(method: Method, elements: int, worlds: int, seed: int) -> Tensor:
    scenario = _scenario(elements)
    channels = snapshots(scenario, worlds, seed)
    solution = _solution(method, scenario, channels)
    return slot_rates(scenario, channels, solution.trc, solution.beamforming).sum_rate_bps


def _solution(method: Method, scenario: Scenario, channels: Channels) -> Solution:
    if method == "closed_form":
        return closed_form(scenario, channels)
    return solve(scenario, channels, ITERATIONS, method)
