"""One vehicle: what its services and its telemetry see of it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sitl.flight.control import Controller
from sitl.flight.flight_model import FlightModel
from sitl.flight.physics import Body
from sitl.flight.reference import Vec3, vector
from sitl.flight.sensors import measured
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import Commander, Personality
from sitl.transfer import Exchange


@dataclass(frozen=True)
class Vehicle:
    """All that telemetry is made of."""

    personality: Personality
    model: FlightModel
    commander: Commander
    parameters: Parameters
    origin: Origin
    noise: np.random.Generator
    epoch_us: int
    """Unix time of boot [us]."""
    exchange: Exchange = field(default_factory=Exchange)

    @property
    def body(self) -> Body:
        return self.model.body

    @property
    def controller(self) -> Controller:
        return self.model.controller

    def position(self) -> tuple[float, float, float]:
        """NED from the local origin [m]."""
        return vector(self.body.position)

    @property
    def now_ms(self) -> int:
        return self.commander.now_ms

    @property
    def located(self) -> bool:
        """Whether the estimator has a position."""
        return self.now_ms >= self.personality.timeline.position_ms and self.model.estimator.valid

    def deviation(self, usual: float) -> float:
        """A sensor's standard deviation, times SITL_NOISE."""
        return usual * self.model.world.noise

    def measured(self, true: NDArray[np.float64], usual: float) -> Vec3:
        """A vector [3] as a sensor of a usual standard deviation shows it."""
        return measured(true, self.deviation(usual), self.noise)
