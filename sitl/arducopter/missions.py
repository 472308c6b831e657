"""How ArduCopter flies missions: its parameters as `Manners`, its modes as the mission's legs."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from sitl.arducopter.autonomy import Land, Return, Takeoff, slew
from sitl.arducopter.vehicle_setup import limits
from sitl.flight.physics import Body
from sitl.flight.reference import Vec3
from sitl.mission_flight import Manners
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.plan import Item, place


def manners(p: Parameters) -> Manners:
    """WPNAV_* parameters. A mission that begins on the ground must begin with a takeoff."""
    return Manners(
        limits=limits(p),
        speed_max=20.0,
        radius=p["WPNAV_RADIUS"] * 0.01,
        height=p["WPNAV_RADIUS"] * 0.01,
        yaw_rate=slew(p),
        first_height=math.nan,
        tells_orders=False,
        takeoff_goes_there=False,
    )


@dataclass(frozen=True)
class Pilot:
    """What a mission asks of ArduCopter."""

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

    def takeoff(self, down: float) -> Takeoff:
        return Takeoff(self.body, self.p, min(down, float(self.body.position[2])))

    def land(self, north: float, east: float) -> Land:
        return Land(self.body, self.p, self.home()[2], (north, east))

    def return_home(self) -> Return:
        """RTL in a mission stays in AUTO."""
        return Return(self.body, self.p, self.home())
