"""Real sockets between an autopilot and its bridge, which lose, hold back, cut and restart what passes."""

import contextlib
import selectors
import socket
import threading
import time
from collections import deque

from pymavlink.dialects.v20 import common as mavlink

TURN_S = 0.002


class MavlinkRelay:
    """One UDP link of a SITL, as its bridge at `127.0.0.1:<bridge>` is to see it.

    To the autopilot it is the companion computer at the port that it sends to; to the bridge it is the autopilot.
    """

    def __init__(self, sitl, companion, bridge):
        self._sitl = ("127.0.0.1", sitl)
        self._up = self._open(self._sitl, own_port=companion)
        self._down = self._open(("127.0.0.1", bridge))
        self._left = []
        """Sockets of before a restart; nobody listens there any more."""
        self._lock = threading.Lock()
        self.cut = False
        """Nothing passes, either way."""
        self.delay_s = 0.0
        """Wall clock, each way."""
        self.setpoints = []
        """When setpoints of the bridge came (wall clock), also those that were not passed on."""
        self._since_ms = 0
        """What is taken off the autopilot's clock."""
        self._newest_ms = 0
        self._decoder = mavlink.MAVLink(None)
        self._beat = b""
        """The bridge's last HEARTBEAT."""
        self._waiting = deque()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._pass, daemon=True)
        self._thread.start()

    @staticmethod
    def _open(peer, own_port=0):
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.bind(("127.0.0.1", own_port))
        opened.connect(peer)
        opened.setblocking(False)
        return opened

    def restart_mavlink(self):
        """The autopilot's MAVLink side starts anew: its clock at 0, sequence numbers and rates as at power-on."""
        with self._lock:
            self._since_ms = self._newest_ms
            self._left.append(self._up)
            self._up = self._open(self._sitl)
            self._decoder = mavlink.MAVLink(None)
            self._up.send(self._beat)  # who is at the port that it sends to, it knows from its parameters

    def jump(self, seconds):
        """The autopilot's clock shows so much more from now on."""
        with self._lock:
            self._since_ms -= round(seconds * 1000)

    def setpoints_since(self, wall_s):
        """How many setpoints have come from the bridge since then (monotonic clock)."""
        return sum(at > wall_s for at in self.setpoints)

    def close(self):
        self._over.set()
        self._thread.join()
        for one in (self._up, self._down, *self._left):
            one.close()

    def _pass(self):
        while not self._over.is_set():
            with self._lock:
                up, down = self._up, self._down
                self._take(up, lambda datagram: self._to_bridge(datagram))
                self._take(down, self._to_sitl)
                while self._waiting and self._waiting[0][0] <= time.monotonic():
                    _, out, datagram = self._waiting.popleft()
                    with contextlib.suppress(OSError):
                        out.send(datagram)
            with selectors.DefaultSelector() as wait:
                wait.register(up, selectors.EVENT_READ)
                wait.register(down, selectors.EVENT_READ)
                wait.select(TURN_S)

    @staticmethod
    def _take(source, put):
        with contextlib.suppress(OSError):  # nothing more, or nobody there
            while True:
                put(source.recv(65536))

    def _to_bridge(self, datagram):
        if not self.cut:
            self._send(self._down, self._shifted(datagram))

    def _to_sitl(self, datagram):
        match int.from_bytes(datagram[7:10], "little"):
            case mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                self.setpoints.append(time.monotonic())
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self._beat = datagram
        if not self.cut:
            self._send(self._up, datagram)

    def _send(self, out, datagram):
        self._waiting.append((time.monotonic() + self.delay_s, out, datagram))

    def _shifted(self, datagram):
        """With its time since boot counted from the last restart."""
        message = self._decoder.decode(bytearray(datagram))
        if not hasattr(message, "time_boot_ms"):
            return datagram
        self._newest_ms = message.time_boot_ms
        if self._since_ms == 0:
            return datagram
        message.time_boot_ms = (message.time_boot_ms - self._since_ms) % (1 << 32)
        codec = mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
        codec.seq = message.get_seq()
        return message.pack(codec)


class TcpRelay:
    """A TCP endpoint in front of another one, whose connections can be cut and refused for a while."""

    def __init__(self, port):
        self._target = ("127.0.0.1", port)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._pairs = []
        self._threads = []
        self._cut = False
        self._over = False
        self._start(self._accept)

    def cut(self):
        """Break every connection, and take none."""
        self._cut = True
        for one in self._pairs:
            for end in one:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
        self._pairs.clear()

    def mend(self):
        self._cut = False

    def close(self):
        self._over = True
        self.cut()
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for thread in self._threads:
            thread.join(5)

    def _start(self, target, *arguments):
        thread = threading.Thread(target=target, args=arguments, daemon=True)
        thread.start()
        self._threads.append(thread)

    def _accept(self):
        with contextlib.suppress(OSError):
            while not self._over:
                came, _ = self._server.accept()
                if self._cut:
                    came.close()
                    continue
                there = socket.create_connection(self._target)
                self._pairs.append((came, there))
                self._start(self._copy, came, there)
                self._start(self._copy, there, came)

    @staticmethod
    def _copy(source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
