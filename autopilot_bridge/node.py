"""The bridge node: one vehicle's flight between the bus and the autopilot."""

import contextlib
import gc
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import zenoh

from autopilot_bridge.clock import Clock, Lockstep, Paced
from autopilot_bridge.config import BridgeConfig, LockstepClock, PacedClock
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.endings import ERROR, in_our_code
from autopilot_bridge.flight import Flight
from autopilot_bridge.ground import Ground
from autopilot_bridge.link import Link, LinkError
from autopilot_bridge.mavlink_vehicle import MavlinkVehicle
from autopilot_bridge.neighbours import Neighbours
from autopilot_bridge.signing import Signing, read_key
from bus.messages import CommandName


def run(
    config: BridgeConfig, vehicle: str, session: zenoh.Session, tlog: Path | None, others: Sequence[str] = ()
) -> int:
    """Fly `config` under the bus name `vehicle`; the exit code: 0 as planned, 3 ended safely early, 1 error.

    `tlog` is the flight log to write, if any; `others` are the bus names of vehicles to keep apart from. The caller
    opens and closes the session. On the main thread the first Ctrl-C lands; the second ends the process and leaves the
    vehicle to the autopilot's failsafe.
    """
    ground = Ground(session, vehicle)
    served = contextlib.ExitStack()
    with contextlib.closing(ground.bell), served, _interrupted_by(lambda: ground.commands.put("land")):
        try:
            if vehicle in others:
                raise ValueError(f"others: {vehicle!r} is this vehicle itself, which nobody can keep apart from")
            link = Link(config.autopilot, config.system_id, tlog, signing=_signing(config), bell=ground.bell)
            with contextlib.closing(link):
                code = _fly(config, ground, link, served, session, others if config.separation_m > 0 else ())
        except (LinkError, ValueError) as error:
            ground.tell("error", str(error))
            code = ERROR
        except Exception as error:  # noqa: BLE001  whoever waits for the last word must get it
            ground.tell("error", in_our_code(error))
            code = ERROR
        ground.tell("ended", f"exit {code}", code)
        return code


def _fly(
    config: BridgeConfig,
    ground: Ground,
    link: Link,
    served: contextlib.ExitStack,
    session: zenoh.Session,
    others: Sequence[str],
) -> int:
    """Alive on the bus only once a flight is there to take commands."""
    clock = _clock(config)
    ground.now = lambda: clock.now
    made: list[MavlinkVehicle] = []
    with contextlib.ExitStack() as owned:

        def make_vehicle(wait: Callable[[], None]) -> MavlinkVehicle:
            made.append(owned.enter_context(contextlib.closing(_vehicle(config, link, clock, wait))))
            return made[0]

        neighbours = Neighbours(
            session,
            others,
            config.limits,
            config.clock.speed if isinstance(config.clock, PacedClock) else 1.0,
            home=lambda: made[0].telemetry.home_lat_lon_alt if made else None,
            tell=ground.tell,
            all_known=(lambda: ground.commands.put("start")) if config.autostart else lambda: None,
        )
        owned.enter_context(contextlib.closing(neighbours))
        if others:  # who starts by itself waits for them
            config = config.model_copy(update={"autostart": False})
        flight = Flight(config, ground, clock, make_vehicle, neighbours.tracks)
        ground.objection = _unless_known(neighbours, ground.objection)
        served.enter_context(ground.served())
        gc.collect()
        gc.freeze()  # or going through all that is loaded takes 0.1 s in the middle of some slot
        code = flight.run()
        with contextlib.suppress(LinkError):  # a SITL that is gone needs no farewell
            clock.close(over=flight.down)
    return code


def _unless_known(neighbours: Neighbours, objection: Callable[[CommandName], str]) -> Callable[[CommandName], str]:
    """`objection`, and no start before it is known where the others are."""

    def object_to(name: CommandName) -> str:
        if name == "start" and neighbours.unknown:
            return f"the home of {', '.join(neighbours.unknown)} is not known yet, so nobody could keep apart from it"
        return objection(name)

    return object_to


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
