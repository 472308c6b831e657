"""The server: runs autopilots on their links, paced by the wall clock or stepped by a control client."""

import copy
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

from sitl.autopilot import TICK_MS, Autopilot
from sitl.control_socket import ControlClient, ControlSocket, read_advance
from sitl.flight.flight_model import compile_now
from sitl.links.link import Link, PortError
from sitl.links.network import Network, Port
from sitl.links.signing import Signing
from sitl.links.tcp import TcpPort
from sitl.links.udp import SILENT_MS, UdpPort
from sitl.origin import Origin
from sitl.pacing import Pacer
from sitl.parameters import Parameters
from sitl.personality import Personality
from sitl.requests import VEHICLE_REQUESTS

LOCKSTEP_EPOCH_US = 1_767_225_600_000_000
"""SYSTEM_TIME at boot in lockstep, 2026-01-01: the same inputs give the same bytes."""
COMPILE_NOTICE_S = 3.0
"""Loading the compiled code from the disk takes well under this."""
LINGER_MS = 3000
"""Vehicle time after the last disarming before the process ends, so that its clients hear of it."""
ORPHAN_CHECK_S = 1.0
"""How often a process that waits for its first control client looks for its launcher."""
COMPANION_PORTS = 10
"""PX4 gives its first ten instances companion ports of their own; the others share the tenth's."""
TCP_STRIDE = 10
"""ArduPilot's distance between the TCP ports of two instances."""


@dataclass(frozen=True)
class Options:
    """How to run; ports are on loopback, UDP unless said, 0 picks a free one to listen on.

    Vehicle i = 0, 1, ... has the system id and the ports of the first one plus i, as PX4 numbers its instances.
    """

    personality: Personality
    parameters: Parameters
    gcs_port: int = 14550
    companion_port: int = 14540
    gcs_bind: int = 18570
    companion_bind: int = 14580
    tcp_port: int | None = None
    speed: float = 1.0
    lockstep: bool = False
    control_port: int | None = None
    exit_when_landed: bool = False
    launcher: int | None = None
    """Process id of our parent, without which no flight will begin."""
    seed: int = 0
    origin: Origin = field(default_factory=Origin)
    vehicles: int = 1
    spacing_m: float = 5.0
    """Each vehicle starts so far east of the one before."""
    signing_key: bytes | None = None


class Stopped(BaseException):  # not an error, so that nothing that handles errors handles it
    """SIGINT, SIGTERM or `quit`."""


@contextmanager
def told_if_slow() -> Iterator[None]:
    """Say what takes so long when the flight model has to be compiled."""
    notice = threading.Timer(
        COMPILE_NOTICE_S, print, ("compiling the flight model, once ...",), {"flush": True, "file": sys.stderr}
    )
    notice.start()
    try:
        yield
    finally:
        notice.cancel()


class Instance:
    """One vehicle of the process: its sockets and its autopilot."""

    def __init__(self, options: Options, index: int, epoch_us: int) -> None:
        """Raises PortError."""
        personality, p = options.personality, copy.deepcopy(options.parameters)
        self.system = int(p[personality.system_id]) + index
        p.set(personality.system_id, self.system)
        signing = Signing(options.signing_key)
        silent_ms = round(SILENT_MS * max(options.speed, 1.0))
        self._ports: list[UdpPort | TcpPort] = []

        def new_link(name: str, put: Callable[[bytes], bool], now_ms: int) -> Link:
            gcs = name == "gcs"
            rates_hz = personality.gcs_rates_hz if gcs else personality.companion_rates_hz
            return Link(name, rates_hz, self.system, signing, put, talks_first=not gcs, now_ms=now_ms)

        def offset(port: int, stride: int = 1) -> int:
            return port and port + index * stride

        try:
            peer = options.companion_port + min(index, COMPANION_PORTS - 1)
            companion = UdpPort(
                "companion", offset(options.companion_bind), peer, partial(new_link, "companion"), silent_ms
            )
            self._ports.append(companion)
            self._ports.append(
                UdpPort("gcs", offset(options.gcs_bind), options.gcs_port, partial(new_link, "gcs"), silent_ms)
            )
            if options.tcp_port is not None:
                self._ports.append(TcpPort("tcp", offset(options.tcp_port, TCP_STRIDE), partial(new_link, "tcp")))
        except PortError:
            self.close()
            raise
        self.companion = companion.configured
        """The link whose frames `advance` counts."""
        ports: list[Port] = [*self._ports]
        north, east = 0.0, index * options.spacing_m
        latitude, longitude = options.origin.globe(north, east)
        origin = Origin(latitude, longitude, options.origin.altitude) if index else options.origin
        network = Network(ports, self.system, signing)
        self.autopilot = Autopilot(personality, p, origin, network, options.seed + index, epoch_us)

    def describe(self) -> list[str]:
        """One line per socket."""
        return [port.describe() for port in self._ports]

    def close(self) -> None:
        for port in self._ports:
            port.close()


class Server:
    """Sockets and clock of the vehicles of one process."""

    def __init__(self, options: Options, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` is the wall clock [s]. Raises PortError."""
        personality, p = options.personality, options.parameters
        self._options = options
        self._was_controlled = False
        self._over_ms: int | None = None
        """Since when there is nothing left to fly."""
        self.instances: list[Instance] = []
        self._control: ControlSocket | None = None
        epoch_us = LOCKSTEP_EPOCH_US if options.lockstep else time.time_ns() // 1000
        try:
            for index in range(options.vehicles):
                self.instances.append(Instance(options, index, epoch_us))
            if options.lockstep or options.control_port is not None:
                self._control = ControlSocket(options.control_port or 0)
        except PortError:
            self.close()
            raise
        with told_if_slow():
            compile_now(personality.gains(p), personality.craft(p))
        self._pacer = Pacer(TICK_MS / 1000.0, options.speed, clock)

    @property
    def now_ms(self) -> int:
        """Vehicle time, the same for all."""
        return self.instances[0].autopilot.now_ms

    def describe(self) -> list[str]:
        """One line per socket, as printed at start; of several vehicles each is named by its system id."""
        several = len(self.instances) > 1
        lines = [
            f"vehicle {instance.system} {line}" if several else line
            for instance in self.instances
            for line in instance.describe()
        ]
        if self._control is not None:
            lines.append(self._control.describe())
        return lines

    def run(self, stopping: Callable[[], bool]) -> None:
        """Fly until `stopping`, told to quit, or landed (`exit_when_landed`)."""
        while not (stopping() or self._finished()):
            self.turn()

    def turn(self) -> None:
        """Wait for a request or until a tick is due, at most a second, and do it."""
        if self._stepped:
            self._serve_control(ORPHAN_CHECK_S)
            self._pacer.restart()
            return
        wait_s = self._pacer.wait_s()
        if wait_s > 0.0 or self._control is not None:
            self._serve_control(wait_s)
            if self._stepped or self._pacer.wait_s() > 0.0:
                return
        for instance in self.instances:
            instance.autopilot.receive()
            instance.autopilot.advance(TICK_MS)
        self._pacer.ticked()

    @property
    def _stepped(self) -> bool:
        """Whether a control client owns the clock, or is waited for."""
        if self._control is None:
            return False
        return self._control.owner is not None or (self._options.lockstep and not self._was_controlled)

    def _finished(self) -> bool:
        commanders = [instance.autopilot.vehicle.commander for instance in self.instances]
        if not (self._was_controlled or any(commander.has_flown for commander in commanders)):
            return self._options.launcher not in (None, os.getppid())
        if not self._options.exit_when_landed or self._stepped or any(commander.armed for commander in commanders):
            self._over_ms = None
            return False
        if self._over_ms is None:
            self._over_ms = self.now_ms
        return self.now_ms - self._over_ms >= LINGER_MS

    def _serve_control(self, timeout_s: float) -> None:
        """Wait for control clients, at most so long, and answer them."""
        if self._control is None:
            time.sleep(timeout_s)
            return
        for client, line in self._control.requests(timeout_s):
            try:
                client.answer(self._answer(self._control, client, line))
            except ValueError as error:
                client.answer(f"error {error}")
        self._control.drop_gone()

    def _answer(self, control: ControlSocket, client: ControlClient, line: str) -> str:
        """The answer to one request. Raises ValueError with what is wrong with it."""
        request, _, argument = line.partition(" ")
        if line == "hello":
            self._was_controlled |= control.owns(client)
            return f"aerialstar-sitl 1 {self.now_ms}"
        if request == "advance":
            duration_ms = read_advance(argument)
            if not control.owns(client):
                raise ValueError("advance: the clock belongs to another control client")
            self._was_controlled = True
            return f"advanced {self._step(duration_ms)}"
        if line == "quit":
            client.answer("bye")
            raise Stopped
        instance = self.instances[0]
        if request == "vehicle":
            number, _, argument = argument.partition(" ")
            instance = self._instance(number)
            request, _, argument = argument.partition(" ")
        handler = VEHICLE_REQUESTS.get(request)
        if handler is None:
            known = ", ".join(sorted(VEHICLE_REQUESTS))
            raise ValueError(f"{line!r}: expected hello, advance <ms>, quit, {known} or vehicle <system id> <request>")
        return handler(instance.autopilot, argument)

    def _instance(self, number: str) -> Instance:
        for instance in self.instances:
            if str(instance.system) == number:
                return instance
        known = ", ".join(str(instance.system) for instance in self.instances)
        raise ValueError(f"vehicle: {number!r} is no system id, {known} are")

    def _step(self, duration_ms: int) -> str:
        """Move all vehicles; the time and the frames each sent to its companion."""
        before = [instance.companion.sent for instance in self.instances]
        for instance in self.instances:
            instance.autopilot.receive()
            instance.autopilot.advance(duration_ms)
        frames = [instance.companion.sent - sent for instance, sent in zip(self.instances, before, strict=True)]
        return " ".join(map(str, (self.now_ms, *frames)))

    def close(self) -> None:
        """Close all sockets."""
        for instance in self.instances:
            instance.close()
        if self._control is not None:
            self._control.close()


def run(options: Options) -> int:
    """Run a SITL in this process until it ends; the exit code. A port in use is told in one line on stderr."""
    stopping = False

    def stop(_signal: int, _frame: object) -> None:
        nonlocal stopping
        if not stopping:  # a second signal must not interrupt the closing
            stopping = True
            raise Stopped  # lost when it meets a destructor or a callback from C; then `stopping` ends the run

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    server = None
    try:
        server = Server(options)
        for line in server.describe():
            print(line, flush=True)
        server.run(lambda: stopping)
    except Stopped:
        return 0
    except PortError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        if server is not None:
            server.close()
    return 0
