"""The pymavlink back end: one vehicle over our own link.

A command is done when telemetry shows its effect, whether its ACK came or not; it is repeated until then, and given up
when the autopilot refuses it or never does it.
"""

import contextlib
import math
import struct
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from airframe.frames import enu_to_ned, ned_to_enu, yaw_enu_to_ned, yaw_ned_to_enu
from airframe.slot_profile import Vector
from autopilot_bridge.clock import Clock
from autopilot_bridge.dialects import Dialect
from autopilot_bridge.link import Link
from autopilot_bridge.vehicle import Mode, RefusedError, SilentError, Telemetry, Vehicle, VehicleError

CONNECT_WALL_S = 5.0
RETRY_S = 0.5
TRIES = 6
ARMABLE_S = 60.0
TAKEOFF_S = 60.0
MODE_NEWS_S = 0.15
"""A mode heard this short a time ago is the vehicle's."""
MODE_WAIT_S = 1.5
"""An autopilot that will not send HEARTBEAT faster does so once a second."""
VELOCITY_AND_YAW = 2503
"""SET_POSITION_TARGET_LOCAL_NED type_mask: position, acceleration and yaw rate ignored."""
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
INTEGERS = range(mavlink.MAV_PARAM_TYPE_UINT8, mavlink.MAV_PARAM_TYPE_INT64 + 1)


class PymavlinkVehicle(Vehicle):
    """See `Vehicle`. `wait` lets a step of vehicle time pass."""

    def __init__(self, link: Link, dialect: Dialect, system_id: int, clock: Clock, wait: Callable[[], None]) -> None:
        self.counters = link.counters
        self._link, self._dialect, self._system_id = link, dialect, system_id
        self._clock, self._wait = clock, wait
        self._telemetry = Telemetry()
        self._home_ned: Vector = np.zeros(3)
        self._home_held = False
        self._homes = 0
        self._heartbeats = 0
        self._heartbeat_s = -math.inf
        """Vehicle time of the last one."""
        self._heard = 0
        self._texts: list[str] = []
        self._texts_told = 0
        self._chunks: dict[int, str] = {}
        self._acks: dict[int, int] = {}
        self._parameters: dict[str, tuple[float, int]] = {}

    @property
    def telemetry(self) -> Telemetry:
        return self._telemetry

    @property
    def heard(self) -> int:
        return self._heard

    @property
    def frames_received(self) -> int:
        return self._link.datagrams

    def poll(self, timeout_s: float) -> None:
        for message in self._link.receive(timeout_s):
            self._heard += 1
            self._take(message)

    def beat(self) -> None:
        self._link.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                0,
                0,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
        )

    def status_texts(self) -> list[str]:
        new = self._texts[self._texts_told :]
        self._texts_told = len(self._texts)
        return new

    def send_velocity(self, velocity_enu: Vector, yaw_enu: float) -> None:
        north, east, down = enu_to_ned(*velocity_enu.tolist())
        self._link.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                round(self._clock.now * 1000) & 0xFFFFFFFF,
                self._system_id,
                mavlink.MAV_COMP_ID_AUTOPILOT1,
                mavlink.MAV_FRAME_LOCAL_NED,
                VELOCITY_AND_YAW,
                *(0.0, 0.0, 0.0),
                *(north, east, down),
                *(0.0, 0.0, 0.0),
                yaw_enu_to_ned(yaw_enu),
                0.0,
            )
        )

    def connect(self) -> None:
        started = time.monotonic()
        while not self._heartbeats:
            if time.monotonic() - started > CONNECT_WALL_S:
                raise SilentError(
                    f"autopilot at {self._link.url} never answered (no HEARTBEAT of system {self._system_id} "
                    f"within {CONNECT_WALL_S:g} s)"
                )
            self._wait()
        for message_id, rate_hz in self._dialect.rates_hz.items():
            self._send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)
            self._wait()
        started = time.monotonic()
        while self._telemetry.position_enu is None:
            if time.monotonic() - started > CONNECT_WALL_S:
                raise SilentError(f"autopilot at {self._link.url} gives no LOCAL_POSITION_NED")
            self._wait()
        self._link.stamp_by(lambda: self._clock.now)

    def await_armable(self) -> None:
        if self._telemetry.mode is not Mode.HOLD:  # PX4 arms in no mode that cannot begin a flight, such as LAND
            with contextlib.suppress(RefusedError):
                self.set_mode(Mode.HOLD)
        if self._until(lambda: self._telemetry.armable and self._homes > 0, ARMABLE_S):
            return
        if not self._homes:
            raise VehicleError(f"autopilot at {self._link.url}: no HOME_POSITION within {ARMABLE_S:g} s")

    def arm(self) -> None:
        self._command("arm", lambda: self._telemetry.armed, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        homes = self._homes  # arming sets home anew
        self._send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HOME_POSITION)
        self._until(lambda: self._homes > homes, 2.0)
        self._home_held = True

    def disarm(self) -> None:
        self._command("disarm", lambda: not self._telemetry.armed, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)

    def takeoff(self, altitude_m: float) -> None:
        self.set_parameter(self._dialect.takeoff_altitude, altitude_m)

        def climbing() -> bool:
            return self._telemetry.mode is Mode.TAKEOFF

        def there() -> bool:
            position = self._telemetry.position_enu
            return self._telemetry.mode is Mode.HOLD and position is not None and position[2] > 0.8 * altitude_m

        self._command("takeoff", climbing, mavlink.MAV_CMD_NAV_TAKEOFF, *[math.nan] * 7)
        if not self._until(there, TAKEOFF_S):
            raise VehicleError(f"takeoff: not at {altitude_m:g} m and holding after {TAKEOFF_S:g} s")

    def hear_mode(self) -> None:
        self._until(lambda: self._clock.now - self._heartbeat_s <= MODE_NEWS_S, MODE_WAIT_S)

    def set_mode(self, mode: Mode) -> None:
        command: tuple[float, ...]
        if mode is Mode.LAND:
            command = (mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, math.nan, math.nan, math.nan, math.nan)
        elif mode is Mode.RETURN:
            command = (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,)
        else:
            command = (
                mavlink.MAV_CMD_DO_SET_MODE,
                mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
                *self._dialect.commands[mode],
            )
        self._command(f"mode {mode}", lambda: self._telemetry.mode is mode, *command)

    def parameter(self, name: str) -> float:
        return self._read(name)[0]

    def set_parameter(self, name: str, value: float) -> None:
        _, kind = self._read(name)
        wire = self._encode(name, value, kind)
        held = value if kind in INTEGERS else struct.unpack("<f", struct.pack("<f", value))[0]
        for _ in range(TRIES):
            self._parameters.pop(name, None)
            self._link.send(
                mavlink.MAVLink_param_set_message(
                    self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), wire, kind
                )
            )
            if self._until(lambda: name in self._parameters, RETRY_S) and self._parameters[name][0] == held:
                return
        raise VehicleError(f"parameter {name}: the autopilot did not take {value:g}")

    def close(self) -> None:
        self._link.close()

    def _take(self, message: Any) -> None:  # noqa: ANN401  pymavlink has no types
        match message.get_type():
            case "HEARTBEAT":
                self._take_heartbeat(message)
            case "LOCAL_POSITION_NED":
                local = np.array([message.x, message.y, message.z]) - self._home_ned
                self._telemetry = replace(
                    self._telemetry,
                    time_s=message.time_boot_ms / 1000,
                    position_enu=np.array(ned_to_enu(*local.tolist())),
                    velocity_enu=np.array(ned_to_enu(message.vx, message.vy, message.vz)),
                )
            case "ATTITUDE":
                attitude = (message.roll, message.pitch, yaw_ned_to_enu(message.yaw))
                self._telemetry = replace(self._telemetry, attitude_rad=attitude)
            case "EXTENDED_SYS_STATE":
                landed = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
                self._telemetry = replace(self._telemetry, landed=landed)
            case "SYS_STATUS":
                remaining = message.battery_remaining / 100 if message.battery_remaining >= 0 else None
                armable = bool(message.onboard_control_sensors_health & PREARM)
                self._telemetry = replace(self._telemetry, battery_remaining=remaining, armable=armable)
            case "HOME_POSITION":
                self._take_home(message)
            case "COMMAND_ACK":
                self._acks[message.command] = message.result
            case "PARAM_VALUE":
                self._parameters[message.param_id] = (
                    self._decode(message.param_value, message.param_type),
                    message.param_type,
                )
            case "STATUSTEXT":
                self._take_text(message)

    def _take_heartbeat(self, message: Any) -> None:  # noqa: ANN401
        if message.autopilot != self._dialect.autopilot:
            self.counters["other_autopilot"] += 1
            return
        self._heartbeats += 1
        self._heartbeat_s = self._clock.now
        mode, name = self._dialect.modes.get(message.custom_mode, (Mode.OTHER, f"custom mode {message.custom_mode:#x}"))
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self._telemetry = replace(self._telemetry, mode=mode, mode_name=name, armed=armed)

    def _take_home(self, message: Any) -> None:  # noqa: ANN401
        self._homes += 1
        if self._home_held:
            return
        self._home_ned = np.array([message.x, message.y, message.z])
        self._telemetry = replace(
            self._telemetry,
            home_lat_lon_alt=(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3),
        )

    def _take_text(self, message: Any) -> None:  # noqa: ANN401
        """Texts longer than 50 characters come in chunks with one id."""
        text = message.text
        if message.id:
            text = self._chunks.pop(message.id, "") + text
            if len(message.text) == 50:
                self._chunks[message.id] = text
                return
        self._texts.append(text.strip())

    def _read(self, name: str) -> tuple[float, int]:
        for _ in range(TRIES):
            self._link.send(
                mavlink.MAVLink_param_request_read_message(
                    self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1
                )
            )
            if self._until(lambda: name in self._parameters, RETRY_S):
                return self._parameters[name]
        raise VehicleError(f"parameter {name}: unknown to the autopilot (no PARAM_VALUE)")

    def _decode(self, wire: float, kind: int) -> float:
        if kind in INTEGERS and self._dialect.int_bytewise:
            return float(struct.unpack("<i", struct.pack("<f", wire))[0])
        return wire

    def _encode(self, name: str, value: float, kind: int) -> float:
        if kind not in INTEGERS:
            return value
        if value != int(value):
            raise VehicleError(f"parameter {name}: {value:g} is not a whole number, it must be")
        if not self._dialect.int_bytewise:
            return value
        wire: float = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        return wire

    def _send_command(self, command: float, *params: float) -> None:
        seven = (*params, *[0.0] * (7 - len(params)))
        self._link.send(
            mavlink.MAVLink_command_long_message(
                self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, int(command), 0, *seven
            )
        )

    def _command(self, what: str, done: Callable[[], bool], command: float, *params: float) -> None:
        """Send until `done`. Raises RefusedError at a refusal, VehicleError when nothing comes of it."""
        if done():
            return
        heard = len(self._texts)
        number = int(command)
        self._acks.pop(number, None)
        answered = False
        for _ in range(TRIES):
            if not answered:
                self._send_command(command, *params)
            if self._until(lambda: done() or number in self._acks, RETRY_S) and done():
                return
            match self._acks.get(number):
                case None | mavlink.MAV_RESULT_IN_PROGRESS:
                    continue
                case mavlink.MAV_RESULT_ACCEPTED:
                    answered = True
                    if self._until(done, RETRY_S):
                        return
                case result:
                    self._until(lambda: False, RETRY_S)  # the reason's STATUSTEXT may follow the ACK
                    if done():
                        return
                    name = mavlink.enums["MAV_RESULT"][result].name.removeprefix("MAV_RESULT_")
                    raise RefusedError(f"{what}: {name} by the autopilot{self._since(heard)}")
        raise VehicleError(f"{what}: nothing came of it{self._since(heard)}")

    def _since(self, heard: int) -> str:
        texts = list(dict.fromkeys(self._texts[heard:]))
        return ": " + "; ".join(texts) if texts else ""

    def _until(self, done: Callable[[], bool], within_s: float) -> bool:
        """Wait for `done` for up to `within_s` of vehicle time; whether it came."""
        started = self._clock.now
        while not done():
            if self._clock.now - started > within_s:
                return False
            self._wait()
        return True
