"""Recorded flights: MAVLink frames and when they came, as ground stations log them (`.tlog`, or gzipped).

Such a file holds, for every frame of both directions, eight bytes of big-endian microseconds and the frame.
"""

import gzip
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.links.frames import Frame, Message, decode, split

STAMP_BYTES = 8
NEIGHBOURHOOD_S = 1.0
"""The least delayed frame within this time tells the vehicle's clock."""
CLOCKS = frozenset({"ATTITUDE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "POSITION_TARGET_LOCAL_NED"})
"""Messages whose time_boot_ms is when they were made."""
EVERY_S = {"LOCAL_POSITION_NED": 0.05, "ATTITUDE": 0.1}
"""What a cut recording keeps of the motion."""
ON_CHANGE = {
    "EXTENDED_SYS_STATE": ("landed_state",),
    "HEARTBEAT": ("base_mode", "custom_mode", "system_status"),
    "HOME_POSITION": ("altitude", "z"),
}
"""What it keeps only around a change, and of which fields."""
ALWAYS = frozenset({"COMMAND_ACK", "STATUSTEXT"})


class Stamped(NamedTuple):
    """A frame and when it came [s]."""

    time_s: float
    frame: Frame

    @property
    def message(self) -> Message:
        return decode(self.frame)


def read(path: Path) -> list[Stamped]:
    """Every good frame of a recording. Raises OSError, also for a file that is not gzip though named so."""
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    found: list[Stamped] = []
    at = 0
    while at + STAMP_BYTES < len(data):
        start = at + STAMP_BYTES
        good, _ = split(data[start : start + 12 + 255 + 13], Counter())
        if good and data.startswith(good[0].raw, start):
            found.append(Stamped(int.from_bytes(data[at:start], "big") / 1e6, good[0]))
            at = start + len(good[0].raw)
        else:  # text of a boot loader, a message that nobody knows
            at += 1
    return found


def write(path: Path, recorded: Iterable[Stamped]) -> None:
    """A gzipped recording, the same bytes for the same frames."""
    plain = b"".join(round(one.time_s * 1e6).to_bytes(STAMP_BYTES, "big") + one.frame.raw for one in recorded)
    path.write_bytes(gzip.compress(plain, mtime=0))


def on_vehicle_time(recorded: list[Stamped], system: int = 1) -> list[Stamped]:
    """The same frames, stamped with the vehicle's time since boot.

    A frame that tells it keeps its own; others get their recorded time less the least delay seen around them, since a
    simulated vehicle's clock drifts against the recorder's. Raises ValueError when no frame tells the time.
    """
    told = [
        (one.time_s, one.message.time_boot_ms / 1000.0)
        for one in recorded
        if one.frame.system == system and one.frame.name in CLOCKS
    ]
    if not told:
        raise ValueError("the recording has no frame that tells the vehicle's time")
    times = [wall for wall, _ in told]
    delays = np.array([wall - vehicle for wall, vehicle in told])

    def vehicle_time(one: Stamped) -> float:
        if one.frame.system == system and one.frame.name in CLOCKS:
            return float(one.message.time_boot_ms) / 1000.0
        first = bisect_left(times, one.time_s - NEIGHBOURHOOD_S)
        end = bisect_right(times, one.time_s + NEIGHBOURHOOD_S)
        if first >= end:
            first = min(first, len(times) - 1)
            end = first + 1
        return one.time_s - float(delays[first:end].min())

    return sorted((Stamped(vehicle_time(one), one.frame) for one in recorded), key=lambda one: one.time_s)


def cut(recorded: list[Stamped], client: int, system: int = 1) -> list[Stamped]:
    """What a replay needs: everything that one client sent, and how the vehicle moved and what became of it."""
    kept: list[Stamped] = []
    due: dict[str, float] = {}
    before: dict[str, tuple[Stamped, tuple[int, ...]]] = {}
    texts: dict[bytes, float] = {}
    for one in recorded:
        name = one.frame.name
        if one.time_s < 0.0:
            continue
        if one.frame.system == client:
            kept.append(one)
        if one.frame.system != system or one.frame.component != 1:
            continue
        if name in EVERY_S and one.time_s >= due.get(name, 0.0):
            due[name] = one.time_s + EVERY_S[name] - 1e-3
            kept.append(one)
        elif name in ALWAYS:
            text = one.frame.raw[10:-2] if name == "STATUSTEXT" else b""
            if not text or one.time_s - texts.get(text, -1.0) > 0.1:  # the same on the other link
                kept.append(one)
            texts[text] = one.time_s
        elif name in ON_CHANGE:
            message = one.message
            value = tuple(getattr(message, field) for field in ON_CHANGE[name])
            last = before.get(name)
            if last is None or last[1] != value:
                kept += [one] if last is None or last[0] in kept[-200:] else [last[0], one]
            before[name] = (one, value)
    return sorted(kept, key=lambda one: one.time_s)


@dataclass(frozen=True)
class Motion:
    """How a vehicle moved, sampled."""

    times: NDArray[np.float64]
    """[n] since boot [s]."""
    velocity: NDArray[np.float64]
    """[n, 3] NED [m/s]."""
    position: NDArray[np.float64]
    """[n, 3] NED [m]."""

    def at(self, times: NDArray[np.float64]) -> "Motion":
        """The same at other times."""

        def taken(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.stack([np.interp(times, self.times, column) for column in values.T], axis=1)

        return Motion(times, taken(self.velocity), taken(self.position))


class Event(NamedTuple):
    """Something that happened once, and between which times [s] it did."""

    what: str
    after_s: float
    by_s: float


def motion(recorded: Iterable[Stamped], system: int = 1) -> Motion:
    """The LOCAL_POSITION_NED of a recording on vehicle time."""
    told = [one.message for one in recorded if one.frame.system == system and one.frame.name == "LOCAL_POSITION_NED"]
    times, where = np.unique([m.time_boot_ms / 1000.0 for m in told], return_index=True)
    told = [told[int(i)] for i in where]
    return Motion(times, np.array([[m.vx, m.vy, m.vz] for m in told]), np.array([[m.x, m.y, m.z] for m in told]))


def events(recorded: Iterable[Stamped], system: int = 1) -> list[Event]:
    """What became of the vehicle: armed and disarmed, landed states, modes, texts, in order of when it was known."""
    found: list[Event] = []
    before: dict[str, tuple[float, str]] = {}

    def notice(what: str, value: str, time_s: float) -> None:
        last = before.get(what)
        if last is not None and last[1] != value:
            found.append(Event(f"{what} {value}", last[0], time_s))
        before[what] = (time_s, value)

    for time_s, frame in recorded:
        if frame.system != system:
            continue
        message = decode(frame)
        if frame.name == "EXTENDED_SYS_STATE":
            notice("landed", str(message.landed_state), time_s)
        elif frame.name == "HEARTBEAT":
            notice("armed", str(int(bool(message.base_mode & 0x80))), time_s)
            notice("mode", str(message.custom_mode), time_s)
            notice("status", str(message.system_status), time_s)
        elif frame.name == "STATUSTEXT":
            found.append(Event(message.text.rstrip("\t"), time_s, time_s))
        elif frame.name == "COMMAND_ACK":
            found.append(Event(f"ack {message.command} {message.result}", time_s, time_s))
    return found
