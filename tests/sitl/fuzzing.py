"""Scripts of hostile input: what a fuzzer or hypothesis makes up, played to a vehicle without sockets.

A script is a list of steps: a datagram of any bytes, a well-formed frame of any message with any payload, or some
vehicle time. `Wire` is the port it comes in on; `prepared` gives a vehicle that boots or hovers already.
"""

import copy
import math
from collections import Counter, deque
from dataclasses import dataclass
from functools import cache
from typing import Literal

from pymavlink.dialects.v20 import development as mavlink

from sitl.autopilot import SERVICES, Autopilot
from sitl.links.frames import Frame, Payload, frame, layout, split_datagram
from sitl.links.link import Link
from sitl.links.network import Network
from sitl.links.signing import Signing
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import personality

HANDLED = sorted(SERVICES)


@dataclass(frozen=True)
class Datagram:
    """Bytes as they are."""

    data: bytes


@dataclass(frozen=True)
class Said:
    """A frame with a good checksum, of a message that some service handles."""

    name: str
    payload: bytes
    """Cut or filled up with zeros to any length a frame may have."""
    ours: bool
    """Whether its target fields are overwritten with the vehicle's."""


@dataclass(frozen=True)
class Wait:
    """Vehicle time that passes."""

    ms: int


Step = Datagram | Said | Wait


class Wire:
    """A port whose datagrams are put in by hand, and whose frames are kept."""

    name = "wire"

    def __init__(self, rates_hz: dict[str, float], signing: Signing) -> None:
        self.waiting: deque[bytes] = deque()
        self.sent: list[bytes] = []
        self.counters: Counter[str] = Counter()
        self.links = [Link("wire", rates_hz, 1, signing, self._put)]
        self.links[0].heard = True

    def _put(self, raw: bytes) -> bool:
        self.sent.append(raw)
        return True

    def receive(self, now_ms: int) -> list[tuple[Link, Frame]]:
        received = []
        while self.waiting:
            good = split_datagram(self.waiting.popleft(), self.links[0].counters)
            received.extend((self.links[0], one) for one in good)
        return received

    def lost(self) -> dict[Link | None, int]:
        return {}

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


class Prey:
    """A vehicle and the wire it hangs on."""

    def __init__(self, name: Literal["px4", "arducopter"]) -> None:
        played = personality(name)
        signing = Signing()
        self.wire = Wire(dict(played.companion_rates_hz), signing)
        network = Network((self.wire,), 1, signing)
        self.autopilot = Autopilot(played, Parameters(played.table), Origin(), network, 0, 0)

    def say(self, message: object) -> None:
        """A message of pymavlink's."""
        self.wire.waiting.append(message.pack(mavlink.MAVLink(None, srcSystem=255, srcComponent=190)))  # type: ignore[attr-defined] # untyped

    def wait(self, ms: int) -> None:
        self.autopilot.receive()
        self.autopilot.advance(ms)

    def play(self, script: list[Step]) -> None:
        """Everything of the script; raises whatever the vehicle cannot bear."""
        for step in script:
            if isinstance(step, Wait):
                self.wait(step.ms)
            elif isinstance(step, Datagram):
                self.wire.waiting.append(step.data)
            else:
                self.wire.waiting.append(encoded(step))
        self.wait(100)

    def check(self) -> None:
        """The vehicle is sound: no defects, a finite state, and it still answers."""
        assert not self.autopilot.defects
        body = self.autopilot.vehicle.body
        assert all(map(math.isfinite, (*body.position, *body.velocity, *body.attitude, *body.rates)))
        self.wire.links[0].signing.set_up(bytes(32), 0)  # the script may have set a key
        self.wire.sent.clear()
        self.say(mavlink.MAVLink_ping_message(7, 7, 0, 0))
        self.wait(50)
        told = [mavlink.MAVLink(None).decode(bytearray(raw)) for raw in self.wire.sent]
        assert any(m.get_type() == "PING" and m.time_usec == 7 for m in told)


def encoded(said: Said) -> bytes:
    """The frame of a made-up message."""
    form = layout(said.name)
    data = bytearray(said.payload[:255])
    if said.ours:
        last = max(form.target_system, form.target_component)
        data.extend(bytes(max(last + 1 - len(data), 0)))
        for place in (form.target_system, form.target_component):
            if place >= 0:
                data[place] = 1
    return frame(Payload(form.message_id, form.crc_extra, bytes(data)), 0, 255, 190)


@cache
def _ready(name: Literal["px4", "arducopter"], flying: bool) -> Prey:
    prey = Prey(name)
    copter = name == "arducopter"
    prey.wait(60_000 if copter else 6_000)
    if flying:
        if copter:
            prey.say(mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0))
        prey.say(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        altitude = 10.0 if copter else math.nan
        prey.say(mavlink.MAVLink_command_long_message(1, 1, 22, 0, 0, 0, 0, math.nan, math.nan, math.nan, altitude))
        prey.wait(12_000)
        assert prey.autopilot.vehicle.commander.flying
    return prey


def prepared(name: Literal["px4", "arducopter"], flying: bool) -> Prey:
    """A vehicle of one's own, on the ground and ready to arm or in the air."""
    return copy.deepcopy(_ready(name, flying))
