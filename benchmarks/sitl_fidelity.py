"""How near the simulated autopilots fly to the real ones: recorded flights, flown again frame by frame.

    python benchmarks/sitl_fidelity.py [px4] [arducopter]
    python benchmarks/sitl_fidelity.py --cut WHOLE.tlog.gz --out SMALL.tlog.gz

Everything that the recorded client sent is sent again at the same vehicle times, to an autopilot in this process with
default parameters, from power-on. Printed are the RMS error of the velocity and where the vehicle has drifted to, part
by part; the time to half and to 90 % of every velocity step; and when what happened to the one and to the other. The
goals are those of issue 4: 0.35 m/s over the part flown by setpoints, 0.1 s. At the start of the return the simulated
vehicle is put where the recorded one was, so that its timing is not that of the drift before.

`--cut` makes such a recording from a whole one (`.tlog`, both directions): what system 240 sent, and of the vehicle its
motion and what became of it, on vehicle time.
"""

import argparse
import math
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sitl.origin import Origin
from sitl.personality import Name, personality
from sitl.recording import Event, Motion, Stamped, cut, events, motion, on_vehicle_time, read, write
from sitl.replay import replay

DATA = Path(__file__).parent.parent / "tests" / "sitl" / "data"
CLIENT = 240
"""System that flew the recorded vehicles."""
GOAL_RMS_MPS, GOAL_S = 0.35, 0.1
STEP_S = 2.0
"""A velocity that is asked for so long is a step."""

MANY = 4
"""Events that happened more often are told in one line."""

Span = tuple[float, float]


@dataclass(frozen=True)
class Recording:
    """A recorded flight and its parts, by vehicle time [s]."""

    name: Name
    offboard: Span
    """Flown by setpoints, failsafes included."""
    parts: dict[str, Span]
    placed_at_s: tuple[float, ...]
    armed_s: float
    """When the heading is read that the vehicle stood with."""

    @property
    def path(self) -> Path:
        return DATA / f"{self.name}_flight.tlog.gz"


PX4 = Recording(
    "px4",
    offboard=(19.7, 118.0),
    parts={
        "takeoff": (5.62, 19.7),
        "velocity steps": (19.7, 96.3),
        "stream lost": (96.3, 110.1),
        "stream is back": (110.1, 118.0),
        "return": (123.0, 158.1),
        "land": (158.1, 186.4),
    },
    placed_at_s=(122.98,),
    armed_s=4.2,
)
ARDUCOPTER = Recording(
    "arducopter",
    offboard=(54.44, 234.46),
    parts={
        "takeoff": (43.69, 54.44),
        "velocity steps": (54.44, 118.4),
        "stream lost": (118.4, 132.4),
        "odd setpoints": (132.4, 234.46),
        "return": (234.5, 266.8),
        "land": (266.8, 296.3),
    },
    placed_at_s=(234.46,),
    armed_s=41.65,
)
RECORDINGS = {recording.name: recording for recording in (PX4, ARDUCOPTER)}


@dataclass(frozen=True)
class Step:
    """A change of the velocity asked for, held for a while."""

    time_s: float
    end_s: float
    before: NDArray[np.float64]
    after: NDArray[np.float64]

    def reached(self, moved: Motion, share: float) -> float:
        """Seconds until `share` of the change is flown; NaN when it never is."""
        change = self.after - self.before
        times = np.arange(self.time_s, self.end_s, 0.01)
        along = (moved.at(times).velocity - self.before) @ change / (change @ change)
        passed = np.nonzero(along >= share)[0]
        return float(times[passed[0]] - self.time_s) if len(passed) else math.nan


class Flown:
    """A recorded flight and the simulated one beside it."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.frames = on_vehicle_time(read(recording.path))
        self.simulated, self.said = replay(
            self.frames,
            personality(recording.name),
            CLIENT,
            self._origin(),
            self._yaw(),
            recording.placed_at_s,
        )
        self.recorded = motion(self.frames)

    def _messages(self, name: str) -> list[Stamped]:
        return [one for one in self.frames if one.frame.name == name]

    def _origin(self) -> Origin:
        home = self._messages("HOME_POSITION")[-1].message
        return Origin(home.latitude / 1e7, home.longitude / 1e7, home.altitude / 1e3 + home.z)

    def _yaw(self) -> float:
        attitudes = self._messages("ATTITUDE")
        return float(next(one.message.yaw for one in attitudes if one.time_s >= self.recording.armed_s))

    def error(self, part: Span) -> NDArray[np.float64]:
        """[n, 3] velocity error [m/s] at the recorded samples of a part."""
        inside = (self.recorded.times >= part[0]) & (self.recorded.times < part[1])
        times = self.recorded.times[inside]
        return self.simulated.at(times).velocity - self.recorded.velocity[inside]

    def rms(self, part: Span) -> float:
        """RMS of the velocity error vector [m/s]."""
        return math.sqrt((self.error(part) ** 2).sum(axis=1).mean())

    def drift(self, part: Span) -> float:
        """How far the ways of both differ at the end of a part [m]."""
        ends = np.array(part)
        ways = [np.diff(moved.at(ends).position, axis=0) for moved in (self.simulated, self.recorded)]
        return float(np.linalg.norm(ways[0] - ways[1]))

    @cached_property
    def steps(self) -> list[Step]:
        """The velocity steps of plain setpoints while the stream ran."""
        asked: list[tuple[float, tuple[float, float, float]]] = []
        for one in self._messages("SET_POSITION_TARGET_LOCAL_NED"):
            message = one.message
            velocity = (message.vx, message.vy, message.vz)
            if message.coordinate_frame == 1 and message.type_mask == 1479 and max(map(abs, velocity)) < 20.0:
                asked.append((one.time_s, velocity))
        changes = [asked[0], *(b for a, b in pairwise(asked) if a[1] != b[1])]
        found = []
        for (_, before), (start, after), (end, _) in zip(changes, changes[1:], changes[2:], strict=False):
            times = [time for time, _ in asked if start <= time < end]
            gap = max(np.diff(times), default=0.0)
            if end - start >= STEP_S and gap < 1.0 and self.recording.parts["velocity steps"][0] <= start:
                found.append(Step(start, end, np.array(before), np.array(after)))
        return [step for step in found if step.time_s < self.recording.parts["velocity steps"][1]]

    @cached_property
    def happened(self) -> list[tuple[Event, float]]:
        """What happened as often to both: when to the recorded one, and how late to the simulated one [s].

        Within the times between which the recording shows it, it is not late at all.
        """
        recorded, simulated = numbered(events(self.frames)), numbered(events(self.said))
        often = [Counter(what for what, _ in one) for one in (recorded, simulated)]
        both = []
        for key, event in recorded.items():
            what = key[0]
            if often[0][what] != often[1][what] or what.startswith("ack") or len(what) < 5:
                continue
            at = simulated[key].by_s
            both.append((event, max(at - event.by_s, 0.0) + min(at - event.after_s, 0.0)))
        return both

    def late(self, what: str, occurrence: int = 0) -> float:
        """How late something happened [s]. Raises IndexError when it did not happen as often to both."""
        return [late for event, late in self.happened if event.what == what][occurrence]


def numbered(found: list[Event]) -> dict[tuple[str, int], Event]:
    """Events by what and the how-manieth."""
    seen: Counter[str] = Counter()
    by_key = {}
    for event in found:
        by_key[event.what, seen[event.what]] = event
        seen[event.what] += 1
    return by_key


def tell(flown: Flown) -> None:
    """Print the tables of one recording."""
    recording = flown.recording
    print(f"\n{recording.name}: {recording.path.name}")
    print(f"  {'part':18} {'s':>13}   RMS velocity error [m/s]           drift")
    print(f"  {'':18} {'':>13}   {'north':>6} {'east':>6} {'down':>6} {'vector':>7}   [m]")
    for name, part in {**recording.parts, "all by setpoints": recording.offboard}.items():
        north, east, down = np.sqrt((flown.error(part) ** 2).mean(axis=0))
        goal = f"   goal {GOAL_RMS_MPS}" if part == recording.offboard else ""
        print(
            f"  {name:18} {part[0]:6.1f}-{part[1]:6.1f}   {north:6.2f} {east:6.2f} {down:6.2f} {flown.rms(part):7.3f}"
            f" {flown.drift(part):6.2f}{goal}"
        )
    print(f"\n  {'step [m/s]':28} {'t50 [s]':>15} {'t90 [s]':>17}   (recorded, simulated; - = never)")
    for step in flown.steps:
        cells = [flown_time(step, moved, share) for share in (0.5, 0.9) for moved in (flown.recorded, flown.simulated)]
        ways = " -> ".join("({:.0f}, {:.0f}, {:.0f})".format(*v) for v in (step.before, step.after))
        print(f"  {ways:28} {cells[0]:>7} {cells[1]:>7}   {cells[2]:>7} {cells[3]:>7}")
    print(f"\n  {'event':46} {'recorded [s]':>19} {'late [s]':>9}   goal {GOAL_S}")
    several = Counter(event.what for event, _ in flown.happened)
    for event, late in flown.happened:
        if several[event.what] > MANY:
            continue
        between = f"{event.after_s:.2f}" if event.after_s == event.by_s else f"{event.after_s:.2f}-{event.by_s:.2f}"
        print(f"  {event.what[:46]:46} {between:>19} {late:9.2f}")

    for what, times in several.items():
        if times > MANY:
            worst = max((late for event, late in flown.happened if event.what == what), key=abs)
            print(f"  {what[:46]:46} {f'{times} times':>19} {worst:9.2f} at most")


def flown_time(step: Step, moved: Motion, share: float) -> str:
    seconds = step.reached(moved, share)
    return "-" if math.isnan(seconds) else f"{seconds:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n\n")[0], epilog=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="px4|arducopter", help="recordings to fly; both unless given")
    parser.add_argument("--cut", type=Path, help="make a recording from a whole one")
    parser.add_argument("--out", type=Path, help="where to write it (.tlog.gz)")
    options = parser.parse_args()
    if (options.cut is None) != (options.out is None):
        parser.error("--cut and --out belong together")
    unknown = [name for name in options.names if name not in RECORDINGS]
    if unknown:
        parser.error(f"{unknown[0]!r} is none of {', '.join(RECORDINGS)}")
    if options.cut is not None:
        write(options.out, cut(on_vehicle_time(read(options.cut)), CLIENT))
        return
    for name in options.names or RECORDINGS:
        tell(Flown(RECORDINGS[name]))


if __name__ == "__main__":
    main()
