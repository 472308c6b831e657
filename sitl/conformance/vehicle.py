"""The vehicle as a client sees it: its clock, its messages, its answers.

All limits are on the vehicle's own clock (`time_boot_ms`), so that simulators of any speed are judged alike. The wall
clock tells only whether anything comes at all.
"""

import math
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance.autopilots import Autopilot
from sitl.conformance.outcome import Failed, Silent
from sitl.conformance.wire import MAVLINK_2, Wire

Message: TypeAlias = Any
"""An instance of one of pymavlink's generated classes, which carry no types."""
Vec3 = tuple[float, float, float]

OWN_SYSTEM, OWN_COMPONENT = 247, 190
"""A ground station, but not the usual 255: somebody may watch."""
AUTOPILOT_COMPONENT = 1
STREAM_MS = 50
"""Between two setpoints, on the vehicle's clock."""
HEARTBEAT_MS = 1000
SILENCE_S = 5.0
"""Of the wall clock without any frame: the vehicle is gone."""
STANDSTILL_S = 20.0
"""Of the wall clock without the vehicle's clock moving."""
ANSWER_S = 1.5
"""Vehicle time for an answer; a client asks again after that (Command Protocol)."""
ANSWER_WALL_S = 0.3
"""And at least so long on the wall clock, should the vehicle be much faster than real time."""
ATTEMPTS = 3
ASK_AGAIN_S = 0.5
"""Of the wall clock, for telemetry while there is none."""
ON_GROUND, IN_AIR = 1, 2
"""MAV_LANDED_STATE."""
ARMED_BIT = 0x80
"""MAV_MODE_FLAG_SAFETY_ARMED."""
PREARM_BIT = 0x10000000
"""MAV_SYS_STATUS_PREARM_CHECK."""
PROTOCOL_VERSION = 300
"""The message's id; pymavlink's dialects have lost it."""

WATCHED_HZ = {
    "LOCAL_POSITION_NED": 20.0,
    "ATTITUDE": 20.0,
    "GLOBAL_POSITION_INT": 10.0,
    "EXTENDED_SYS_STATE": 5.0,
    "SYS_STATUS": 2.0,
}
"""What the checks look at, and how often they ask for it."""
HEARD = frozenset(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in (
        *WATCHED_HZ,
        "HEARTBEAT",
        "SYSTEM_TIME",
        "PING",
        "PARAM_VALUE",
        "TIMESYNC",
        "COMMAND_ACK",
        "HOME_POSITION",
        "AUTOPILOT_VERSION",
        "STATUSTEXT",
        "MESSAGE_INTERVAL",
        "MISSION_ACK",
        "MISSION_COUNT",
        "MISSION_REQUEST",
        "MISSION_REQUEST_INT",
        "MISSION_ITEM_INT",
        "MISSION_ITEM",
        "MISSION_CURRENT",
        "MISSION_ITEM_REACHED",
    )
)
"""Messages that are decoded; of all others only the id is read."""


@dataclass(frozen=True)
class Sample:
    """One LOCAL_POSITION_NED."""

    time_s: float
    position: Vec3
    velocity: Vec3

    @property
    def speed(self) -> float:
        """Horizontal [m/s]."""
        return math.hypot(self.velocity[0], self.velocity[1])


class Vehicle:
    """One autopilot behind a wire. Everything in here happens in the caller's thread, in `step`."""

    def __init__(
        self, wire: Wire, autopilot: Autopilot | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """`clock` is the wall clock [s]."""
        self.wire = wire
        self._autopilot = autopilot
        self._clock = clock
        self.mav = mavlink.MAVLink(None, srcSystem=OWN_SYSTEM, srcComponent=OWN_COMPONENT)
        self.system = 0
        """The vehicle's id; 0 until its first HEARTBEAT."""
        self.latest: dict[str, Message] = {}
        self.counts: Counter[int] = Counter()
        """Frames heard, by message id."""
        self.old_frames = 0
        """MAVLink 1 frames heard."""
        self.texts: list[str] = []
        """STATUSTEXTs, as they came."""
        self.protocol_version: bytes = b""
        """Payload of the last PROTOCOL_VERSION."""
        self.time_ms = 0
        """The vehicle's clock; 0 until it is known."""
        self.backwards: list[str] = []
        """Where its clock went back."""
        self.changed: dict[str, float] = {}
        """Parameters that were set, with their first values."""
        self.plans: dict[int, list[Any]] = {}
        """Plans that were overwritten, by MAV_MISSION_TYPE, as they were."""
        self.start: Vec3 = (0.0, 0.0, 0.0)
        """Where it stood before it took off, NED."""
        self._times: dict[str, int] = {}
        self._listeners: list[Callable[[Message], None]] = []
        self._heard_s = self._moved_s = clock()
        self._beat_ms, self._beat_s = -HEARTBEAT_MS, -math.inf
        self._streamed_ms = -STREAM_MS

    @property
    def autopilot(self) -> Autopilot:
        """What is known of this kind. Raises Failed before the first HEARTBEAT, and for kinds that are not known."""
        if self._autopilot is None:
            raise Failed("it is not known which autopilot this is; --personality says which one to expect")
        return self._autopilot

    def is_a(self, autopilot: Autopilot) -> None:
        """From now on this is known."""
        self._autopilot = autopilot

    @property
    def known(self) -> bool:
        """Whether it is known which autopilot this is."""
        return self._autopilot is not None

    # In and out

    def send(self, message: Message) -> None:
        frame = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        self.wire.send(frame)

    def step(self, stream: Callable[[], None] | None = None) -> None:
        """Take in what comes within a moment; send what is due: our HEARTBEAT, and `stream` every 50 ms.

        Raises Silent when nothing has come for long, or the vehicle's clock stands still.
        """
        before = self.time_ms
        frames = self.wire.receive(0.02)
        now = self._clock()
        if frames:
            self._heard_s = now
        for frame in frames:
            self._take(frame)
        if self.time_ms != before:
            self._moved_s = now
        if now - self._heard_s > SILENCE_S:
            raise Silent(f"nothing heard for {SILENCE_S:g} s")
        if now - self._moved_s > STANDSTILL_S:
            raise Silent(f"the clock (time_boot_ms) stands still at {self.time_ms} ms")
        if self.time_ms - self._beat_ms >= HEARTBEAT_MS or now - self._beat_s >= HEARTBEAT_MS / 1000.0:
            self._beat_ms, self._beat_s = self.time_ms, now
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if stream is not None and self.time_ms - self._streamed_ms >= STREAM_MS:
            self._streamed_ms = self.time_ms
            stream()

    def _take(self, frame: bytes) -> None:
        new = frame[0] == MAVLINK_2
        system, component = (frame[5], frame[6]) if new else (frame[3], frame[4])
        number = int.from_bytes(frame[7:10], "little") if new else frame[5]
        if self.system and (system != self.system or component != AUTOPILOT_COMPONENT):
            return
        if not self.system and (number != mavlink.MAVLINK_MSG_ID_HEARTBEAT or component != AUTOPILOT_COMPONENT):
            return
        if number not in HEARD:
            self.counts[number] += 1
            if number == PROTOCOL_VERSION and new:
                self.protocol_version = frame[10 : 10 + frame[1]].ljust(6, b"\0")
            return
        try:
            message = self.mav.decode(bytearray(frame))
        except (mavlink.MAVError, struct.error):
            return
        if not self.system:
            if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
                return
            self.system = system
        self.counts[number] += 1
        self.old_frames += not new
        name = message.get_type()
        self.latest[name] = message
        if name == "STATUSTEXT":
            text = message.text.rstrip("\t\0")
            if message.chunk_seq and self.texts:
                self.texts[-1] += text
            else:
                self.texts.append(text)
        at_ms = getattr(message, "time_boot_ms", None)
        if at_ms is not None:
            if at_ms < self._times.get(name, 0):
                self.backwards.append(f"{name} from {self._times[name]} to {at_ms} ms")
            self._times[name] = at_ms
            self.time_ms = max(self.time_ms, at_ms)
        for listener in tuple(self._listeners):
            listener(message)

    @contextmanager
    def hear(self, *names: str) -> Iterator[list[Message]]:
        """The messages of these names that come while the block runs."""
        heard: list[Message] = []

        def listen(message: Message) -> None:
            if message.get_type() in names:
                heard.append(message)

        self._listeners.append(listen)
        try:
            yield heard
        finally:
            self._listeners.remove(listen)

    @contextmanager
    def track(self) -> Iterator[list[Sample]]:
        """Where the vehicle is while the block runs."""
        samples: list[Sample] = []

        def listen(message: Message) -> None:
            if message.get_type() == "LOCAL_POSITION_NED":
                samples.append(sample_of(message))

        self._listeners.append(listen)
        try:
            yield samples
        finally:
            self._listeners.remove(listen)

    # Waiting

    def meet(self, patience_s: float = 10.0) -> None:
        """Wait for the vehicle's HEARTBEAT, then ask for what is looked at until its clock is known.

        Raises Silent when no autopilot's HEARTBEAT comes within `patience_s` of the wall clock.
        """
        end = self._clock() + patience_s
        while not self.system:
            if self._clock() > end:
                raise Silent(f"no HEARTBEAT of an autopilot within {patience_s:g} s")
            self._heard_s = self._moved_s = self._clock()
            self.step()
        asked = -math.inf
        while self.time_ms == 0:
            if self._clock() - asked > ASK_AGAIN_S:
                asked = self._clock()
                for name, rate in WATCHED_HZ.items():
                    number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
                    self.send(self._long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (number, 1e6 / rate), self.system))
            self.step()

    def until(
        self, condition: Callable[[], object], limit_s: float, what: str, stream: Callable[[], None] | None = None
    ) -> float:
        """Go on, calling `stream` every 50 ms, until the condition holds; the vehicle time it took [s].

        Raises Failed when that takes longer than `limit_s`.
        """
        start = self.time_ms
        while not condition():
            if self.time_ms - start > limit_s * 1000.0:
                raise Failed(f"{what}: not within {limit_s:g} s")
            self.step(stream)
        return (self.time_ms - start) / 1000.0

    def go_on(self, seconds: float, stream: Callable[[], None] | None = None) -> None:
        """Let vehicle time pass."""
        end = self.time_ms + seconds * 1000.0
        while self.time_ms < end:
            self.step(stream)

    def answered(
        self, condition: Callable[[], object], limit_s: float = ANSWER_S, stream: Callable[[], None] | None = None
    ) -> bool:
        """Whether the condition came to hold within the time that an answer may take."""
        end_ms, end_s = self.time_ms + limit_s * 1000.0, self._clock() + ANSWER_WALL_S
        while not condition():
            if self.time_ms > end_ms and self._clock() > end_s:
                return False
            self.step(stream)
        return True

    # Commands

    def _long(
        self,
        number: int,
        p: tuple[float, ...],
        system: int,
        component: int = AUTOPILOT_COMPONENT,
        confirmation: int = 0,
    ) -> Message:
        values = (*p, *[0.0] * (7 - len(p)))
        return mavlink.MAVLink_command_long_message(system, component, number, confirmation, *values)

    def command(
        self,
        number: int,
        *parameters: float,
        system: int | None = None,
        component: int = AUTOPILOT_COMPONENT,
        attempts: int = ATTEMPTS,
        stream: Callable[[], None] | None = None,
    ) -> int | None:
        """COMMAND_LONG, again if it is not answered; the result of its COMMAND_ACK (MAV_RESULT), None without one."""
        target = self.system if system is None else system
        with self.hear("COMMAND_ACK") as acks:
            for attempt in range(attempts):
                self.send(self._long(number, parameters, target, component, attempt))
                result = self._result(number, acks, stream)
                if result is not None:
                    return result
        return None

    def command_int(self, number: int, frame: int, p: tuple[float, float, float, float], x: int, y: int, z: float
                    ) -> int | None:  # fmt: skip
        """COMMAND_INT, the same way."""
        with self.hear("COMMAND_ACK") as acks:
            for _ in range(ATTEMPTS):
                self.send(
                    mavlink.MAVLink_command_int_message(
                        self.system, AUTOPILOT_COMPONENT, frame, number, 0, 0, *p, x, y, z
                    )
                )
                result = self._result(number, acks, None)
                if result is not None:
                    return result
        return None

    def _result(self, number: int, acks: list[Message], stream: Callable[[], None] | None) -> int | None:
        def final() -> list[int]:
            return [
                ack.result
                for ack in acks
                if ack.command == number
                and ack.result != mavlink.MAV_RESULT_IN_PROGRESS
                and ack.target_system in (0, OWN_SYSTEM)
                and ack.target_component in (0, OWN_COMPONENT)
            ]

        return final()[0] if self.answered(final, stream=stream) else None

    def request(self, name: str) -> Message | None:
        """A message by MAV_CMD_REQUEST_MESSAGE, or as it streams anyway; None when it does not come."""
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        with self.hear(name) as heard:
            for _ in range(ATTEMPTS):
                self.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number, attempts=1)
                if self.answered(lambda: heard):
                    return heard[-1]
        return None

    def set_interval(self, name: str, rate_hz: float) -> int | None:
        """MAV_CMD_SET_MESSAGE_INTERVAL; 0 Hz: back to what it was at first."""
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        return self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz if rate_hz else 0.0)

    def set_mode(self, mode: int, stream: Callable[[], None] | None = None) -> int | None:
        """MAV_CMD_DO_SET_MODE."""
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, *self.autopilot.set_mode(mode), stream=stream)

    # What it says of itself

    @property
    def armed(self) -> bool:
        return bool(self.latest["HEARTBEAT"].base_mode & ARMED_BIT)

    @property
    def mode(self) -> int:
        return int(self.latest["HEARTBEAT"].custom_mode)

    @property
    def landed(self) -> int:
        """MAV_LANDED_STATE; 0 while it is not told."""
        told = self.latest.get("EXTENDED_SYS_STATE")
        return 0 if told is None else int(told.landed_state)

    @property
    def ready(self) -> bool:
        """Whether it says that it may arm."""
        status = self.latest.get("SYS_STATUS")
        return status is not None and bool(status.onboard_control_sensors_health & PREARM_BIT)

    @property
    def now(self) -> Sample:
        """Raises Failed while there is no position."""
        told = self.latest.get("LOCAL_POSITION_NED")
        if told is None:
            raise Failed("no LOCAL_POSITION_NED")
        return sample_of(told)

    @property
    def height(self) -> float:
        """Above where it took off [m]."""
        return self.start[2] - self.now.position[2]

    @property
    def yaw(self) -> float:
        return float(self.latest["ATTITUDE"].yaw)


def sample_of(message: Message) -> Sample:
    position, velocity = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
    return Sample(message.time_boot_ms / 1000.0, position, velocity)


def tilt_of(message: Message) -> float:
    """Angle of the thrust from the vertical [rad], of an ATTITUDE."""
    return math.acos(min(max(math.cos(message.roll) * math.cos(message.pitch), -1.0), 1.0))
