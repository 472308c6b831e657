"""A second ground station on the autopilot's other link: where the vehicle truly is, whatever the bridge says of it."""

import contextlib
import math
import socket
import threading
import time
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

SYSTEM = 250
BEAT_WALL_S = 0.05
"""How often it speaks; the simulator forgets who is silent for 10 s of vehicle time."""
EARTH_M = 6371000.0
PATIENCE_S = 60.0
WANTED = {"HIL_STATE_QUATERNION": 115, "HEARTBEAT": 0, "EXTENDED_SYS_STATE": 245}
ON_GROUND = mavlink.MAV_LANDED_STATE_ON_GROUND


@dataclass(frozen=True)
class Sight:
    """What was seen at one moment."""

    time_s: float
    """Vehicle time."""
    wall_s: float
    position_enu: tuple[float, float, float]
    """About where it stood first [m]: the truth, no estimate."""
    speed_mps: float
    custom_mode: int
    armed: bool
    landed: bool

    @property
    def from_home_m(self) -> float:
        return math.hypot(*self.position_enu[:2])

    @property
    def down(self) -> bool:
        return self.landed and not self.armed


class Witness:
    """Listens to a SITL's ground link at `127.0.0.1:<port>` from before the takeoff on."""

    def __init__(self, port):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(BEAT_WALL_S)
        self._codec = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
        self._decoder = mavlink.MAVLink(None)
        self._decoder.robust_parsing = True
        self._home = None
        self._heartbeat = self._landed = None
        self.sights = []
        self.texts = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def until(self, seen, what, timeout_s=PATIENCE_S):
        """Wait until `seen(newest sight)`."""
        deadline = time.monotonic() + timeout_s
        while not (self.sights and seen(self.sights[-1])):
            assert time.monotonic() < deadline, f"waited in vain for {what}: {self.sights[-1:]}, {self.texts[-5:]}"
            time.sleep(0.005)
        return self.sights[-1]

    @property
    def last(self):
        return self.sights[-1]

    def since(self, time_s):
        return [sight for sight in self.sights if sight.time_s >= time_s]

    def close(self):
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _listen(self):
        spoken = -math.inf
        while not self._over.is_set():
            if time.monotonic() - spoken > BEAT_WALL_S:
                spoken = time.monotonic()
                self._speak()
            with contextlib.suppress(OSError):  # silence, or a simulator that is gone
                for message in self._decoder.parse_buffer(self._socket.recv(65536)) or ():
                    if message.get_srcSystem() != SYSTEM:
                        self._take(message)

    def _speak(self):
        wanted = [
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
            )
        ]
        if len(self.sights) < 2:
            wanted += [
                mavlink.MAVLink_command_long_message(
                    1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e5, 0, 0, 0, 0, 0
                )
                for number in WANTED.values()
            ]
        for message in wanted:
            with contextlib.suppress(OSError):
                self._socket.send(message.pack(self._codec))
                self._codec.seq = (self._codec.seq + 1) % 256

    def _take(self, message):
        match message.get_type():
            case "HEARTBEAT" if message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                self._heartbeat = message
            case "EXTENDED_SYS_STATE":
                self._landed = message.landed_state == ON_GROUND
            case "STATUSTEXT":
                self.texts.append(message.text)
            case "HIL_STATE_QUATERNION" if self._heartbeat is not None and self._landed is not None:
                globe = (message.lat / 1e7, message.lon / 1e7, message.alt / 1e3)
                if self._home is None:
                    assert self._landed, "the witness came too late to know where home is"
                    self._home = globe
                north = math.radians(globe[0] - self._home[0]) * EARTH_M
                east = math.radians(globe[1] - self._home[1]) * EARTH_M * math.cos(math.radians(globe[0]))
                self.sights.append(
                    Sight(
                        message.time_usec / 1e6,
                        time.time(),
                        (east, north, globe[2] - self._home[2]),
                        math.hypot(message.vx, message.vy, message.vz) / 100,
                        self._heartbeat.custom_mode,
                        bool(self._heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
                        self._landed,
                    )
                )
