"""The pymavlink back end: every message of ours is packed here.

A command is repeated until telemetry shows its effect, and given up when the autopilot refuses it or never does it.
"""

import math
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from airframe.frames import enu_to_ned, yaw_enu_to_ned
from airframe.slot_profile import Vector
from autopilot_bridge.clock import Clock
from autopilot_bridge.dialects import Dialect
from autopilot_bridge.link import OWN_SYSTEM, Link
from autopilot_bridge.mavlink_vehicle import INTEGERS, RETRY_S, SHOWN_S, TRIES, MavlinkVehicle
from autopilot_bridge.uploaded_fence import FenceItem
from autopilot_bridge.vehicle import Mode, RefusedError, VehicleError

ACK_STEPS = 5
"""How long an ACK may take while there is no vehicle time to measure it by."""
VELOCITY_AND_YAW = 2503
"""SET_POSITION_TARGET_LOCAL_NED type_mask: position, acceleration and yaw rate ignored."""


class PymavlinkVehicle(MavlinkVehicle):
    """See `MavlinkVehicle`."""

    read = MavlinkVehicle.read | {
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
        mavlink.MAVLINK_MSG_ID_MISSION_COUNT,
        mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_ACK,
    }

    def __init__(
        self, link: Link, dialects: dict[int, Dialect], system_id: int, clock: Clock, wait: Callable[[], None]
    ) -> None:
        super().__init__(link, dialects, system_id, clock, wait)
        self._acks: dict[int, int] = {}
        self._parameters: dict[str, tuple[float, int]] = {}
        self._fence_items: dict[int, FenceItem] = {}
        self._fence_count: int | None = None
        self._fence_refusal: int | None = None
        """MAV_MISSION_RESULT."""

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

    def disarm(self) -> None:
        self._command("disarm", lambda: not self._telemetry.armed, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)

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

    def uploaded_fence(self) -> list[FenceItem]:
        where, fence = (self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1), mavlink.MAV_MISSION_TYPE_FENCE
        self._fence_items, self._fence_count, self._fence_refusal = {}, None, None
        self._download(
            mavlink.MAVLink_mission_request_list_message(*where, fence), lambda: self._fence_count is not None
        )
        while len(self._fence_items) < (self._fence_count or 0):
            wanted = len(self._fence_items)
            self._download(
                mavlink.MAVLink_mission_request_int_message(*where, wanted, fence),
                partial(self._fence_items.__contains__, wanted),
            )
        self._link.send(mavlink.MAVLink_mission_ack_message(*where, mavlink.MAV_MISSION_ACCEPTED, fence))
        return [self._fence_items[number] for number in sorted(self._fence_items)]

    def _download(self, request: Any, done: Callable[[], bool]) -> None:  # noqa: ANN401  pymavlink has no types
        """Repeat a request of the mission protocol until it is answered. Raises VehicleError."""
        for _ in range(TRIES):
            self._link.send(request)
            if self._until(lambda: done() or self._fence_refusal is not None, RETRY_S):
                break
        if not done():
            refusal = mavlink.enums["MAV_MISSION_RESULT"].get(self._fence_refusal)
            why = refusal.name if refusal else "no answer"
            raise VehicleError(f"the fence uploaded to the autopilot cannot be read: {why}")

    def _meet(self) -> None:
        """Each rate is asked for until it is acknowledged, with less patience the longer nothing is."""
        unanswered = 0
        for message_id, rate_hz in self.dialect.rates_hz.items():
            for _ in range(max(TRIES - unanswered, 1)):
                if self._rated(message_id, rate_hz, steps=ACK_STEPS if unanswered < TRIES else 1):
                    unanswered = 0
                    break
                unanswered += 1

    def _rated(self, message_id: int, rate_hz: float, steps: int) -> bool:
        """Ask for a rate; whether it is acknowledged. Steps are counted: there may be no vehicle time yet."""
        self._acks.pop(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, None)
        self._send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)
        for _ in range(steps):
            self._wait()
            if mavlink.MAV_CMD_SET_MESSAGE_INTERVAL in self._acks:
                return True
        return False

    def _identify(self) -> None:
        for _ in range(TRIES):
            self._send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            if self._until(lambda: bool(self.hardware_uid), RETRY_S):
                return

    def _set_mode(self, mode: Mode) -> None:
        command: tuple[float, ...]
        if mode is Mode.LAND:
            command = (mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, math.nan, math.nan, math.nan, math.nan)
        elif mode is Mode.RETURN:
            command = (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,)
        else:
            command = (
                mavlink.MAV_CMD_DO_SET_MODE,
                mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
                *self.dialect.commands[mode],
            )
        self._command(f"mode {mode}", lambda: self._telemetry.mode is mode, *command)

    def _parameter(self, name: str) -> float:
        return self._read(name)[0]

    def _arm(self) -> None:
        self._command("arm", lambda: self._telemetry.armed, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def _request_home(self) -> None:
        self._send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    def _take_off(self, altitude_m: float, climbing: Callable[[], bool]) -> None:
        altitude = math.nan if self.dialect.takeoff_altitude is not None else altitude_m
        self._command("takeoff", climbing, mavlink.MAV_CMD_NAV_TAKEOFF, *[math.nan] * 6, altitude)

    def _take(self, message: Any) -> None:  # noqa: ANN401  pymavlink has no types
        match message.get_type():
            case "COMMAND_ACK":
                self._acks[message.command] = message.result
            case "PARAM_VALUE" if self._known is not None:  # who it is tells how integers travel
                value = self._decode(message.param_value, message.param_type)
                self._parameters[message.param_id] = (value, message.param_type)
            case "MISSION_COUNT" if _of_our_fence(message):
                self._fence_count = message.count
            case "MISSION_ITEM_INT" if _of_our_fence(message):
                place = message.x / 1e7, message.y / 1e7
                self._fence_items[message.seq] = FenceItem(message.command, message.param1, *place)
            case "MISSION_ACK" if _of_our_fence(message):
                self._fence_refusal = message.type
            case _:
                super()._take(message)

    def _read(self, name: str) -> tuple[float, int]:
        """Asked for anew every time: somebody else may have set it."""
        self._parameters.pop(name, None)
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
        if kind in INTEGERS and self.dialect.int_bytewise:
            return float(struct.unpack("<i", struct.pack("<f", wire))[0])
        return wire

    def _encode(self, name: str, value: float, kind: int) -> float:
        if kind not in INTEGERS:
            return value
        if value != int(value):
            raise VehicleError(f"parameter {name}: {value:g} is not a whole number, it must be")
        if not self.dialect.int_bytewise:
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
        for _ in range(TRIES):
            self._send_command(command, *params)
            if self._until(lambda: done() or number in self._acks, RETRY_S) and done():
                return
            match self._acks.get(number):
                case None | mavlink.MAV_RESULT_IN_PROGRESS:
                    continue
                case mavlink.MAV_RESULT_ACCEPTED:
                    if self._until(done, SHOWN_S):
                        return
                    break
                case result:
                    self._until(lambda: False, RETRY_S)  # the reason's STATUSTEXT may follow the ACK
                    if done():
                        return
                    name = mavlink.enums["MAV_RESULT"][result].name.removeprefix("MAV_RESULT_")
                    raise RefusedError(f"{what}: {name} by the autopilot{self._since(heard)}")
        raise VehicleError(f"{what}: nothing came of it{self._since(heard)}")


def _of_our_fence(message: Any) -> bool:  # noqa: ANN401
    """Whether a message of the mission protocol belongs to our download of the fence, not to somebody else's."""
    return bool(message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE and message.target_system in (0, OWN_SYSTEM))
