"""What ArduCopter can be flying."""

from sitl.arducopter.autonomy import BlindLand, Destination, Land, Level, Return, Takeoff, Velocity
from sitl.arducopter.sticks import Attitude, LeanSticks, LoiterSticks
from sitl.mission_flight import MissionFlight

ByPilot = Attitude | LoiterSticks | LeanSticks
Leg = Velocity | Level | Takeoff | Destination | Land | BlindLand | Return | MissionFlight | ByPilot


def taking_off(leg: Leg) -> bool:
    """Whether it is on its way up from the ground."""
    if isinstance(leg, MissionFlight):
        return leg.taking_off
    return isinstance(leg, Takeoff) and not leg.done
