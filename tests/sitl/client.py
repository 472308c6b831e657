"""A lockstep client over the real sockets: sends MAVLink, advances the vehicle, collects what it says."""

import math
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pymavlink.dialects.v20 import development as mavlink

NAN = math.nan
VELOCITY = 2503
"""Type mask: velocity and yaw."""


class Lockstep:
    """Owns the clock of a SITL and speaks on one of its links."""

    def __init__(self, sitl, link: str = "companion", system: int = 240, component: int = 191) -> None:
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.udp.bind(("127.0.0.1", sitl.companion if link == "companion" else sitl.gcs))
        self.udp.setblocking(False)
        self.to = ("127.0.0.1", sitl.companion_bind if link == "companion" else sitl.gcs_bind)
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.tcp = socket.create_connection(("127.0.0.1", sitl.control))
        self.replies = self.tcp.makefile("r")
        self.time_ms = int(self.ask("hello").split()[2])
        self.messages: list = []
        self.times: list[int] = []
        self.raw: list[bytes] = []
        self.latest: dict = {}

    def close(self) -> None:
        self.replies.close()
        self.tcp.close()
        self.udp.close()

    def ask(self, line: str) -> str:
        """One control request and its answer."""
        self.tcp.sendall(line.encode() + b"\n")
        return self.replies.readline().strip()

    def send(self, message) -> None:
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        self.udp.sendto(message.pack(self.mav), self.to)

    def advance(self, ms: int = 50) -> int:
        """Move the vehicle on and read what it sent; the number of frames it says it sent."""
        word, time_ms, frames = self.ask(f"advance {ms}").split()
        assert word == "advanced"
        self.time_ms = int(time_ms)
        self.receive()
        return int(frames)

    def receive(self) -> None:
        while True:
            try:
                raw = self.udp.recv(65535)
            except BlockingIOError:
                return
            self.raw.append(raw)
            message = self.mav.decode(bytearray(raw))
            self.messages.append(message)
            self.times.append(self.time_ms)
            self.latest[message.get_type()] = message

    def until(self, condition: Callable[[], bool], limit_s: float, each: Callable[[], None] | None = None) -> float:
        """Advance by 50 ms (calling `each` before) until the condition holds; vehicle time taken [s]."""
        start = self.time_ms
        while not condition():
            assert self.time_ms - start < limit_s * 1000, f"not within {limit_s} s of vehicle time; {self.texts()}"
            if each is not None:
                each()
            self.advance()
        return (self.time_ms - start) / 1000.0

    def fly(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Advance for so long, calling `each` before every 50 ms."""
        end = self.time_ms + seconds * 1000
        self.until(lambda: self.time_ms >= end, seconds + 1, each)

    def command(self, number: int, *p: float, component: int = 1, system: int = 1) -> int | None:
        """COMMAND_LONG; the result of its COMMAND_ACK within 100 ms, None without one."""
        values = [*p, *([0.0] * (7 - len(p)))]
        before = len(self.messages)
        self.send(mavlink.MAVLink_command_long_message(system, component, number, 0, *values))
        self.advance(50)
        self.advance(50)
        for message in self.messages[before:]:
            if message.get_type() == "COMMAND_ACK" and message.command == number:
                return message.result
        return None

    def setpoint(self, vn=0.0, ve=0.0, vd=0.0, *, mask=VELOCITY, frame=1, yaw=0.0, position=(0.0, 0.0, 0.0), target=1):
        """SET_POSITION_TARGET_LOCAL_NED."""
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                self.time_ms, target, 1, frame, mask, *position, vn, ve, vd, 0.0, 0.0, 0.0, yaw, 0.0
            )
        )

    def texts(self) -> list[str]:
        """STATUSTEXTs so far, chunks joined, PX4's tab removed."""
        whole: dict[int, str] = {}
        for message in self.messages:
            if message.get_type() == "STATUSTEXT":
                whole[message.id] = whole.get(message.id, "") + message.text
        return [text.rstrip("\t") for text in whole.values()]

    @property
    def armed(self) -> bool:
        return bool(self.latest["HEARTBEAT"].base_mode & 0x80)

    @property
    def mode(self) -> tuple[int, int]:
        """Main and sub mode of the last HEARTBEAT."""
        custom = self.latest["HEARTBEAT"].custom_mode
        return custom >> 16 & 0xFF, custom >> 24

    @property
    def landed(self) -> int:
        return self.latest["EXTENDED_SYS_STATE"].landed_state

    @property
    def position(self) -> tuple[float, float, float]:
        m = self.latest["LOCAL_POSITION_NED"]
        return m.x, m.y, m.z

    @property
    def velocity(self) -> tuple[float, float, float]:
        m = self.latest["LOCAL_POSITION_NED"]
        return m.vx, m.vy, m.vz

    def boot(self) -> None:
        """Advance until it may be armed."""
        self.until(lambda: "HEARTBEAT" in self.latest and self.latest["HEARTBEAT"].system_status == 3, 6)

    def take_off(self, altitude: float = NAN) -> None:
        """Boot, arm, take off, and wait for hold. `altitude` is above mean sea level."""
        self.boot()
        assert self.command(400, 1) == 0
        assert self.command(22, 0, 0, 0, NAN, NAN, NAN, altitude) == 0
        self.until(lambda: self.landed == 2 and self.mode == (4, 3), 40)

    def offboard(self, *velocity: float) -> None:
        """Stream a velocity and enter OFFBOARD."""
        for _ in range(4):
            self.setpoint(*velocity)
            self.advance()
        self.setpoint(*velocity)
        assert self.command(176, 1, 6) == 0
        self.setpoint(*velocity)


def as_float(value: int) -> float:
    """PX4's bytewise int32 in a float."""
    return struct.unpack("<f", struct.pack("<i", value))[0]


@contextmanager
def lockstep(sitl, **options) -> Iterator[Lockstep]:
    client = Lockstep(sitl, **options)
    try:
        yield client
    finally:
        client.close()
