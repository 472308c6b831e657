"""MAVLink frames over a client's UDP or TCP socket."""

import re
import select
import socket
import struct
import time
from pathlib import Path
from typing import Protocol

MAVLINK_1, MAVLINK_2 = 0xFE, 0xFD
SIGNED = 1
"""Bit of incompat_flags: a signature of 13 bytes follows."""
RECEIVE_BUFFER = 4 << 20
"""[bytes] A simulator that runs much faster than real time must not lose what the client reads later."""
CONNECT_S = 5.0
READS_MAX = 64
"""Datagrams taken in one go, so that conditions are looked at in between."""

URL = re.compile(r"(?P<kind>udpin|udpout|tcp):(?://)?(?P<host>[^\s:/]+):(?P<port>\d{1,5})")


class WireError(RuntimeError):
    """The URL cannot be used, or the connection has ended; the text names it."""


class Wire(Protocol):
    """Frames to and from a vehicle."""

    def send(self, frame: bytes) -> None: ...

    def receive(self, timeout_s: float) -> list[bytes]:
        """The frames that wait; waits for the first one at most so long."""
        ...

    def close(self) -> None: ...


def split(data: bytes) -> tuple[list[bytes], bytes]:
    """The frames in `data`, and the bytes at its end that may be the beginning of another one. Checksums are not
    looked at."""
    frames: list[bytes] = []
    at, end = 0, len(data)
    while at < end:
        magic = data[at]
        if magic not in (MAVLINK_1, MAVLINK_2):
            at += 1
            continue
        if end - at < 3:
            break
        length = data[at + 1] + (8 if magic == MAVLINK_1 else 12 + 13 * (data[at + 2] & SIGNED))
        if end - at < length:
            break
        frames.append(data[at : at + length])
        at += length
    return frames, data[at:]


class Udp:
    """`udpin` waits for the vehicle on a port and answers whoever sent last; `udpout` sends to it first."""

    def __init__(self, host: str, port: int, listens: bool) -> None:
        """Raises OSError."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._peer: tuple[str, int] | None = None
        try:
            if listens:
                self._socket.bind((host, port))
            else:
                self._peer = (socket.gethostbyname(host), port)
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    def send(self, frame: bytes) -> None:
        """Lost when there is nobody to send to, as datagrams may be."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(frame, self._peer)
        except OSError:
            return

    def receive(self, timeout_s: float) -> list[bytes]:
        frames: list[bytes] = []
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return frames
        for _ in range(READS_MAX):
            try:
                datagram, sender = self._socket.recvfrom(65535)
            except BlockingIOError:
                break
            except OSError:  # nobody was there when we sent before
                continue
            found, _rest = split(datagram)
            if found:
                self._peer = sender
                frames += found
        return frames

    def close(self) -> None:
        self._socket.close()


class Tcp:
    """A client of a vehicle that listens, as ArduPilot's simulator on 5760."""

    def __init__(self, host: str, port: int) -> None:
        """Raises OSError."""
        self._socket = socket.create_connection((host, port), CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._rest = b""

    def send(self, frame: bytes) -> None:
        """Raises WireError when the connection has ended."""
        try:
            self._socket.sendall(frame)
        except OSError as error:
            raise WireError(f"the TCP connection has ended: {error}") from error

    def receive(self, timeout_s: float) -> list[bytes]:
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return []
        try:
            data = self._socket.recv(65536)
        except OSError as error:
            raise WireError(f"the TCP connection has ended: {error}") from error
        if not data:
            raise WireError("the vehicle has closed the TCP connection")
        frames, self._rest = split(self._rest + data)
        return frames

    def close(self) -> None:
        self._socket.close()


class Logged:
    """A wire whose frames, both ways, are kept in a `.tlog`: 8 bytes of big-endian microseconds, then the frame."""

    def __init__(self, wire: Wire, path: Path) -> None:
        """Raises WireError."""
        self._wire = wire
        try:
            self._log = path.open("wb")
        except OSError as error:
            raise WireError(f"--tlog {path}: cannot be written: {error.strerror}") from error

    def _keep(self, frame: bytes) -> None:
        self._log.write(struct.pack(">Q", time.time_ns() // 1000) + frame)

    def send(self, frame: bytes) -> None:
        self._keep(frame)
        self._wire.send(frame)

    def receive(self, timeout_s: float) -> list[bytes]:
        frames = self._wire.receive(timeout_s)
        for frame in frames:
            self._keep(frame)
        return frames

    def close(self) -> None:
        self._wire.close()
        self._log.close()


def connect(url: str) -> Wire:
    """The wire of a URL: `udpin:HOST:PORT`, `udpout:HOST:PORT` or `tcp:HOST:PORT` (also with `//`).

    Raises WireError with what is wrong with it.
    """
    match = URL.fullmatch(url)
    if match is None or not 0 < int(match["port"]) < 65536:
        raise WireError(f"URL {url!r}: must be udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT, ports 1 to 65535")
    host, port = match["host"], int(match["port"])
    try:
        return Tcp(host, port) if match["kind"] == "tcp" else Udp(host, port, match["kind"] == "udpin")
    except OSError as error:
        raise WireError(f"URL {url}: {error.strerror or error}") from error
