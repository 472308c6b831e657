"""Vehicles in real time, all processes included: slots missed, the loop's time, processor and memory by process.

    python benchmarks/fleet.py [--vehicles 10] [--slots 60] [--speed 1] [--cores 0,1] [--separation 6]

Flies a mission of so many embedded vehicles by the shipped policy with `aerialstar fly`, pinned to `--cores`, in a
temporary folder. Times are wall clock at the recorder, from a slot's opening to its action on the bus. Processor time
is that of /proc/<pid>/stat between the last vehicle's first slot and the first vehicle's last one, in percent of one
core; memory is the proportional set size (/proc/<pid>/smaps_rollup) in the middle of that. Look at the load that it
prints first: on a machine that does other things as well the numbers are theirs, too.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from bus import topics
from mission import flight_log

TICKS = os.sysconf("SC_CLK_TCK")
SAMPLE_S = 1.0
MARK = "AERIALSTAR_BENCHMARK"


@dataclass(frozen=True)
class Usage:
    """One process at one moment."""

    wall_s: float
    cpu_s: float
    memory_mb: float


def sample(mark: str) -> dict[tuple[int, str], Usage]:
    """What each process of the flight has used, by process id and role."""
    found = {}
    for process in Path("/proc").iterdir():
        if not process.name.isdigit():
            continue
        with contextlib.suppress(OSError):
            if f"{MARK}={mark}".encode() not in (process / "environ").read_bytes().split(b"\0"):
                continue
            words = (process / "cmdline").read_bytes().decode().split("\0")
            role = words[3] if words[2] == "mission" else words[2]
            after_name = (process / "stat").read_text().rpartition(")")[2].split()
            cpu_s = (int(after_name[11]) + int(after_name[12])) / TICKS
            lines = (process / "smaps_rollup").read_text().splitlines()
            memory_kb = next(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
            found[int(process.name), role] = Usage(time.time(), cpu_s, memory_kb / 1024)
    return found


def fly(fields: dict[str, object], folder: Path) -> tuple[Path, list[dict[tuple[int, str], Usage]], int]:
    """Fly a mission; its run folder, what was sampled meanwhile, and the exit code."""
    path, mark = folder / "fleet.yaml", str(os.getpid())
    path.write_text(yaml.safe_dump(fields))
    command = [sys.executable, "-m", "mission", "fly", str(path), "--output", str(folder / "runs")]
    samples = []
    with (folder / "out.txt").open("w") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out, env=os.environ | {MARK: mark})
        while process.poll() is None:
            samples.append(sample(mark))
            time.sleep(SAMPLE_S)
    runs = list((folder / "runs").iterdir())
    if len(runs) != 1 or process.returncode not in (0, 3):
        sys.exit((folder / "out.txt").read_text())
    return runs[0], samples, process.returncode


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=10)
    parser.add_argument("--slots", type=int, default=60)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--cores", default="0,1", help="processors to run on")
    parser.add_argument("--separation", type=float, default=6.0, help="metres; 0: nobody hears the others")
    given = parser.parse_args()
    cores = {int(core) for core in given.cores.split(",")}
    os.sched_setaffinity(0, cores)
    print(f"load before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores; this flight has {len(cores)}", flush=True)
    fields = {
        "seed": 7,
        "scenario": {"preset": "physical_small", "start_enu": [0, 0, 30]},
        "slots": given.slots,
        "speed": given.speed,
        "limits": {"separation_m": given.separation},
        "vehicles_spacing_m": 20,
        "at_end": "land",
        "vehicles": [{}] * given.vehicles,
    }
    with tempfile.TemporaryDirectory() as folder:
        run, samples, code = fly(fields, Path(folder))
        logs = {path.parent.name: flight_log.read(path.parent) for path in sorted(run.glob("*/flight.mcap"))}
    outcomes: Counter[str] = Counter()
    took_ms, lost, skipped, first, last = [], [], 0, 0.0, float("inf")
    for log in logs.values():
        done = [slot.flown for slot in log.messages(topics.SLOT) if slot.flown]
        outcomes.update(slot.outcome for slot in done)
        lost += [slot.slot for slot in done if slot.outcome in ("missing", "late", "rejected")]
        walls = [entry.wall_s for entry in log.entries if entry.topic == topics.SLOT.name]
        slots = [slot.slot for slot in log.messages(topics.SLOT)]
        opened = dict(zip(slots, walls, strict=True))
        answers = [entry.wall_s for entry in log.entries if entry.topic == topics.ACTION.name]
        numbers = [action.slot for action in log.messages(topics.ACTION)]
        took_ms += [1e3 * (wall - opened[slot]) for slot, wall in zip(numbers, answers, strict=True)]
        first, last = max(first, walls[0]), min(last, walls[-1])
        healths = [health for health in log.messages(topics.HEALTH) if health.node == "bridge"]
        skipped += healths[-1].counters.get("steps_skipped", 0)
    flown = sum(outcomes.values())
    print(f"exit {code}; {flown} of {given.vehicles * given.slots} slots: {dict(outcomes)}")
    print(f"missed, late or rejected: {len(lost)} (slots {sorted(lost)}); steps skipped: {skipped}")
    print(f"load after: {os.getloadavg()[0]:.2f}")
    p50, p99, most = np.percentile(took_ms, [50, 99, 100])
    print(f"slot opened to action on the bus: median {p50:.0f} ms, p99 {p99:.0f} ms, longest {most:.0f} ms")
    report(samples, first, last)


def report(samples: list[dict[tuple[int, str], Usage]], first: float, last: float) -> None:
    """Processor and memory by role between two moments."""
    seen = defaultdict(list)
    for one in samples:
        for process, usage in one.items():
            if first <= usage.wall_s <= last:
                seen[process].append(usage)
    cpu: defaultdict[str, float] = defaultdict(float)
    memory: defaultdict[str, float] = defaultdict(float)
    count: Counter[str] = Counter()
    for (_, role), usages in seen.items():
        if len(usages) > 1:
            cpu[role] += 100 * (usages[-1].cpu_s - usages[0].cpu_s) / (usages[-1].wall_s - usages[0].wall_s)
            memory[role] += usages[len(usages) // 2].memory_mb
            count[role] += 1
    print(f"over {last - first:.0f} s:   processes   % of a core   MB")
    for role in sorted(cpu, key=lambda role: -cpu[role]):
        print(f"  {role:12s} {count[role]:8d} {cpu[role]:13.1f} {memory[role]:9.0f}")
    print(f"  {'all':12s} {sum(count.values()):8d} {sum(cpu.values()):13.1f} {sum(memory.values()):9.0f}")


if __name__ == "__main__":
    main()
