"""How PX4 flies missions and to places: its parameters as `Manners`, its modes as the mission's legs."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from sitl.mission_flight import Manners
from sitl.mission_pilot import MissionPilot
from sitl.parameters import Parameters
from sitl.px4.autonomy import Land, Takeoff, limits


def manners(p: Parameters) -> Manners:
    """NAV_* and MPC_* parameters."""
    return Manners(
        limits=limits(p),
        speed_max=p["MPC_XY_VEL_MAX"],
        radius=p["NAV_ACC_RAD"],
        height=p["NAV_MC_ALT_RAD"],
        yaw_rate=math.radians(p["MPC_YAWRAUTO_MAX"]),
        first_height=p["MIS_TAKEOFF_ALT"],
        tells_orders=True,
        takeoff_goes_there=True,
    )


@dataclass(frozen=True)
class Pilot(MissionPilot):
    """What a mission asks of PX4."""

    go_home: Callable[[], object]
    """RETURN_TO_LAUNCH in a mission is a change of mode."""

    def takeoff(self, down: float) -> Takeoff:
        if math.isnan(down):
            down = self.home()[2] - self.p["MIS_TAKEOFF_ALT"]
        return Takeoff(self.body, self.p, min(down, float(self.body.position[2])), self.home()[2], self.flying)

    def land(self, north: float, east: float) -> Land:
        return Land(self.body, self.p, self.home()[2], (north, east))

    def return_home(self) -> None:
        self.go_home()
