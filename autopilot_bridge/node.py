"""The bridge node: one vehicle's flight between the bus and the autopilot."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import zenoh

from autopilot_bridge.clock import Clock, Lockstep, Paced
from autopilot_bridge.config import BridgeConfig, LockstepClock
from autopilot_bridge.dialects import Dialect
from autopilot_bridge.dialects.px4 import PX4
from autopilot_bridge.flight import ERROR, Flight
from autopilot_bridge.ground import Ground
from autopilot_bridge.link import Link, LinkError
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle

DIALECTS: dict[str, Dialect] = {"px4": PX4}


def run(config: BridgeConfig, vehicle: str, session: zenoh.Session, tlog: Path | None) -> int:
    """Fly `config` under the bus name `vehicle`; the exit code: 0 as planned, 3 ended safely early, 1 error.

    `tlog` is the flight log to write, if any. The caller opens and closes the session. On the main thread the first
    Ctrl-C lands; the second ends the process and leaves the vehicle to the autopilot's failsafe.
    """
    ground = Ground(session, vehicle)
    with contextlib.ExitStack() as served, _interrupted_by(lambda: ground.commands.put("land")):
        try:
            with contextlib.closing(Link(config.autopilot, config.system_id, tlog)) as link:
                code = _fly(config, ground, link, served)
        except LinkError as error:
            ground.tell("error", str(error))
            code = ERROR
        ground.tell("ended", f"exit {code}", code)
        return code


def _fly(config: BridgeConfig, ground: Ground, link: Link, served: contextlib.ExitStack) -> int:
    """Alive on the bus only once a flight is there to take commands."""
    dialect = DIALECTS[config.dialect]
    clock = _clock(config)
    ground.now = lambda: clock.now
    flight = Flight(
        config, dialect, ground, clock, lambda wait: PymavlinkVehicle(link, dialect, config.system_id, clock, wait)
    )
    served.enter_context(ground.served())
    code = flight.run()
    with contextlib.suppress(LinkError):  # a SITL that is gone needs no farewell
        clock.close(over=flight.down)
    return code


def _clock(config: BridgeConfig) -> Clock:
    if isinstance(config.clock, LockstepClock):
        return Lockstep(config.clock.control, config.tick_ms)
    return Paced(config.clock.speed, config.tick_ms)


@contextlib.contextmanager
def _interrupted_by(first: Callable[[], None]) -> Iterator[None]:
    """SIGINT calls `first`, a second one is Python's KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def on_interrupt(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        first()

    before = signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
