"""What every personality's mission pilot has: the vehicle, its parameters, and the places of items."""

from collections.abc import Callable
from dataclasses import dataclass

from sitl.flight.physics import Body
from sitl.flight.reference import Vec3
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.plan import Item, place


@dataclass(frozen=True)
class MissionPilot:
    """The part of `mission_flight.Pilot` in which autopilots do not differ."""

    body: Body
    p: Parameters
    origin: Origin
    home: Callable[[], Vec3]
    flying: Callable[[], bool]
    set_home: Callable[[Vec3], None]

    @property
    def on_ground(self) -> bool:
        return not self.flying()

    def place(self, item: Item, here: Vec3) -> Vec3:
        return place(item, self.origin, self.home(), here)
