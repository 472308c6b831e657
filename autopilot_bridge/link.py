"""The bridge's sockets: the MAVLink link with its flight log, and the SITL's control line.

Every MAVLink byte of the bridge goes through here, whichever library has written it. That is why the log is complete,
why frames of other systems are sorted out and signatures checked in one place, and where tests inject faults.
"""

import socket
import struct
import time
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.bell import Bell
from autopilot_bridge.config import endpoint
from autopilot_bridge.flight_log import FlightLog
from autopilot_bridge.roll_call import RollCall
from autopilot_bridge.signing import Signing, is_signed
from autopilot_bridge.url import parse_url
from autopilot_bridge.wire import Sender, WireError, frames, header, open_wire

OWN_SYSTEM = 245
"""Ours; 1 is the vehicle's, 255 the ground station's."""

Tamper = Callable[[bytes], Iterable[bytes]]
"""What becomes of a datagram on its way (of a frame, on a stream): nothing, itself, several, another one."""


class LinkError(RuntimeError):
    """The link cannot be opened or has ended; the text names it."""


def untouched(datagram: bytes) -> Iterable[bytes]:
    """No fault."""
    return (datagram,)


class Link:
    """MAVLink 2 over one wire (UDP, TCP, serial), both directions logged.

    What was exchanged is in the flight log before anything is made of it, even when the process is killed. Its time
    stamps are the wall time of the first telemetry plus vehicle time since, so that a flight in lockstep is logged at
    its own pace.

    With `signing` every frame sent by `send` is signed, and only frames signed with the same key are heard; the rest
    is counted as `unsigned`, `bad_signature` or `replayed`.

    Args: `url` as `parse_url` takes it (udpin with port 0: any free one); `system_id` of the vehicle, all else is
    logged and ignored; `tlog` the log to write, if any; `tamper_in`, `tamper_out` faults to inject, for tests;
    `bell` ends a `receive` that waits.
    """

    def __init__(
        self,
        url: str,
        system_id: int,
        tlog: Path | None = None,
        tamper_in: Tamper = untouched,
        tamper_out: Tamper = untouched,
        signing: Signing | None = None,
        bell: Bell | None = None,
    ) -> None:
        self.url = url
        self.signing = signing
        self.counters: Counter[str] = Counter()
        self.datagrams = 0
        """Datagrams received (frames, on a stream); in lockstep the SITL says how many to expect."""
        self.heard = 0
        """Frames of our vehicle's autopilot."""
        self.wanted: Container[int] | None = None
        """Ids of the messages to decode, since decoding is what costs; None: all."""
        self.listener: Callable[[bytes], object] | None = None
        """Is given every frame of our vehicle's autopilot, whether it is decoded or not."""
        self.roll_call = RollCall(system_id)
        self._tamper_in, self._tamper_out = tamper_in, tamper_out
        self._codec: Any = mavlink.MAVLink(
            None, srcSystem=OWN_SYSTEM, srcComponent=mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        )
        self._decoder: Any = mavlink.MAVLink(None)
        """One of its own: pymavlink's lets a forged frame move a sender's timestamp."""
        if signing is not None:
            signing.sign_what(self._codec)
        self._opened_us = time.time_ns() // 1000
        self._vehicle_time_s: Callable[[], float] = lambda: 0.0
        self._skipped = 0
        try:
            self._wire = open_wire(parse_url(url), bell)
        except WireError as error:
            raise LinkError(f"autopilot {url}: {error}") from error
        try:
            self._log = FlightLog(tlog) if tlog is not None else None
        except OSError as error:
            self._wire.close()
            raise LinkError(f"flight log {tlog}: cannot be written: {error.strerror}") from error

    @property
    def port(self) -> int:
        """Our UDP or TCP port; 0 on a serial line."""
        return self._wire.port

    def stamp_by(self, vehicle_time_s: Callable[[], float]) -> None:
        """Stamp the log by this clock from now on, starting at the wall time of now."""
        start_s = vehicle_time_s()
        self._opened_us = time.time_ns() // 1000
        self._vehicle_time_s = lambda: vehicle_time_s() - start_s

    def send(self, message: Any) -> None:  # noqa: ANN401  pymavlink has no types
        """Send a message to the vehicle; while there is nobody to send to, it is dropped."""
        frame = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256
        self.send_frame(frame)

    def send_frame(self, frame: bytes) -> None:
        """Send a frame that somebody else has packed, as it is."""
        for datagram in self._tamper_out(frame):
            try:
                if not self._wire.send(datagram):
                    self.counters["sent_to_nobody"] += 1
                    return
            except OSError:
                self.counters["send_failed"] += 1
        self.counters["frames_out"] += 1
        self._note(frame)
        self._write()

    def receive(self, timeout_s: float) -> list[Any]:
        """The vehicle's messages that have come; waits up to `timeout_s` for the first or the bell."""
        messages: list[Any] = []
        came = self._wire.receive(timeout_s)
        self.counters["bad_data"] += self._wire.skipped - self._skipped
        self._skipped = self._wire.skipped
        try:
            for datagram, sender in came:
                self.datagrams += 1
                for arrived in self._tamper_in(datagram):
                    messages.extend(self._decode(arrived, sender))
        finally:
            self._write()
        return messages

    def close(self) -> None:
        self._wire.close()
        if self._log is not None:
            self._log.close()

    def _decode(self, datagram: bytes, sender: Sender) -> Iterator[Any]:
        understood = 0
        for frame in frames(datagram):
            understood += len(frame)
            self.counters["frames_in"] += 1
            self._note(frame)
            refusal = self.signing.refusal(frame) if self.signing is not None else ""
            if refusal:
                self.counters[refusal if self.roll_call.is_vehicle(*header(frame)[:2]) else "foreign"] += 1
                continue
            yield from self._hear(frame, sender)
        if understood < len(datagram):
            self.counters["bad_data"] += 1

    def _hear(self, frame: bytes, sender: Sender) -> Iterator[Any]:
        """The message of a frame, if it is our vehicle's and wanted. Of others only HEARTBEATs are decoded."""
        if frame[0] == mavlink.PROTOCOL_MARKER_V2 and frame[2] & ~mavlink.MAVLINK_IFLAG_SIGNED:
            self.counters["bad_data"] += 1  # of a MAVLink that we do not know
            return
        system, component, number = header(frame)
        beat = number == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        ours = self.roll_call.is_vehicle(system, component)
        message = None
        if beat or (ours and (self.wanted is None or number in self.wanted)):
            try:
                message = self._decoder.decode(bytearray(frame))
            except (mavlink.MAVError, struct.error):
                self.counters["bad_data"] += 1
                return
        if beat:
            ours = self.roll_call.hear(message) and ours
        if not ours:
            self.counters["foreign"] += 1
        elif not self.roll_call.is_its_voice(sender, time.monotonic()):
            self.counters["rival"] += 1
        else:
            self.heard += 1
            self.counters["signed"] += is_signed(frame)
            self._wire.answer(sender)
            if self.listener is not None:
                self.listener(frame)
            if message is not None:
                yield message

    def _note(self, frame: bytes) -> None:
        if self._log is not None:
            self._log.add(self._opened_us + round(self._vehicle_time_s() * 1e6), frame)

    def _write(self) -> None:
        """A full disk must not take the vehicle down with it."""
        if self._log is not None:
            self.counters["log_failed"] += self._log.write()


class ControlLine:
    """The SITL's control socket: one request, one answer line (docs/architecture.md).

    Raises LinkError when the SITL does not answer within `timeout_s` of wall clock, or answers nonsense.
    """

    def __init__(self, control: str, timeout_s: float = 5.0) -> None:
        self._name = control
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                self._socket = socket.create_connection(endpoint(control), timeout=timeout_s)
                break
            except ConnectionRefusedError as error:
                if time.monotonic() > deadline:  # a SITL that was started with us may take a moment
                    raise LinkError(f"control {control}: nobody listens there") from error
                time.sleep(0.05)
            except OSError as error:
                raise LinkError(f"control {control}: {error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._answers = self._socket.makefile("r", encoding="utf-8", newline="\n")

    def hello(self) -> float:
        """Vehicle time [s]."""
        name, version, time_ms = self._ask("hello", words=3, first="aerialstar-sitl")
        if version != "1":
            raise LinkError(f"control {self._name}: {name} speaks version {version}, we speak 1")
        return int(time_ms) / 1000

    def advance(self, step_ms: int) -> tuple[float, int]:
        """Let `step_ms` pass; vehicle time [s] after it and the number of datagrams sent to us."""
        _, time_ms, sent = self._ask(f"advance {step_ms}", words=3, first="advanced")
        return int(time_ms) / 1000, int(sent)

    def quit(self) -> None:
        """End the SITL."""
        self._ask("quit", words=1, first="bye")

    def close(self) -> None:
        self._answers.close()
        self._socket.close()

    def _ask(self, request: str, words: int, first: str) -> list[str]:
        try:
            self._socket.sendall(f"{request}\n".encode())
            answer = self._answers.readline()
        except OSError as error:
            raise LinkError(f"control {self._name}: no answer to {request!r}: {error}") from error
        parts = answer.split()
        if len(parts) != words or parts[0] != first:
            raise LinkError(f"control {self._name}: {request!r} was answered {answer.strip() or 'by hanging up'!r}")
        return parts
