"""MAVLink clients over real UDP that own the vehicle's clock.

`Lockstep` flies a SITL process by its control socket; `Direct` flies an autopilot in this process, without the wait
for a process to start.
"""

import math
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from pymavlink.dialects.v20 import all as mavlink

from sitl.autopilot import Autopilot
from sitl.links.link import Link
from sitl.links.network import Network
from sitl.links.signing import Signing
from sitl.links.udp import UdpPort
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import Personality
from sitl.px4.personality import PX4
from sitl.px4.streams import COMPANION_RATES_HZ
from tests.sitl.process import SitlProcess, free_udp_port

NAN = math.nan
VELOCITY = 2503
"""Type mask: velocity and yaw."""


class Client:
    """Sends MAVLink, advances the vehicle, collects what it says."""

    def __init__(self, port: int, to: int, system: int = 240, component: int = 191) -> None:
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.udp.bind(("127.0.0.1", port))
        self.udp.setblocking(False)
        self.to = ("127.0.0.1", to)
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.vehicle_system = 1
        """Whose messages count as `latest`; others' are forwarded to us too."""
        self.time_ms = 0
        self.messages: list = []
        self.times: list[int] = []
        self.raw: list[bytes] = []
        self.latest: dict = {}

    def close(self) -> None:
        self.udp.close()

    def step(self, ms: int) -> int:
        """Move the vehicle on; the number of frames it says it sent."""
        raise NotImplementedError

    def send(self, message) -> None:
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        self.udp.sendto(message.pack(self.mav), self.to)

    def advance(self, ms: int = 50) -> int:
        """Move the vehicle on and read what it sent; the number of frames it says it sent."""
        frames = self.step(ms)
        self.receive()
        return frames

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
            if message.get_srcSystem() == self.vehicle_system:
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
        for position, message in enumerate(self.messages):
            if message.get_type() == "STATUSTEXT":
                number = message.id or -position  # without an id it stands alone
                whole[number] = whole.get(number, "") + message.text
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


class Lockstep(Client):
    """Flies a SITL process by its control socket."""

    def __init__(self, sitl: SitlProcess) -> None:
        super().__init__(sitl.companion, sitl.companion_bind)
        self.tcp = socket.create_connection(("127.0.0.1", sitl.control))
        self.replies = self.tcp.makefile("r")
        self.time_ms = int(self.ask("hello").split()[2])

    def close(self) -> None:
        super().close()
        self.replies.close()
        self.tcp.close()

    def ask(self, line: str) -> str:
        """One control request and its answer."""
        self.tcp.sendall(line.encode() + b"\n")
        return self.replies.readline().strip()

    def step(self, ms: int) -> int:
        word, time_ms, frames = self.ask(f"advance {ms}").split()
        assert word == "advanced"
        self.time_ms = int(time_ms)
        return int(frames)


SLOW_RATES_HZ = {name: min(rate, 10.0) for name, rate in COMPANION_RATES_HZ.items() if name != "HIGHRES_IMU"}
"""Enough to watch a flight by; tests of the rates themselves take PX4's."""


class Direct(Client):
    """Flies an autopilot in this process, over its real UDP links."""

    def __init__(
        self,
        rates_hz: Mapping[str, float] = SLOW_RATES_HZ,
        seed: int = 0,
        personality: Personality = PX4,
        **parameters: float,
    ) -> None:
        p = Parameters(personality.table)
        for name, value in parameters.items():
            p.set(name, value)
        port = free_udp_port()
        signing = Signing()
        companion = UdpPort(
            "companion", 0, port, lambda put, ms: Link("companion", rates_hz, 1, signing, put, now_ms=ms)
        )
        self.gcs = UdpPort(
            "gcs",
            0,
            free_udp_port(),
            lambda put, ms: Link("gcs", personality.gcs_rates_hz, 1, signing, put, talks_first=False, now_ms=ms),
        )
        self.link = companion.configured
        self.autopilot = Autopilot(personality, p, Origin(), Network((companion, self.gcs), 1, signing), seed, 0)
        super().__init__(port, companion.port)

    def close(self) -> None:
        super().close()
        self.autopilot.network.close()
        assert not self.autopilot.defects, "a service or telemetry raised; its traceback is on stderr"

    def step(self, ms: int) -> int:
        before = self.link.sent
        self.autopilot.receive()
        self.autopilot.advance(ms)
        self.time_ms = self.autopilot.now_ms
        return self.link.sent - before

    @property
    def commander(self):
        return self.autopilot.vehicle.commander


@contextmanager
def lockstep(sitl: SitlProcess) -> Iterator[Lockstep]:
    client = Lockstep(sitl)
    try:
        yield client
    finally:
        client.close()


@contextmanager
def direct(rates_hz: dict[str, float] = SLOW_RATES_HZ, seed: int = 0, **parameters: float) -> Iterator[Direct]:
    client = Direct(rates_hz, seed, **parameters)
    try:
        yield client
    finally:
        client.close()
