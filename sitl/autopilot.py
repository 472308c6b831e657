"""The autopilot as a whole: what comes in on the links is obeyed, the vehicle moves, telemetry goes out."""

import sys
import traceback
from collections import Counter
from collections.abc import Callable

import numpy as np

from sitl.flight.flight_model import FlightModel
from sitl.links.frames import Frame, Message, Payload, decode
from sitl.links.link import Link
from sitl.links.network import Network
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import Personality
from sitl.services import (
    clock,
    commands,
    files,
    globe,
    heartbeats,
    logs,
    missions,
    parameters,
    setpoints,
    signing,
    sticks,
    streams,
)
from sitl.telemetry import TEXT_CHUNK, statustexts
from sitl.vehicle import Vehicle

TICK_MS = 10
"""Vehicle time between two looks at the links and streams [ms]."""

SERVICES: dict[str, Callable[[Vehicle, Link, Message], None]] = {
    "COMMAND_LONG": commands.command_long,
    "COMMAND_INT": commands.command_int,
    "SET_MODE": commands.set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": setpoints.set_position_target_local_ned,
    "SET_POSITION_TARGET_GLOBAL_INT": setpoints.set_position_target_global_int,
    "SET_ATTITUDE_TARGET": setpoints.set_attitude_target,
    "SET_GPS_GLOBAL_ORIGIN": globe.set_gps_global_origin,
    "MANUAL_CONTROL": sticks.manual_control,
    "RC_CHANNELS_OVERRIDE": sticks.rc_channels_override,
    "REQUEST_DATA_STREAM": streams.request_data_stream,
    "PARAM_REQUEST_READ": parameters.param_request_read,
    "PARAM_REQUEST_LIST": parameters.param_request_list,
    "PARAM_SET": parameters.param_set,
    "TIMESYNC": clock.timesync,
    "PING": clock.ping,
    "MISSION_REQUEST_LIST": missions.mission_request_list,
    "MISSION_COUNT": missions.mission_count,
    "MISSION_CLEAR_ALL": missions.mission_clear_all,
    "MISSION_ITEM": missions.mission_item,
    "MISSION_ITEM_INT": missions.mission_item_int,
    "MISSION_REQUEST": missions.mission_request,
    "MISSION_REQUEST_INT": missions.mission_request_int,
    "MISSION_ACK": missions.mission_ack,
    "MISSION_REQUEST_PARTIAL_LIST": missions.mission_request_partial_list,
    "MISSION_WRITE_PARTIAL_LIST": missions.mission_request_partial_list,
    "MISSION_SET_CURRENT": missions.mission_set_current,
    "FILE_TRANSFER_PROTOCOL": files.file_transfer_protocol,
    "LOG_REQUEST_LIST": logs.log_request_list,
    "LOG_REQUEST_DATA": logs.log_request_data,
    "SETUP_SIGNING": signing.setup_signing,
    "HEARTBEAT": heartbeats.heartbeat,
}
"""Who answers which message; what is not here is taken note of by nobody."""


class Autopilot:
    """One vehicle on its links. Deterministic: its clock moves only in `advance`."""

    def __init__(
        self, personality: Personality, p: Parameters, origin: Origin, network: Network, seed: int, epoch_us: int
    ) -> None:
        model = FlightModel(personality.gains(p), personality.craft(p), personality.world(p), seed)
        self.vehicle = Vehicle(
            personality=personality,
            model=model,
            commander=personality.commander(p, model, origin, self._say),
            parameters=p,
            origin=origin,
            noise=np.random.default_rng(seed),
            epoch_us=epoch_us,
        )
        self.network = network
        self._parameter_changes = p.changes
        self._texts = 0
        self.defects: Counter[str] = Counter()
        """Messages that a service or telemetry could not bear, told once per kind; there should be none."""

    @property
    def now_ms(self) -> int:
        return self.vehicle.now_ms

    def receive(self) -> None:
        """Obey everything that waits on the links for this vehicle; the rest is forwarded or dropped."""
        v = self.vehicle
        unix_us = v.epoch_us + v.now_ms * 1000
        for link, received in self.network.receive(v.now_ms, unix_us, v.personality.answers.any_component):
            service = SERVICES.get(received.name)
            if service is not None:
                self._serve(service, link, received)

    def _serve(self, service: Callable[[Vehicle, Link, Message], None], link: Link, received: Frame) -> None:
        """A message that a service cannot bear is a defect; the vehicle flies on."""
        try:
            service(self.vehicle, link, decode(received))
        except Exception:  # noqa: BLE001 - whatever it is, it must not end the flight
            self._tell_defect(received.name, received.raw)

    def _build(self, name: str) -> Payload | None:
        try:
            return self.vehicle.personality.messages[name](self.vehicle)
        except Exception:  # noqa: BLE001 - as above
            self._tell_defect(name, b"")
            return None

    def _tell_defect(self, name: str, raw: bytes) -> None:
        self.defects[name] += 1
        if self.defects[name] == 1:
            print(f"defect: {name} {raw.hex()}: {traceback.format_exc()}", file=sys.stderr)

    def advance(self, duration_ms: int) -> None:
        """Move on by duration_ms of vehicle time, in ticks of at most 10 ms, sending the telemetry due."""
        while duration_ms > 0:
            tick = min(TICK_MS, duration_ms)
            duration_ms -= tick
            self._tick(tick)

    def _tick(self, tick_ms: int) -> None:
        v = self.vehicle
        if v.parameters.changes != self._parameter_changes:
            self._parameter_changes = v.parameters.changes
            v.model.gains = v.personality.gains(v.parameters)
            v.model.craft = v.personality.craft(v.parameters)
            v.model.world = v.personality.world(v.parameters)
            v.commander.battery.pack = v.personality.pack(v.parameters)
        dt = tick_ms / 1000.0
        v.model.sense(v.now_ms)
        setpoint = v.commander.step(dt)
        v.commander.battery.drain(v.model.power_w if v.commander.flying else 0.0, dt)
        v.model.advance(setpoint, v.commander.flying, tick_ms)
        v.commander.now_ms += tick_ms
        self._send_due()

    def _send_due(self) -> None:
        v = self.vehicle
        now = v.now_ms
        talks = now >= v.personality.timeline.telemetry_ms
        built: dict[str, Payload | None] = {}
        missions.tell_progress(v, self.network.links)
        for name in v.commander.news:
            news = self._build(name)
            if news is not None:
                for link in self.network.links:
                    if link.streaming:
                        link.send(news)
        v.commander.news.clear()
        for link in self.network.links:
            parameters.continue_list(v, link)
            if not talks:
                continue
            for name in link.due(now):
                if name not in built:
                    built[name] = self._build(name)
                payload = built[name]
                if payload is not None:
                    link.send(payload)
        self.network.flush()

    def _say(self, text: str, severity: int) -> None:
        number = 0
        if len(text) >= TEXT_CHUNK or self.vehicle.personality.answers.numbers_short_texts:
            number = self._texts = self._texts % 65535 + 1
        for payload in statustexts(text, severity, number):
            for link in self.network.links:
                if link.streaming:
                    link.send(payload)
