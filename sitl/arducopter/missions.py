"""How ArduCopter flies missions: its parameters as `Manners`, its modes as the mission's legs."""

import math

from sitl.arducopter.autonomy import Land, Return, Takeoff, slew
from sitl.arducopter.vehicle_setup import limits
from sitl.mission_flight import Manners
from sitl.mission_pilot import MissionPilot
from sitl.parameters import Parameters


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


class Pilot(MissionPilot):
    """What a mission asks of ArduCopter."""

    def takeoff(self, down: float) -> Takeoff:
        return Takeoff(self.body, self.p, min(down, float(self.body.position[2])))

    def land(self, north: float, east: float) -> Land:
        return Land(self.body, self.p, self.home()[2], (north, east))

    def return_home(self) -> Return:
        """RTL in a mission stays in AUTO."""
        return Return(self.body, self.p, self.home())
