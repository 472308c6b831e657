"""Latency of the rf node in each `ris` mode: a slot's opening in, configuration and link report out, over zenoh.

    python benchmarks/rf_node.py [--slots 300] [--mode closed_form]

Two processes on loopback, N = 256, J = 8, M = 4, ten slots a second of wall clock: this one plays the bridge, the other
is `aerialstar rf`, with all its threads on one core (the last of those allowed). A time is from just before
`SlotOpened(k)` is sent until `RisConfiguration(k)` and `LinkReport(k - 1)` have both arrived, undecoded. In the mode
`agent` a prepared `Action(k)` goes back as soon as `ChannelState(k)` is here, and the time covers that way round too.
Percentiles are over all slots but the first ten. `CPU/slot` is processor time of all threads of the node. On a machine
with other work, who has the right to may run it by `chrt -f 10`: the other work then does not push in.
"""

import argparse
import math
import os
import queue
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import yaml
import zenoh

from bus import topics
from bus.messages import Action, FlownSlot, SlotOpened, TrackSample
from bus.session import free_endpoint, open_session
from rf_model.scenario import Scenario, preset

PERIOD_S = 0.1
"""Wall clock between openings; a slot is 1 s of vehicle time, as in a paced flight ten times as fast."""
VEHICLE = "bench"
GOAL_MS = {"agent": None, "closed_form": 10.0, "optimised": 25.0}
WARM_UP = 10
PATIENCE_S = 60.0
"""For the node to come up (the reference compiles the first time) or to answer."""
OUT = {topic.name: topic for topic in (topics.CSI, topics.CONFIGURATION, topics.LINK)}


class Bridge:
    """The other end of the loop; notes when each of the node's messages arrived."""

    def __init__(self, session: zenoh.Session, scenario: Scenario) -> None:
        self.scenario = scenario
        self.arrived: queue.SimpleQueue[tuple[str, float]] = queue.SimpleQueue()
        self.slot = topics.Publisher(session, VEHICLE, topics.SLOT)
        self.action = topics.Publisher(session, VEHICLE, topics.ACTION)
        self.alive: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self.kept = [topics.watch_alive(session, VEHICLE, lambda node, alive: self.alive.put(alive))]
        for name in OUT:
            key = topics.key(VEHICLE, name)
            self.kept.append(
                session.declare_subscriber(key, lambda _, name=name: self.arrived.put((name, time.perf_counter())))
            )

    def milliseconds(self, slot: int, answer: bool) -> float:
        """Open a slot and wait for all that the node says about it."""
        opened, action = self.opened(slot), self.prepared(slot)
        due = set(OUT) - ({topics.LINK.name} if slot == 0 else set())
        start = time.perf_counter()
        self.slot.send(opened)
        last = start
        while due:
            name, when = self.arrived.get(timeout=PATIENCE_S)
            due.remove(name)
            if name != topics.CSI.name:
                last = max(last, when)
            elif answer:
                self.action.send(action)
        return 1e3 * (last - start)

    def opened(self, slot: int) -> SlotOpened:
        """The vehicle circles at 5 m/s; the slot before was flown."""
        zero = (0.0, 0.0, 0.0)

        def at(time_s: float) -> TrackSample:
            east, north = math.cos(time_s / 10), math.sin(time_s / 10)
            return TrackSample(
                time_s=time_s,
                position_enu=(50 * east, 50 * north, 60.0),
                velocity_enu=(-5 * north, 5 * east, 0.0),
            )

        track = [at(slot - 1 + i / 10) for i in range(11)]
        flown = (
            FlownSlot(
                slot=slot - 1,
                outcome="flown",
                reasons=[],
                commanded_enu=zero,
                planned_enu=zero,
                flown_enu=zero,
                track=track,
                plan=track,
            )
            if slot
            else None
        )
        now = track[-1]
        return SlotOpened(
            slot=slot,
            slots=1_000_000,
            time_s=now.time_s,
            position_enu=now.position_enu,
            velocity_enu=now.velocity_enu,
            attitude_rad=zero,
            closing=False,
            flown=flown,
        )

    def prepared(self, slot: int) -> Action:
        s, rng = self.scenario, np.random.default_rng(slot)
        beams = rng.standard_normal((s.antennas, s.users, 2))
        beams *= math.sqrt(s.p_max_w / (beams**2).sum())
        return Action(
            slot=slot,
            time_s=float(slot),
            source="benchmark",
            displacement_enu=(0.0, 0.0, 0.0),
            theta_reflection=rng.uniform(-math.pi, math.pi, s.elements).tolist(),
            split_angle=rng.uniform(0, math.pi / 2, s.elements).tolist(),
            sign=rng.choice([-1, 1], s.elements).tolist(),
            beamforming=[[(re, im) for re, im in row] for row in beams.tolist()],
            raw=[],
        )


def processor_s(pid: int) -> float:
    """User and system time of a process [s] (proc(5), stat)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(mode: str, slots: int) -> tuple[list[float], float]:
    """Latencies of the slots [ms], and the node's processor time for a slot [ms]."""
    core = max(os.sched_getaffinity(0))
    scenario = preset("physical_1km", users=8)
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as folder, open_session(listen=endpoint) as session:
        mission = Path(folder) / "mission.yaml"
        fields = {"scenario": {"preset": "physical_1km", "users": 8}, "ris": mode}

        mission.write_text(yaml.safe_dump(fields))
        bridge = Bridge(session, scenario)
        command = [sys.executable, "-m", "mission", "rf", "--mission", str(mission), "--vehicle", VEHICLE]
        node = subprocess.Popen([*command, "--connect", endpoint])
        try:
            os.sched_setaffinity(node.pid, {core})
            bridge.alive.get(timeout=PATIENCE_S)
            times = []
            start, used = time.perf_counter(), processor_s(node.pid)
            for slot in range(slots):
                time.sleep(max(0.0, start + slot * PERIOD_S - time.perf_counter()))
                times.append(bridge.milliseconds(slot, answer=mode == "agent"))
                if slot == WARM_UP:
                    used = processor_s(node.pid)
            return times[WARM_UP:], 1e3 * (processor_s(node.pid) - used) / (slots - WARM_UP)
        finally:
            node.terminate()
            node.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slots", type=int, default=300, help="slots for each mode")
    parser.add_argument("--mode", choices=GOAL_MS, help="only this one")
    given = parser.parse_args()
    modes: Sequence[str] = [given.mode] if given.mode else list(GOAL_MS)
    print("rf node, N=256 M=4 J=8, 10 slots/s, one core; ms from SlotOpened to configuration and report")
    print(f"  {'ris':14}{'p50':>8}{'p99':>8}{'max':>8}{'goal p99':>10}{'CPU/slot':>10}")
    for mode in modes:
        times, cpu_ms = measure(mode, given.slots)
        middle, high = np.percentile(times, [50, 99])
        goal = GOAL_MS[mode]
        print(f"  {mode:14}{middle:8.2f}{high:8.2f}{max(times):8.2f}{goal or '':>10}{cpu_ms:10.2f}")


if __name__ == "__main__":
    main()
