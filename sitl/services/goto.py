"""Going somewhere by command: DO_REPOSITION, DO_CHANGE_SPEED, DO_PAUSE_CONTINUE, and the mission's own commands."""

import math

from sitl.links.link import Link
from sitl.personality import Result
from sitl.plan import AMSL_FRAMES, RELATIVE_FRAMES
from sitl.services.command import Command
from sitl.services.missions import set_current
from sitl.targets import Destination
from sitl.vehicle import Vehicle

ALTITUDE_MAX_M = 100_000.0


def do_reposition(v: Vehicle, _: Link, c: Command) -> Result:
    """param1 speed, param2 flags, param4 yaw [rad], latitude, longitude, altitude; NaN leaves a value as it is."""
    if any(math.isinf(value) for value in (*c.p, c.x, c.y, c.z)):
        return Result.DENIED
    if abs(c.x) > 90.0 or abs(c.y) > 180.0 or abs(c.z) > ALTITUDE_MAX_M:
        return Result.DENIED
    if c.frame not in AMSL_FRAMES | RELATIVE_FRAMES:
        return Result.DENIED
    north, east = v.origin.local(c.x, c.y)  # both NaN when one is
    home_down = v.commander.home[2] if v.commander.home is not None else 0.0
    down = home_down - c.z if c.frame in RELATIVE_FRAMES else v.origin.altitude - c.z
    if math.isnan(north) or math.isnan(east):
        north = east = math.nan
    flags = int(c.p[1]) if math.isfinite(c.p[1]) and c.p[1] >= 0.0 else 0
    return v.commander.reposition(Destination((north, east, down), c.p[3], c.p[0], flags))


def do_change_speed(v: Vehicle, _: Link, c: Command) -> Result:
    """param1 which speed (0 air, 1 ground, 2 climb, 3 descent), param2 [m/s]."""
    if not math.isfinite(c.p[1]):
        return Result.DENIED
    return v.commander.change_speed(c.p[0], c.p[1])


def do_pause_continue(v: Vehicle, _: Link, c: Command) -> Result:
    """param1 0 pauses, 1 goes on."""
    return v.commander.pause(c.p[0] == 0.0) if c.p[0] in (0.0, 1.0) else Result.DENIED


def do_set_mission_current(v: Vehicle, _: Link, c: Command) -> Result:
    """param1 the item, -1 the current one. How often jumps were followed is forgotten."""
    if not math.isfinite(c.p[0]):
        return Result.DENIED
    return set_current(v, v.commander.plans.current if c.p[0] == -1.0 else int(c.p[0]))


def do_fence_enable(v: Vehicle, _: Link, c: Command) -> Result:
    """param1 0 disables, 1 enables."""
    return v.commander.enable_fence(c.p[0] == 1.0) if c.p[0] in (0.0, 1.0) else Result.DENIED
