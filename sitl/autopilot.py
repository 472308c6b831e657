"""The autopilot as a whole: what comes in on the links is obeyed, the vehicle moves, telemetry goes out."""

from collections.abc import Callable, Sequence

import numpy as np

from sitl.flight_model import FlightModel
from sitl.frames import Message, Payload
from sitl.link import Link
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import Personality
from sitl.services import clock, commands, missions, parameters, setpoints
from sitl.telemetry import statustexts
from sitl.vehicle import Vehicle

TICK_MS = 10
"""Vehicle time between two looks at the links and streams [ms]."""

SERVICES: dict[str, Callable[[Vehicle, Link, Message], None]] = {
    "COMMAND_LONG": commands.command_long,
    "COMMAND_INT": commands.command_int,
    "SET_MODE": commands.set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": setpoints.set_position_target_local_ned,
    "PARAM_REQUEST_READ": parameters.param_request_read,
    "PARAM_REQUEST_LIST": parameters.param_request_list,
    "PARAM_SET": parameters.param_set,
    "TIMESYNC": clock.timesync,
    "PING": clock.ping,
    "MISSION_REQUEST_LIST": missions.mission_request_list,
    "MISSION_COUNT": missions.mission_count,
    "MISSION_CLEAR_ALL": missions.mission_clear_all,
    "MISSION_REQUEST": missions.mission_request,
    "MISSION_REQUEST_INT": missions.mission_request,
}
"""Who answers which message; what is not here is taken note of by nobody."""


class Autopilot:
    """One vehicle on its links. Deterministic: its clock moves only in `advance`."""

    def __init__(
        self, personality: Personality, p: Parameters, origin: Origin, links: Sequence[Link], seed: int, epoch_us: int
    ) -> None:
        model = FlightModel(personality.gains(p), personality.craft(p))
        self.vehicle = Vehicle(
            personality=personality,
            model=model,
            commander=personality.commander(p, model, origin, self._say),
            parameters=p,
            origin=origin,
            noise=np.random.default_rng(seed),
            epoch_us=epoch_us,
        )
        self._links = links
        self._system = int(p[personality.system_id])
        self._parameter_changes = p.changes
        self._texts = 0

    @property
    def now_ms(self) -> int:
        return self.vehicle.now_ms

    def receive(self) -> None:
        """Obey everything that waits on the links, and forward what is not for this vehicle alone."""
        for link in self._links:
            for message, raw in link.receive(self.now_ms):
                self._receive(link, message, raw)

    def _receive(self, link: Link, message: Message, raw: bytes) -> None:
        target = getattr(message, "target_system", 0)
        if target != self._system:
            for other in self._links:
                if other is not link and other.heard:
                    other.forward(raw)
        ours = self.vehicle.personality.answers.any_component or getattr(message, "target_component", 0) in (0, 1)
        if target not in (0, self._system) or not ours:
            link.counters["not for us"] += 1
            return
        service = SERVICES.get(message.get_type())
        if service is not None:
            service(self.vehicle, link, message)

    def advance(self, duration_ms: int, receive_each_tick: bool = False) -> None:
        """Move on by duration_ms of vehicle time, in ticks of at most 10 ms, sending the telemetry due."""
        while duration_ms > 0:
            tick = min(TICK_MS, duration_ms)
            duration_ms -= tick
            if receive_each_tick:
                self.receive()
            self._tick(tick)

    def _tick(self, tick_ms: int) -> None:
        v = self.vehicle
        if v.parameters.changes != self._parameter_changes:
            self._parameter_changes = v.parameters.changes
            v.model.gains = v.personality.gains(v.parameters)
            v.model.craft = v.personality.craft(v.parameters)
            v.commander.battery.pack = v.personality.pack(v.parameters)
        setpoint = v.commander.step(tick_ms / 1000.0)
        v.model.advance(setpoint, v.commander.flying, tick_ms)
        v.commander.now_ms += tick_ms
        self._send_due()

    def _send_due(self) -> None:
        v = self.vehicle
        now = v.now_ms
        built: dict[str, Payload | None] = {}
        for link in self._links:
            parameters.continue_list(v, link)
            if now < v.personality.timeline.telemetry_ms:
                continue
            for name, stream in link.streams.items():
                if (link.streaming or name == "HEARTBEAT") and stream.take_due(now):
                    if name not in built:
                        built[name] = v.personality.messages[name](v)
                    payload = built[name]
                    if payload is not None:
                        link.send(payload)

    def _say(self, text: str, severity: int) -> None:
        self._texts = self._texts % 65535 + 1
        for payload in statustexts(text, severity, self._texts):
            for link in self._links:
                link.send(payload)
