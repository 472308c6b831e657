"""What both back ends share: the vehicle's state, read from the frames that `link` has decoded, and waiting for it.

A command is done when telemetry shows its effect, whether its ACK came or not.
"""

import contextlib
import math
import time
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from airframe.frames import ned_to_enu, yaw_ned_to_enu
from airframe.slot_profile import Vector
from autopilot_bridge.clock import WENT_BACK_S, Clock
from autopilot_bridge.dialects import Dialect
from autopilot_bridge.link import Link
from autopilot_bridge.vehicle import Mode, RefusedError, SilentError, Telemetry, Vehicle, VehicleError

CONNECT_WALL_S = 5.0
BEAT_WALL_S = 0.5
"""How often we speak to an autopilot that must hear us before it answers."""
ARMABLE_S = 60.0
ROLL_CALL_S = 1.5
"""After so long another autopilot on the link must have been heard: they beat once a second."""
TAKEOFF_S = 60.0
LIFTED_M = 0.5
"""So high a vehicle is on its way up."""
MODE_NEWS_S = 0.15
"""A mode heard this short a time ago is the vehicle's."""
MODE_WAIT_S = 1.5
"""An autopilot that will not send HEARTBEAT faster does so once a second."""
ASK_S = 0.2
"""How often we ask an autopilot whose mode we doubt, on vehicle time and on the wall clock."""
REFUSED_S = 3.0
"""Vehicle time in which a stream of setpoints that has just begun may be refused."""
SHOWN_S = 6.0
"""Vehicle time in which telemetry must show what was acknowledged."""
RETRY_S = 0.5
TRIES = 6
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
HOME_MOVED_M = 1.0
"""So far from where it was at arming it is another home."""
TURN_MS = 1 << 32
"""After so long, 49.7 days, time_boot_ms begins anew."""
NEAR_MS = 60_000
"""A time_boot_ms this near to the newest is of the same start of the autopilot."""
OVERTAKEN = 64
"""A frame whose number is behind the newest by less came late; one that is further behind has lost its neighbours."""
INTEGERS = range(mavlink.MAV_PARAM_TYPE_UINT8, mavlink.MAV_PARAM_TYPE_INT64 + 1)


class MavlinkVehicle(Vehicle):
    """See `Vehicle`. `wait` lets a step of vehicle time pass.

    `dialects` are the autopilots that are flown, by MAV_AUTOPILOT; the first HEARTBEAT chooses.
    """

    read = frozenset(
        (
            mavlink.MAVLINK_MSG_ID_HEARTBEAT,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
            mavlink.MAVLINK_MSG_ID_ATTITUDE,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION,
            mavlink.MAVLINK_MSG_ID_STATUSTEXT,
            mavlink.MAVLINK_MSG_ID_TIMESYNC,
        )
    )
    """Messages that are made something of; the others are only logged."""

    def __init__(
        self, link: Link, dialects: dict[int, Dialect], system_id: int, clock: Clock, wait: Callable[[], None]
    ) -> None:
        self.counters = link.counters
        self._link, self._dialects, self._system_id = link, dialects, system_id
        self._clock, self._wait = clock, wait
        link.wanted = self.read
        self._known: Dialect | None = None
        self._stranger: int | None = None
        """MAV_AUTOPILOT of a HEARTBEAT that we cannot fly."""
        self._telemetry = Telemetry()
        self._home_ned: Vector = np.zeros(3)
        self._moved_home_ned: Vector = np.zeros(3)
        """The autopilot's, where somebody has moved it since."""
        self._home_held = False
        self._homes = 0
        self._met_s = 0.0
        """Vehicle time since which everybody on the link is listened to."""
        self._heartbeat_s = -math.inf
        """Vehicle time of the last one."""
        self._mode_known = True
        self._asked_ns: list[int] = []
        """Our TIMESYNC requests since the mode is doubted (wall clock, CLOCK_MONOTONIC)."""
        self._asked_s = -math.inf
        """Vehicle time of the last one."""
        self._answered = False
        """Whether one of them was."""
        self._boot_ms: int | None = None
        """The newest time_boot_ms, over its turns."""
        self._newest_s: dict[str, float] = {}
        """Vehicle time of the newest telemetry of each kind."""
        self._seq, self._seq_s = 0, -math.inf
        """Number of the newest frame, and when it came (vehicle time)."""
        self._remarks: list[str] = []
        self._objection = ""
        """What was last remarked of the link."""
        self._uid = ""
        self._texts: list[str] = []
        self._texts_told = 0
        self._chunks: dict[int, str] = {}

    @property
    def dialect(self) -> Dialect:
        if self._known is None:
            raise VehicleError(f"autopilot at {self._link.url}: not connected")
        return self._known

    @property
    def hardware_uid(self) -> str:
        return self._uid

    @property
    def telemetry(self) -> Telemetry:
        return self._telemetry

    @property
    def heard(self) -> int:
        return self._link.heard

    @property
    def frames_received(self) -> int:
        return self._link.datagrams

    def poll(self, timeout_s: float) -> None:
        for message in self._link.receive(timeout_s):
            self._take(message)

    def status_texts(self) -> list[str]:
        new = self._texts[self._texts_told :]
        self._texts_told = len(self._texts)
        return new

    def remarks(self) -> list[str]:
        objection = self._link.roll_call.objection() if self._home_held else ""
        if objection and objection != self._objection:
            self._remarks.append(objection)
        self._objection = objection
        new, self._remarks = self._remarks, []
        return new

    def connect(self) -> None:
        self._await_heartbeat()
        self._meet()
        self._await_position()
        self._identify()
        self._met_s = self._clock.now
        self._link.stamp_by(lambda: self._clock.now)

    def await_armable(self) -> None:
        ready = self.dialect.ready
        if self._telemetry.mode is not ready:  # PX4 arms in no mode that cannot begin a flight, such as LAND
            with contextlib.suppress(RefusedError):
                self.set_mode(ready)
        armable = self._until(lambda: self._telemetry.armable and self._homes > 0, ARMABLE_S)
        self._until(lambda: self._clock.now - self._met_s >= ROLL_CALL_S, ROLL_CALL_S)
        self._require_alone()
        home = self._telemetry.home_lat_lon_alt
        if home is None or home[:2] == (0.0, 0.0):
            raise VehicleError(
                f"autopilot at {self._link.url}: no GPS origin (no HOME_POSITION within {ARMABLE_S:g} s)"
            )
        if armable and self._telemetry.mode is not ready:  # ArduCopter leaves it when its start is done
            self.set_mode(ready)

    def arm(self) -> None:
        self._arm()
        homes = self._homes  # arming sets home anew
        for _ in range(TRIES):
            self._request_home()
            if self._until(lambda: self._homes > homes, RETRY_S):
                break
        else:
            self._remarks.append("home at arming was not told: positions are about the one before")
        self._home_held = True

    def takeoff(self, altitude_m: float) -> None:
        dialect = self.dialect
        if dialect.takeoff_altitude is not None:
            self.set_parameter(dialect.takeoff_altitude, altitude_m)

        def height() -> float:
            position = self._telemetry.position_enu
            return -math.inf if position is None else float(position[2])

        def climbing() -> bool:
            return self._telemetry.mode is Mode.TAKEOFF or height() > LIFTED_M

        def there() -> bool:
            return self._telemetry.mode is dialect.ready and height() > dialect.takeoff_done * altitude_m

        self._take_off(altitude_m, climbing)
        if not self._until(there, TAKEOFF_S):
            raise VehicleError(f"takeoff: not at {altitude_m:g} m and holding after {TAKEOFF_S:g} s")

    def parameter(self, name: str) -> float:
        value = self._parameter(name)
        if not math.isfinite(value):  # neither to be flown within nor to be put back
            raise VehicleError(f"parameter {name}: the autopilot says that it is {value:g}")
        return value

    def set_mode(self, mode: Mode) -> None:
        """The mode for setpoints is asked for again: one late setpoint, and PX4 says that there is no stream."""
        begun = self._clock.now
        while True:
            try:
                self._set_mode(mode)
            except RefusedError:
                if mode is not Mode.OFFBOARD or self._clock.now - begun > REFUSED_S:
                    raise
            else:
                return

    def hear_mode(self) -> None:
        self._until(
            lambda: self.mode_known() and abs(self._clock.now - self._heartbeat_s) <= MODE_NEWS_S,
            MODE_WAIT_S,
        )

    def ask_for_telemetry(self) -> None:
        """By SET_MESSAGE_INTERVAL, whatever the back end: one that has started anew knows nothing of the last."""
        for message_id, rate_hz in self.dialect.rates_hz.items():
            command, rest = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, [0.0] * 5
            self._link.send(
                mavlink.MAVLink_command_long_message(
                    self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, command, 0, message_id, 1e6 / rate_hz, *rest
                )
            )

    def doubt_mode(self) -> None:
        self._mode_known, self._answered, self._asked_ns, self._asked_s = False, False, [], -math.inf

    def mode_known(self) -> bool:
        """By a TIMESYNC of ours that comes back: a HEARTBEAT behind the answer was sent after the question."""
        if self._mode_known:
            return True
        now_s, now_ns = self._clock.now, time.monotonic_ns()
        if abs(now_s - self._asked_s) >= ASK_S or now_ns - self._asked_ns[-1] > ASK_S * 1e9:
            self._asked_s = now_s
            self._asked_ns.append(now_ns)
            self._link.send(mavlink.MAVLink_timesync_message(0, now_ns))
        return False

    def close(self) -> None:
        self._link.close()

    # What back ends do in their own way.

    @abstractmethod
    def _meet(self) -> None:
        """After the first HEARTBEAT: whatever the library needs, and asking for the dialect's rates."""

    def _identify(self) -> None:
        """Ask for AUTOPILOT_VERSION, where the library does not by itself; vehicle time goes on by now."""

    @abstractmethod
    def _parameter(self, name: str) -> float:
        """Ask for a parameter. Raises VehicleError when it is unknown."""

    @abstractmethod
    def _set_mode(self, mode: Mode) -> None:
        """Change mode. Raises RefusedError."""

    @abstractmethod
    def _arm(self) -> None:
        """Arm. Raises RefusedError."""

    @abstractmethod
    def _request_home(self) -> None:
        """Ask for HOME_POSITION, once."""

    @abstractmethod
    def _take_off(self, altitude_m: float, climbing: Callable[[], bool]) -> None:
        """Start climbing. Raises RefusedError."""

    # Waiting.

    def _await_heartbeat(self) -> None:
        started = time.monotonic()
        spoken = -math.inf
        while self._known is None:
            wall = time.monotonic()
            if self._stranger is not None:
                raise VehicleError(self._strange())
            if wall - started > CONNECT_WALL_S:
                raise SilentError(self._unheard())
            if wall - spoken > BEAT_WALL_S:
                self.beat()
                spoken = wall
            self._wait()
        if self._link.counters["signed"] and self._link.signing is None:
            raise VehicleError(
                f"autopilot at {self._link.url} signs its frames (MAVLink 2 signing): give its key as signing_key"
            )
        self._require_alone()

    def _strange(self) -> str:
        enum = mavlink.enums["MAV_AUTOPILOT"]
        name = enum[self._stranger].name if self._stranger in enum else f"MAV_AUTOPILOT {self._stranger}"
        allowed = " or ".join(dialect.name for dialect in self._dialects.values())
        return f"autopilot at {self._link.url} is {name}; we fly {allowed} (dialect)"

    def _unheard(self) -> str:
        counters = self._link.counters
        silent = (
            f"autopilot at {self._link.url} never answered (no HEARTBEAT of system {self._system_id} "
            f"within {CONNECT_WALL_S:g} s)"
        )
        if counters["bad_signature"]:
            return f"{silent}: {counters['bad_signature']} frames are signed with another key than signing_key's"
        if counters["unsigned"]:
            return f"{silent}: {counters['unsigned']} frames are not signed, as signing_key demands"
        if counters["replayed"]:
            return f"{silent}: the signatures of {counters['replayed']} frames are more than a minute old"
        others = self._link.roll_call.others()
        return f"{silent}; heard: {others}" if others else silent

    def _require_alone(self) -> None:
        """Raises VehicleError when it is no multicopter, or not the only one on the link."""
        objection = self._link.roll_call.objection()
        if objection:
            raise VehicleError(f"autopilot at {self._link.url}: {objection}")

    def _await_position(self) -> None:
        """ArduCopter has none for half a minute after its start."""
        started, ticked, wall = self._clock.now, self._clock.now, time.monotonic()
        while self._telemetry.position_enu is None:
            if self._clock.now > ticked:
                ticked, wall = self._clock.now, time.monotonic()
            if self._clock.now - started > ARMABLE_S or time.monotonic() - wall > CONNECT_WALL_S:
                raise SilentError(f"autopilot at {self._link.url} gives no LOCAL_POSITION_NED: it has no position")
            self._wait()

    def _until(self, done: Callable[[], bool], within_s: float) -> bool:
        """Wait for `done` for up to `within_s` of vehicle time; whether it came."""
        started = self._clock.now
        while not done():
            if self._clock.now - started > within_s:
                return False
            self._wait()
        return True

    def _since(self, heard: int) -> str:
        texts = list(dict.fromkeys(self._texts[heard:]))
        return ": " + "; ".join(texts) if texts else ""

    # Taking in.

    def _take(self, message: Any) -> None:  # noqa: ANN401  pymavlink has no types
        match message.get_type():
            case "LOCAL_POSITION_NED":
                self._take_position(message)
            case "ATTITUDE":
                self._take_attitude(message)
            case "HEARTBEAT":
                if self._in_turn(message):
                    self._take_heartbeat(message)
            case "EXTENDED_SYS_STATE":
                if self._in_turn(message):
                    landed = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
                    self._telemetry = replace(self._telemetry, landed=landed)
            case "SYS_STATUS":
                if self._in_turn(message):
                    remaining = message.battery_remaining / 100 if message.battery_remaining >= 0 else None
                    armable = bool(message.onboard_control_sensors_health & PREARM)
                    self._telemetry = replace(
                        self._telemetry, battery_remaining=remaining, armable=armable, unhealthy=_unhealthy(message)
                    )
            case "AUTOPILOT_VERSION":
                self._uid = bytes(message.uid2).hex() if any(message.uid2) else f"{message.uid:x}"
            case "HOME_POSITION":
                self._take_home(message)
            case "STATUSTEXT":
                self._take_text(message)
            case "TIMESYNC":
                self._answered = self._answered or (message.tc1 != 0 and message.ts1 in self._asked_ns)

    def _take_position(self, message: Any) -> None:  # noqa: ANN401
        """An estimator that has lost itself says so by NaN, or no longer says anything."""
        told_s = self._told_at(message)
        if told_s is None:
            return
        place = message.x, message.y, message.z, message.vx, message.vy, message.vz
        position: Vector | None = None
        velocity: Vector | None = None
        if all(map(math.isfinite, place)):
            home = self._home_ned
            position = np.array(ned_to_enu(place[0] - home[0], place[1] - home[1], place[2] - home[2]))
            velocity = np.array(ned_to_enu(*place[3:]))
        else:
            self.counters["not_finite"] += 1
        self._telemetry = replace(
            self._telemetry, time_s=self._now(told_s), position_s=told_s, position_enu=position, velocity_enu=velocity
        )

    def _take_attitude(self, message: Any) -> None:  # noqa: ANN401
        told_s = self._told_at(message)
        if told_s is None:
            return
        attitude = (message.roll, message.pitch, yaw_ned_to_enu(message.yaw))
        if not all(map(math.isfinite, attitude)):
            self.counters["not_finite"] += 1
            attitude = self._telemetry.attitude_rad
        self._telemetry = replace(self._telemetry, time_s=self._now(told_s), attitude_rad=attitude)

    def _take_heartbeat(self, message: Any) -> None:  # noqa: ANN401
        if self._known is None:
            self._known = self._dialects.get(message.autopilot)
        if self._known is None or message.autopilot != self._known.autopilot:
            self._stranger = message.autopilot
            self.counters["other_autopilot"] += 1
            return
        self._heartbeat_s = self._clock.now
        self._mode_known = self._mode_known or self._answered
        unknown = (Mode.OTHER, f"custom mode {message.custom_mode:#x}")
        mode, name = self._known.modes.get(message.custom_mode, unknown)
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self._telemetry = replace(
            self._telemetry, mode=mode, mode_name=name, armed=armed, heartbeats=self._telemetry.heartbeats + 1
        )

    def _take_home(self, message: Any) -> None:  # noqa: ANN401
        """Positions stay about the home at arming, whoever moves it."""
        home_ned = np.array([message.x, message.y, message.z])
        if not np.isfinite(home_ned).all():
            self.counters["not_finite"] += 1
            return
        self._homes += 1
        if self._home_held:
            moved_m = float(np.linalg.norm(home_ned - self._moved_home_ned))
            if moved_m > HOME_MOVED_M:
                self._moved_home_ned = home_ned
                east, north, up = ned_to_enu(*(home_ned - self._home_ned).tolist())
                self._remarks.append(
                    f"home was moved to ({east:.1f}, {north:.1f}, {up:.1f}) m: positions and fence stay about the home "
                    "at arming, the autopilot returns to the new one"
                )
            return
        self._home_ned = self._moved_home_ned = home_ned
        self._telemetry = replace(
            self._telemetry,
            home_lat_lon_alt=(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3),
        )

    # What comes late, on a network that lets frames overtake each other, must not undo what is newer.

    def _told_at(self, message: Any) -> float | None:  # noqa: ANN401
        """Vehicle time of a message with time_boot_ms; None when a newer one of its kind is known."""
        told_s, kind = self._boot_s(message.time_boot_ms), message.get_type()
        if 0.0 < self._newest_s.get(kind, -math.inf) - told_s <= WENT_BACK_S:
            self.counters["late"] += 1
            return None
        self._newest_s[kind] = told_s
        return told_s

    def _now(self, told_s: float) -> float:
        """Vehicle time after a message of `told_s`: other kinds may be newer, by as much as no restart is."""
        return max(told_s, self._telemetry.time_s) if self._telemetry.time_s - told_s <= WENT_BACK_S else told_s

    def _boot_s(self, boot_ms: int) -> float:
        """Vehicle time [s] of a time_boot_ms, which begins anew when 32 bits are full."""
        newest = boot_ms if self._boot_ms is None else self._boot_ms
        told_ms = boot_ms + round((newest - boot_ms) / TURN_MS) * TURN_MS
        if abs(told_ms - newest) < NEAR_MS:
            self._boot_ms = max(told_ms, newest)
        else:  # after a long silence, or started anew
            self._boot_ms = told_ms = newest // TURN_MS * TURN_MS + boot_ms
        return told_ms / 1000

    def _in_turn(self, message: Any) -> bool:  # noqa: ANN401
        """Whether a message without a time is newer than all before it, by its frame's number."""
        behind = (self._seq - message.get_seq()) % 256
        if 0 < behind < OVERTAKEN and abs(self._clock.now - self._seq_s) <= WENT_BACK_S:
            self.counters["late"] += 1
            return False
        self._seq, self._seq_s = message.get_seq(), self._clock.now
        return True

    def _take_text(self, message: Any) -> None:  # noqa: ANN401
        """Texts longer than 50 characters come in chunks with one id."""
        text = message.text
        if message.id:
            text = self._chunks.pop(message.id, "") + text
            if len(message.text) == 50:
                self._chunks[message.id] = text
                return
        self._texts.append(text.strip())


def _unhealthy(message: Any) -> tuple[str, ...]:  # noqa: ANN401
    """What of a SYS_STATUS is there, in use, and not well."""
    bad = (
        message.onboard_control_sensors_present
        & message.onboard_control_sensors_enabled
        & ~message.onboard_control_sensors_health
    )
    names = mavlink.enums["MAV_SYS_STATUS_SENSOR"]
    return tuple(
        names[1 << bit].name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_").lower().replace("_", " ")
        for bit in range(31)
        if bad & 1 << bit and 1 << bit in names and 1 << bit != PREARM
    )
