"""The server: runs one autopilot on its links, paced by the wall clock or stepped by a control client."""

import os
import selectors
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from sitl.autopilot import TICK_MS, Autopilot
from sitl.control_socket import ControlSocket, read_advance
from sitl.flight_model import compile_now
from sitl.link import Link, PortError
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import Personality

BEHIND_MAX_S = 0.1
"""A paced vehicle that is further behind the wall clock lets the wall clock go, rather than rush."""
LOCKSTEP_EPOCH_US = 1_767_225_600_000_000
"""SYSTEM_TIME at boot in lockstep, 2026-01-01: the same inputs give the same bytes."""
COMPILE_NOTICE_S = 3.0
"""Loading the compiled code from the disk takes well under this."""
LINGER_MS = 3000
"""Vehicle time after the last disarming before the process ends, so that its clients hear of it."""
ORPHAN_CHECK_S = 1.0
"""How often a process that waits for its first control client looks for its launcher."""


@dataclass(frozen=True)
class Options:
    """How to run; ports are UDP on loopback, 0 picks a free one to listen on."""

    personality: Personality
    parameters: Parameters
    gcs_port: int = 14550
    companion_port: int = 14540
    gcs_bind: int = 18570
    companion_bind: int = 14580
    speed: float = 1.0
    lockstep: bool = False
    control_port: int | None = None
    exit_when_landed: bool = False
    launcher: int | None = None
    """Process id of our parent, without which no flight will begin."""
    seed: int = 0
    origin: Origin = field(default_factory=Origin)


class Stopped(Exception):  # noqa: N818  # not an error: somebody asked the process to end
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


class Server:
    """Sockets and clock of one autopilot."""

    def __init__(self, options: Options) -> None:
        """Raises PortError."""
        personality, p = options.personality, options.parameters
        rates_hz = personality.companion_rates_hz
        self._options = options
        self._was_controlled = False
        self._over_ms: int | None = None
        """Since when there is nothing left to fly."""
        self._open: list[Link | ControlSocket] = []
        try:
            system = int(p[personality.system_id])
            self._companion = self._opened(
                Link("companion", options.companion_bind, options.companion_port, rates_hz, system)
            )
            self._gcs = self._opened(
                Link("gcs", options.gcs_bind, options.gcs_port, personality.gcs_rates_hz, system, talks_first=False)
            )
            self._control = ControlSocket(options.control_port or 0) if self._controllable else None
        except PortError:
            self.close()
            raise
        if self._control is not None:
            self._open.append(self._control)
        with told_if_slow():
            compile_now(personality.gains(p), personality.craft(p))
        epoch_us = LOCKSTEP_EPOCH_US if options.lockstep else time.time_ns() // 1000
        self._autopilot = Autopilot(
            personality, p, options.origin, (self._companion, self._gcs), options.seed, epoch_us
        )
        self._selector = selectors.DefaultSelector()
        if self._control is not None:
            self._selector.register(self._control.listener, selectors.EVENT_READ)

    def _opened(self, link: Link) -> Link:
        self._open.append(link)
        return link

    @property
    def _controllable(self) -> bool:
        return self._options.lockstep or self._options.control_port is not None

    def describe(self) -> list[str]:
        """One line per socket, as printed at start."""
        lines = [
            f"{link.name} 127.0.0.1:{link.port} -> 127.0.0.1:{link.peer[1]}" for link in (self._companion, self._gcs)
        ]
        if self._control is not None:
            lines.append(f"control 127.0.0.1:{self._control.port}")
        return lines

    def run(self) -> None:
        """Fly until stopped, told to quit, or landed (`exit_when_landed`)."""
        wall = time.monotonic()
        vehicle_ms = self._autopilot.now_ms
        while not self._finished():
            if self._stepped:
                self._serve_control(ORPHAN_CHECK_S)
                wall, vehicle_ms = time.monotonic(), self._autopilot.now_ms
                continue
            due = wall + (self._autopilot.now_ms + TICK_MS - vehicle_ms) / 1000.0 / self._options.speed
            wait = due - time.monotonic()
            if wait > 0.0 or self._control is not None:
                self._serve_control(max(wait, 0.0))
                if self._stepped or time.monotonic() < due:
                    continue
            self._autopilot.advance(TICK_MS, receive_each_tick=True)
            if time.monotonic() - due > BEHIND_MAX_S:
                wall, vehicle_ms = time.monotonic(), self._autopilot.now_ms

    @property
    def _stepped(self) -> bool:
        """Whether a control client owns the clock, or is waited for."""
        if self._control is None:
            return False
        return self._control.connected or (self._options.lockstep and not self._was_controlled)

    def _finished(self) -> bool:
        commander = self._autopilot.vehicle.commander
        if not (commander.has_flown or self._was_controlled):
            return self._options.launcher not in (None, os.getppid())
        if not self._options.exit_when_landed or self._stepped or commander.armed:
            self._over_ms = None
            return False
        if self._over_ms is None:
            self._over_ms = self._autopilot.now_ms
        return self._autopilot.now_ms - self._over_ms >= LINGER_MS

    def _serve_control(self, timeout: float | None) -> None:
        """Wait for control clients, at most `timeout` s of wall clock, and answer them."""
        control = self._control
        if control is None:
            time.sleep(timeout or 0.0)
            return
        for key, _ in self._selector.select(timeout):
            if key.fileobj is control.listener:
                client = control.accept()
                if client is not None:
                    self._selector.register(client, selectors.EVENT_READ)
                    self._was_controlled = True
                continue
            for line in control.lines():
                self._answer(control, line)
            if not control.connected:
                self._selector.unregister(key.fileobj)

    def _answer(self, control: ControlSocket, line: str) -> None:
        request, _, argument = line.partition(" ")
        if request == "hello" and not argument:
            control.answer(f"aerialstar-sitl 1 {self._autopilot.now_ms}")
        elif request == "advance":
            try:
                duration = read_advance(argument)
            except ValueError as error:
                control.answer(f"error {error}")
                return
            before = self._companion.sent
            self._autopilot.receive()
            self._autopilot.advance(duration)
            control.answer(f"advanced {self._autopilot.now_ms} {self._companion.sent - before}")
        elif request == "quit" and not argument:
            control.answer("bye")
            raise Stopped
        else:
            control.answer(f"error {line!r}: expected hello, advance <ms> or quit")

    def close(self) -> None:
        """Close all sockets."""
        for opened in self._open:
            opened.close()


def run(options: Options) -> int:
    """Run a SITL in this process until it ends; the exit code. A port in use is told in one line on stderr."""
    stopping = False

    def stop(_signal: int, _frame: object) -> None:
        nonlocal stopping
        if not stopping:  # a second signal must not interrupt the closing
            stopping = True
            raise Stopped

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    server = None
    try:
        server = Server(options)
        for line in server.describe():
            print(line, flush=True)
        server.run()
    except Stopped:
        return 0
    except PortError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        if server is not None:
            server.close()
    return 0
