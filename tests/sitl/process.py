"""A SITL as its own process, for tests of any room: `with sitl_process() as sitl: ...`."""

import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class SitlProcess:
    """A running SITL and its ports, all on 127.0.0.1."""

    companion: int
    """UDP: the SITL sends its companion telemetry here; a client binds it (as 14540)."""
    companion_bind: int
    """UDP: the SITL listens here on the companion link (as 14580)."""
    gcs: int
    """UDP: as 14550."""
    gcs_bind: int
    """UDP: as 18570."""
    control: int
    """TCP: the control socket."""
    tcp: int
    """TCP: MAVLink, as 5760; 0 when it serves none."""
    process: subprocess.Popen[str]


def free_udp_port() -> int:
    """A UDP port that was free a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def sitl_process(
    *arguments: str, lockstep: bool = True, speed: float = 1.0, parameters: dict[str, float] | None = None
) -> Iterator[SitlProcess]:
    """Start `python -m sitl` on free ports, yield once it is ready, end it when the block ends.

    Lockstep: it stands still until a control client connects. Else it is paced at `speed`. The control socket is
    there in both cases. Further `arguments` go to the command line as they are.
    """
    companion, gcs = free_udp_port(), free_udp_port()
    command = [sys.executable, "-m", "sitl", "--companion-port", str(companion), "--gcs-port", str(gcs)]
    command += ["--companion-bind", "0", "--gcs-bind", "0", "--control-port", "0", "--speed", str(speed)]
    command += ["--lockstep"] if lockstep else []
    for name, value in (parameters or {}).items():
        command += ["--param", f"{name}={value}"]
    process = subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        ports = {}
        while "control" not in ports:
            line = process.stdout.readline()
            match = re.fullmatch(r"(companion|gcs|tcp|control) 127\.0\.0\.1:(\d+).*\n", line)
            assert match, f"the SITL did not start: {line!r}"
            ports[match[1]] = int(match[2])
        yield SitlProcess(
            companion, ports["companion"], gcs, ports["gcs"], ports["control"], ports.get("tcp", 0), process
        )
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


def step(sitl: SitlProcess, duration_ms: int) -> None:
    """Move a paced vehicle on at once, by its control socket; after that it is paced again."""
    with (
        socket.create_connection(("127.0.0.1", sitl.control)) as connection,
        connection.makefile("r") as answers,
    ):
        for line in ("hello", *[f"advance {min(1000, duration_ms - done)}" for done in range(0, duration_ms, 1000)]):
            connection.sendall(line.encode() + b"\n")
            assert not answers.readline().startswith("error")
