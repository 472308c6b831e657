"""Where the other vehicles of the mission are, about our own home.

Every bridge tells its vehicle's state with the place on the globe that its ENU counts from. Here the newest state of
each other vehicle becomes a `Track`, which the envelope keeps apart from:

    heard          where it is and where it would stop, by its own bridge's word (it may brake otherwise than ours),
                   carried on by its velocity; as old as its last news, never less than `usual_age_s`
    silent         no news for `LOST_WALL_S`: its bridge is dead or frozen, its autopilot's failsafe has it (lands or
                   returns). It is anywhere on the straight way from where it could have stopped to its home
    down for good  disarmed after its flight: no obstacle any more; one that waits for its flight is, since it takes off

Vehicle clocks differ between autopilots, so age is counted from receipt on our wall clock, times the mission's speed.
A state whose vehicle time stands still is no news: the bridge lives, but hears nothing of its vehicle. One with an old
position is as old as that: the bridge hears of its vehicle, but not where it is.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
import zenoh

from airframe.slot_profile import Vector
from autopilot_bridge.config import Limits
from autopilot_bridge.envelope import stopping_point
from autopilot_bridge.separation import Track
from bus import topics
from bus.messages import Vec3, VehicleState

STATE_S = 0.15
"""Vehicle time between two states: a tenth of a second, and the step of the bridge that sends them."""
DELAY_WALL_S = 0.02
"""Wall clock that a state may take from bridge to bridge."""
LOST_WALL_S = 1.0
"""A neighbour that is silent for so long has lost its bridge."""
WENT_BACK_S = 1.0
"""A vehicle time this much earlier is no state that came late: the autopilot has started anew."""
BEFORE_FLIGHT = ("connecting", "preflight", "ready", "arming")
"""Phases in which a disarmed vehicle waits for its flight."""

EQUATOR_M, FLATTENING = 6378137.0, 1 / 298.257223563
"""WGS 84 (NIMA TR8350.2)."""


def usual_age_s(speed: float) -> float:
    """How old the newest state of another vehicle is at most while all is well [s of vehicle time]."""
    return STATE_S + DELAY_WALL_S * speed


def geocentric(lat_lon_alt: Vec3) -> Vector:
    """Earth-centred, earth-fixed x, y, z [m] of a place (deg, deg, m above the WGS 84 ellipsoid), shape (3,)."""
    latitude, longitude, altitude = np.radians(lat_lon_alt[0]), np.radians(lat_lon_alt[1]), lat_lon_alt[2]
    squared_eccentricity = FLATTENING * (2 - FLATTENING)
    normal = EQUATOR_M / np.sqrt(1 - squared_eccentricity * np.sin(latitude) ** 2)
    level = (normal + altitude) * np.cos(latitude)
    up = (normal * (1 - squared_eccentricity) + altitude) * np.sin(latitude)
    return np.array([level * np.cos(longitude), level * np.sin(longitude), up])


def local_axes(lat_lon_alt: Vec3) -> Vector:
    """East, north and up at a place, as rows of earth-centred coordinates, shape (3, 3)."""
    latitude, longitude = np.radians(lat_lon_alt[:2])
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )


def between_homes(ours: Vec3, theirs: Vec3) -> tuple[Vector, Vector]:
    """(offset (3,), rotation (3, 3)): `offset + rotation @ x` is in our ENU what x is in theirs.

    Homes are degrees, degrees and metres of height over the same surface; that heights are above mean sea level, not
    the ellipsoid, matters less than 1e-5 of the distance.
    """
    axes = local_axes(ours)
    return axes @ (geocentric(theirs) - geocentric(ours)), axes @ local_axes(theirs).T


class Neighbours:
    """The other vehicles `names`, as their bridges tell.

    `limits` are how they may fly, `speed` is vehicle seconds per second. `home()` is our own home, None while unknown.
    `tell(kind, text)` is told who is lost and who is back. `all_known` is called, on zenoh's thread, once every
    neighbour has told its home.
    """

    def __init__(
        self,
        session: zenoh.Session,
        names: Sequence[str],
        limits: Limits,
        speed: float,
        home: Callable[[], Vec3 | None],
        tell: Callable[[str, str], None],
        all_known: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`clock` is the wall clock [s]. Raises ValueError for a bad name."""
        self._clock = clock
        self._home, self._tell, self._all_known = home, tell, all_known
        self._refused: Counter[str] = Counter()
        self._others = {name: _Neighbour(limits, speed) for name in names}
        self._unknown = set(names)
        self._silent: set[str] = set()
        self._held = [
            topics.subscribe(session, name, topics.STATE, self._hears(name, other), self._refused)
            for name, other in self._others.items()
        ]

    @property
    def unknown(self) -> list[str]:
        """Who has not told its home yet."""
        return sorted(self._unknown)

    def tracks(self) -> list[Track]:
        """Where they are now, about our home."""
        home, wall = self._home(), self._clock()
        if home is None:
            return []
        found = []
        for name, other in self._others.items():
            self._watch(name, other.silent(wall))
            track = other.track(home, wall)
            if track is not None:
                found.append(track)
        return found

    def close(self) -> None:
        for declared in self._held:
            declared.undeclare()

    def _hears(self, name: str, other: "_Neighbour") -> Callable[[VehicleState], None]:
        def hear(state: VehicleState) -> None:
            other.hear(state, self._clock())
            if name in self._unknown and state.home_lat_lon_alt is not None:
                self._unknown.discard(name)
                if not self._unknown:
                    self._all_known()

        return hear

    def _watch(self, name: str, silent: bool) -> None:
        if silent and name not in self._silent:
            self._silent.add(name)
            self._tell("neighbour_lost", f"{name} is silent: kept away from its way home")
        elif not silent and name in self._silent:
            self._silent.discard(name)
            self._tell("neighbour_back", f"{name} is heard again")


class _Neighbour:
    """One other vehicle."""

    def __init__(self, limits: Limits, speed: float) -> None:
        self._limits, self._speed = limits, speed
        self._news: tuple[VehicleState, Vec3, float] | None = None
        """Its newest state, its home, and when its position was news on our wall clock; replaced as a whole, on zenoh's
        thread."""
        self._frames: tuple[tuple[Vec3, Vec3], tuple[Vector, Vector]] | None = None
        """The homes (ours, its) that the last conversion was for, and that."""

    def hear(self, state: VehicleState, wall: float) -> None:
        """Take in a state that came now, if it is news."""
        last = self._news
        home = state.home_lat_lon_alt or (last[1] if last else None)
        if home is None:
            return
        if last is None or state.time_s > last[0].time_s or state.time_s < last[0].time_s - WENT_BACK_S:
            self._news = state, home, wall - state.position_age_s / self._speed

    def silent(self, wall: float) -> bool:
        """Whether a flight of it has no bridge any more."""
        return self._news is not None and not _down(self._news[0]) and wall - self._news[2] > LOST_WALL_S

    def track(self, home: Vec3, wall: float) -> Track | None:
        """Where it is about `home`; None when it is no obstacle, or nothing is known."""
        if self._news is None or _down(self._news[0]):
            return None
        state, its_home, came = self._news
        offset, rotation = self._between(home, its_home)
        position, velocity = offset + rotation @ state.position_enu, rotation @ state.velocity_enu
        usual_s = usual_age_s(self._speed)
        stop = None if state.stop_enu is None else offset + rotation @ state.stop_enu
        if wall - came > LOST_WALL_S:
            if stop is None:
                stop = stopping_point(position, velocity, self._limits)
            return Track(stop + velocity * LOST_WALL_S, np.zeros(3), usual_s, stop=offset)
        age_s = (wall - came) * self._speed
        carried = velocity * min(age_s, usual_s)
        return Track(position + carried, velocity, max(age_s, usual_s), None if stop is None else stop + carried)

    def _between(self, ours: Vec3, theirs: Vec3) -> tuple[Vector, Vector]:
        if self._frames is None or self._frames[0] != (ours, theirs):
            self._frames = (ours, theirs), between_homes(ours, theirs)
        return self._frames[1]


def _down(state: VehicleState) -> bool:
    """Whether its flight is over."""
    return not state.armed and state.phase not in BEFORE_FLIGHT
