"""The bridge node: one vehicle's flight between the bus and the autopilot."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import zenoh

from autopilot_bridge.clock import Clock, Lockstep, Paced
from autopilot_bridge.config import BridgeConfig, LockstepClock
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.flight import ERROR, Flight
from autopilot_bridge.ground import Ground
from autopilot_bridge.link import Link, LinkError
from autopilot_bridge.mavlink_vehicle import MavlinkVehicle
from autopilot_bridge.signing import Signing, read_key


def run(config: BridgeConfig, vehicle: str, session: zenoh.Session, tlog: Path | None) -> int:
    """Fly `config` under the bus name `vehicle`; the exit code: 0 as planned, 3 ended safely early, 1 error.

    `tlog` is the flight log to write, if any. The caller opens and closes the session. On the main thread the first
    Ctrl-C lands; the second ends the process and leaves the vehicle to the autopilot's failsafe.
    """
    ground = Ground(session, vehicle)
    with contextlib.ExitStack() as served, _interrupted_by(lambda: ground.commands.put("land")):
        try:
            link = Link(config.autopilot, config.system_id, tlog, signing=_signing(config))
            with contextlib.closing(link):
                code = _fly(config, ground, link, served)
        except (LinkError, ValueError) as error:
            ground.tell("error", str(error))
            code = ERROR
        ground.tell("ended", f"exit {code}", code)
        return code


def _fly(config: BridgeConfig, ground: Ground, link: Link, served: contextlib.ExitStack) -> int:
    """Alive on the bus only once a flight is there to take commands."""
    clock = _clock(config)
    ground.now = lambda: clock.now
    with contextlib.ExitStack() as owned:

        def make_vehicle(wait: Callable[[], None]) -> MavlinkVehicle:
            return owned.enter_context(contextlib.closing(_vehicle(config, link, clock, wait)))

        flight = Flight(config, ground, clock, make_vehicle)
        served.enter_context(ground.served())
        code = flight.run()
        with contextlib.suppress(LinkError):  # a SITL that is gone needs no farewell
            clock.close(over=flight.down)
    return code


def _vehicle(config: BridgeConfig, link: Link, clock: Clock, wait: Callable[[], None]) -> MavlinkVehicle:
    """By the back end that was chosen; only that one is imported."""
    if config.backend == "mavsdk":
        from autopilot_bridge.mavsdk_vehicle import MavsdkVehicle

        return MavsdkVehicle(link, dialects(config.dialect), config.system_id, clock, wait)
    from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle

    return PymavlinkVehicle(link, dialects(config.dialect), config.system_id, clock, wait)


def _signing(config: BridgeConfig) -> Signing | None:
    """Raises ValueError when the key cannot be read."""
    if config.signing_key is None:
        return None
    return Signing(read_key(config.signing_key), wall_clock=not isinstance(config.clock, LockstepClock))


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
