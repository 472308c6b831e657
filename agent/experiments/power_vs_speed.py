"""What a panel costs in forward flight (paper fig. "RIS size vs energy", eq. 15-19). Nothing is random."""

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

from airframe.power import NO_PANEL, total_power
from rf_model.scenario import Scenario, preset

Reading = Literal["sqrt", "printed"]
READINGS: tuple[Reading, ...] = get_args(Reading)
ELEMENTS = (0, 16, 64, 256, 1024)
TOP_SPEED_MPS = 30.0
STEP_MPS = 0.001


@dataclass(frozen=True)
class Curve:
    """Power of one size of panel, its whole horizontal speed seen face-on."""

    reading: Reading
    """`sqrt`: eq. 16b with its roots in place and v_i = 4.504 m/s; `printed`: as printed, with v_i = 4.028 m/s."""
    elements: int
    speed_mps: Tensor
    """[S] from 0 to `TOP_SPEED_MPS` in steps of `STEP_MPS`, float64."""
    power_w: Tensor
    """[S]"""

    @property
    def endurance(self) -> int:
        """Index of the speed of maximum endurance: least power."""
        return int(self.power_w.argmin())

    @property
    def range(self) -> int:
        """Index of the speed of maximum range: least energy a metre."""
        return 1 + int((self.power_w[1:] / self.speed_mps[1:]).argmin())


def curves() -> list[Curve]:
    """One curve for each reading of the induced power and number of elements (spaced lambda / 2)."""
    speed = torch.arange(round(TOP_SPEED_MPS / STEP_MPS) + 1, dtype=torch.float64) * STEP_MPS
    return [
        Curve(reading, elements, speed, _power(_scenario(reading, elements), elements, speed))
        for reading in READINGS
        for elements in ELEMENTS
    ]


def _scenario(reading: Reading, elements: int) -> Scenario:
    side = round(elements**0.5) or 1
    forms = {"induced": "paper", "induced_velocity": "paper"} if reading == "printed" else {}
    return preset("physical_1km", rows=side, columns=side, v_perp="speed", **forms)


def _power(scenario: Scenario, elements: int, speed: Tensor) -> Tensor:
    still = torch.zeros_like(speed)
    return total_power(scenario.wing, scenario.panel if elements else NO_PANEL, speed, still, still, 1.0, 0.0)
