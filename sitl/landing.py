"""What a landing begins with, on every autopilot: where it comes down and from which motion."""

from sitl.flight.physics import Body, heading
from sitl.flight.reference import Limits, Reference, stopping_point, vector


class Landing:
    """Comes down at a place, or else where the vehicle can stop; with the heading it has."""

    landing = True

    def __init__(self, body: Body, limits: Limits, ground_down: float, place: tuple[float, float] | None) -> None:
        """`ground_down`: NED down of the ground [m]; `place`: north and east [m]."""
        self._limits = limits
        self._reference = Reference(vector(body.position), vector(body.velocity))
        x, y, _ = stopping_point(self._reference, limits)
        self._place = place or (x, y)
        self._ground_down = ground_down
        self._yaw = heading(body.attitude)
