"""How fast the simulated autopilot runs: real-time factors, vehicles in real time, memory, start.

    python benchmarks/sitl_speed.py [--seconds 60] [--first-start]

Vehicle seconds per second of processor time of the one thread that runs the vehicle, so that a machine shared with
others is judged fairly; it hovers in lockstep with steps of 50 ms and sends over a real UDP socket to a client that
reads nothing. `--first-start` times a start with an empty compile cache as well. The goals are those of issue 4.
"""

import argparse
import os
import re
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pymavlink.dialects.v20 import development as mavlink

from sitl.parameters import Parameters
from sitl.px4.personality import PX4
from sitl.server import Options, Server

STEP_MS = 50
TEN_HZ = dict.fromkeys(
    ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE", "SYS_STATUS", "EXTENDED_SYS_STATE"), 10.0
) | {"HEARTBEAT": 1.0}
ROUNDS = 10


@contextmanager
def hovering(vehicles: int, rates_hz: dict[str, float] | None) -> Iterator[Server]:
    """Vehicles in the air at these companion rates (None: PX4's), in lockstep, their ground links asleep."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.bind(("127.0.0.1", 0))
        options = Options(
            PX4,
            Parameters(PX4.table),
            companion_port=int(sink.getsockname()[1]),
            companion_bind=0,
            gcs_bind=0,
            lockstep=True,
            vehicles=vehicles,
        )
        server = Server(options)
        try:
            for instance in server.instances:
                if rates_hz is not None:
                    instance.companion.default_rates_hz = rates_hz
                    instance.companion.reset_streams(0)
            step(server, 5.0)
            for instance in server.instances:
                commander = instance.autopilot.vehicle.commander
                commander.arm(force=False)
                commander.takeoff(float("nan"))
            step(server, 15.0)
            assert all(instance.autopilot.vehicle.commander.flying for instance in server.instances)
            yield server
        finally:
            server.close()


def step(server: Server, seconds: float) -> None:
    """Move all vehicles, reading their links once per step as a control client's `advance` does."""
    for _ in range(round(seconds * 1000 / STEP_MS)):
        for instance in server.instances:
            instance.autopilot.receive()
            instance.autopilot.advance(STEP_MS)


def factor(server: Server, seconds: float) -> float:
    """Vehicle seconds per second of processor time, of all vehicles together; the best of some rounds, as for timeit:
    what others do on the machine can only make it slower."""
    found = []
    for _ in range(ROUNDS):
        started = time.process_time()
        step(server, seconds / ROUNDS)
        found.append(seconds / ROUNDS * len(server.instances) / (time.process_time() - started))
    return max(found)


def paced_load(vehicles: int, seconds: float) -> float:
    """Share of one core that so many vehicles take in real time, read every tick as a paced server does."""
    with hovering(vehicles, TEN_HZ) as server:
        started = time.process_time()
        for _ in range(round(seconds * 100)):
            for instance in server.instances:
                instance.autopilot.receive()
                instance.autopilot.advance(10)
        return (time.process_time() - started) / seconds


def memory_mib(vehicles: int) -> float:
    """Peak memory of a process of so many vehicles, ten seconds after boot."""
    with sitl("--vehicles", str(vehicles), "--lockstep") as (process, control, _):
        ask(control, "advance 10000")
        status = Path(f"/proc/{process.pid}/status").read_text()
    found = re.search(r"VmHWM:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else float("nan")


@contextmanager
def sitl(*arguments: str, cache: str | None = None) -> Iterator[tuple[subprocess.Popen[str], int, float]]:
    """A process, its control port, and when it was started."""
    ports = ["--companion-bind", "0", "--gcs-bind", "0", "--control-port", "0"]
    environment = os.environ | ({"NUMBA_CACHE_DIR": cache} if cache else {})
    started = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "sitl", *ports, *arguments], stdout=subprocess.PIPE, text=True, env=environment
    )
    try:
        assert process.stdout is not None
        control = next(int(line.split(":")[1]) for line in process.stdout if line.startswith("control "))
        yield process, control, started
    finally:
        process.terminate()
        process.communicate()


def ask(control: int, request: str) -> str:
    """One request on a control socket."""
    with socket.create_connection(("127.0.0.1", control)) as tcp, tcp.makefile() as replies:
        tcp.sendall(f"{request}\n".encode())
        return replies.readline().strip()


def start_s(cache: str | None = None) -> float:
    """Seconds from starting the process to its first heartbeat, which comes at 1 s of vehicle time."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.1", 0))
        client.settimeout(120)
        port = str(client.getsockname()[1])
        with sitl("--companion-port", port, "--lockstep", cache=cache) as (_, control, started):
            ask(control, "advance 1100")
            codec = mavlink.MAVLink(None)
            while codec.decode(bytearray(client.recv(65535))).get_type() != "HEARTBEAT":
                pass
            return time.perf_counter() - started


def row(what: str, value: float, unit: str, goal: float, at_least: bool) -> None:
    met = value >= goal if at_least else value <= goal
    print(f"{what:<58} {value:8.1f} {unit:<4} goal {'>=' if at_least else '<='} {goal:g}  {'yes' if met else 'NO'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="vehicle seconds per measurement")
    parser.add_argument("--first-start", action="store_true", help="also a start that compiles everything")
    arguments = parser.parse_args()
    seconds: float = arguments.seconds
    for what, rates_hz, goal in (
        ("physics and controllers alone", {}, 300.0),
        ("position, attitude and status at 10 Hz", TEN_HZ, 200.0),
        ("PX4's companion rates", None, 60.0),
    ):
        with hovering(1, rates_hz) as server:
            row(f"real-time factor, {what}", factor(server, seconds), "x", goal, at_least=True)
    row("one core's load by 50 vehicles in real time, 10 Hz", 100 * paced_load(50, seconds / 10), "%", 100.0, False)
    row("memory of 20 vehicles", memory_mib(20), "MiB", 250.0, at_least=False)
    row("start to first heartbeat, warm", min(start_s() for _ in range(3)), "s", 1.5, at_least=False)
    if arguments.first_start:
        cache = tempfile.mkdtemp()
        try:
            row("start to first heartbeat, nothing compiled yet", start_s(cache), "s", 40.0, at_least=False)
        finally:
            shutil.rmtree(cache)
    print(f"peak memory of this process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
