"""The MAVSDK 4.1 back end: MAVSDK asks and confirms, our link carries its frames (`raw://`).

MAVSDK hands over what it wants to send on threads of its own; it waits in a queue until our thread polls. So a bridge
whose loop has stopped sends nothing, whatever MAVSDK goes on repeating, and one thread writes the log.

MAVSDK repeats the last velocity at 20 Hz for ever. Of its setpoints only those pass that we have just asked for, once
each: the stream on the wire is ours, and it ends when we stop. It repeats a command until that is acknowledged, also
when a pilot has taken over meanwhile: what we have given up waiting for is not sent again.

State comes from the same decoded frames as with pymavlink: MAVSDK's telemetry carries no vehicle time, and knows fewer
modes. Its timeouts and its heartbeat run on the wall clock, which is why it flies at the vehicle's own pace at most.
"""

import contextlib
import json
import math
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, partial
from typing import Any, TypeVar

from mavsdk import mavsdk
from mavsdk.exceptions import MavsdkError
from mavsdk.logging import log_subscribe
from mavsdk.plugins.action import Action
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.offboard import Offboard, VelocityNedYaw
from mavsdk.plugins.param import Param, ParamError, ParamResult
from pymavlink.dialects.v20 import common as mavlink

from airframe.frames import enu_to_ned, yaw_enu_to_ned
from airframe.slot_profile import Vector
from autopilot_bridge.clock import Clock
from autopilot_bridge.dialects import Dialect
from autopilot_bridge.link import OWN_SYSTEM, Link
from autopilot_bridge.mavlink_vehicle import RETRY_S, SHOWN_S, MavlinkVehicle
from autopilot_bridge.uploaded_fence import FenceItem
from autopilot_bridge.vehicle import Mode, RefusedError, VehicleError
from autopilot_bridge.wire import header

DISCOVERY_WALL_S = 5.0
SETPOINT_WALL_S = 0.02
"""MAVSDK's thread hands a setpoint over within 0.3 ms; we do not wait for ever."""
STALE_WALL_S = 1.0
"""What has waited for so long while our loop stood still is no longer ours to ask for; MAVSDK repeats what it needs."""
STALE_SETPOINT_WALL_S = 0.5
DARK_WALL_S = 0.3
"""Having heard nothing for so long in flight we ask for no mode, see `deadman`; nor does MAVSDK for us."""
COMMANDS = (
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
    mavlink.MAVLINK_MSG_ID_COMMAND_INT,
    mavlink.MAVLINK_MSG_ID_SET_MODE,
)
VELOCITY = slice(10 + 16, 10 + 28)
"""Where vx, vy, vz lie in a frame of SET_POSITION_TARGET_LOCAL_NED."""
UNANSWERED = ("TIMEOUT", "BUSY", "NO_SYSTEM", "CONNECTION_ERROR", "UNKNOWN")
"""Results by which the autopilot has said nothing."""
T = TypeVar("T")


class MavsdkVehicle(MavlinkVehicle):
    """See `MavlinkVehicle`."""

    def __init__(
        self, link: Link, dialects: dict[int, Dialect], system_id: int, clock: Clock, wait: Callable[[], None]
    ) -> None:
        super().__init__(link, dialects, system_id, clock, wait)
        self._outbox: deque[tuple[float, bytes]] = deque()
        """What MAVSDK wants to send, and since when (wall clock)."""
        self._wanted: bytes | None = None
        """The velocity that we have asked for and not yet sent, as in its frame."""
        self._wanted_once = False
        """Whether a setpoint was ever sent: MAVSDK enters OFFBOARD only then."""
        self._handed_over = threading.Event()
        self._calls = ThreadPoolExecutor(max_workers=4, thread_name_prefix="mavsdk")
        self._given_up: Future[Any] | None = None
        """A call of ours that MAVSDK may still be busy with; until the next one no command passes."""
        self._heard_at = 0.0
        """Wall clock of the last frame of the autopilot."""
        self._whole: set[str] = set()
        """Parameters that are whole numbers."""
        _silence()
        own = mavsdk.Configuration.create_manual(OWN_SYSTEM, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, True)
        self._client = mavsdk.Mavsdk(own)
        self._client.subscribe_raw_bytes_to_be_sent(self._hand_over)
        self._client.add_any_connection("raw://")
        link.listener = self._client.pass_received_raw_bytes
        self._action: Action
        self._offboard: Offboard
        self._param: Param
        self._direct: MavlinkDirect
        self._plans: MissionRaw

    def poll(self, timeout_s: float) -> None:
        self._flush()
        heard, mode = self.heard, self._telemetry.mode
        super().poll(timeout_s)
        if self.heard != heard:
            self._heard_at = time.monotonic()
        if self._telemetry.mode is not mode:
            self._wanted = None  # it was for the mode before
        self._flush()

    def beat(self) -> None:
        """MAVSDK makes its own HEARTBEAT, once a second; like all it makes, it waits for us."""
        self._flush()

    def send_velocity(self, velocity_enu: Vector, yaw_enu: float) -> None:
        north, east, down = enu_to_ned(*velocity_enu.tolist())
        self._flush()
        self._handed_over.clear()
        self._wanted = struct.pack("<3f", north, east, down)
        self._offboard.set_velocity_ned(VelocityNedYaw(north, east, down, math.degrees(yaw_enu_to_ned(yaw_enu))))
        self._handed_over.wait(SETPOINT_WALL_S)
        self._flush()

    def disarm(self) -> None:
        self._do("disarm", lambda: not self._telemetry.armed, self._action.disarm)

    def set_parameter(self, name: str, value: float) -> None:
        self._parameter(name)
        if name in self._whole and value != int(value):
            raise VehicleError(f"parameter {name}: {value:g} is not a whole number, it must be")
        try:
            if name in self._whole:
                self._ask(lambda: self._param.set_param_int(name, int(value)))
            else:
                self._ask(lambda: self._param.set_param_float(name, value))
        except ParamError as error:
            raise VehicleError(f"parameter {name}: the autopilot did not take {value:g}") from error

    def uploaded_fence(self) -> list[FenceItem]:
        try:
            items = self._ask(self._plans.download_geofence)
        except MavsdkError as error:
            raise VehicleError(f"the fence uploaded to the autopilot cannot be read: {_result(error)}") from error
        return [FenceItem(item.command, item.param1, item.x / 1e7, item.y / 1e7) for item in items]

    def close(self) -> None:
        self._calls.shutdown(wait=True, cancel_futures=True)  # none may be inside MAVSDK when it goes
        self._link.listener = None
        self._client.destroy()
        super().close()

    def _meet(self) -> None:
        system = self._ask(lambda: self._client.first_autopilot(DISCOVERY_WALL_S))
        if system is None:
            raise VehicleError(f"autopilot at {self._link.url}: heard by us, not found by MAVSDK")
        self._action, self._offboard = Action(system), Offboard(system)
        self._param, self._direct, self._plans = Param(system), MavlinkDirect(system), MissionRaw(system)
        for message_id, rate_hz in self.dialect.rates_hz.items():
            with contextlib.suppress(MavsdkError):  # what it does not have it need not send
                self._ask(partial(self._command, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz))

    def _set_mode(self, mode: Mode) -> None:
        calls = {Mode.LAND: self._action.land, Mode.RETURN: self._action.return_to_launch}
        if mode is Mode.OFFBOARD and self._wanted_once:
            calls[mode] = self._offboard.start
        custom = self.dialect.commands.get(mode, (0.0, 0.0))
        by_number = (mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *custom)
        self._do(
            f"mode {mode}",
            lambda: self._telemetry.mode is mode,
            calls.get(mode, lambda: self._command(*by_number)),
        )

    def _parameter(self, name: str) -> float:
        try:
            value = float(self._ask(lambda: self._param.get_param_int(name)))
        except ParamError as error:
            if error.result is not ParamResult.WRONG_TYPE:
                raise VehicleError(f"parameter {name}: unknown to the autopilot ({error.result.name})") from error
            return float(self._ask(lambda: self._param.get_param_float(name)))
        self._whole.add(name)
        return value

    def _arm(self) -> None:
        self._do("arm", lambda: self._telemetry.armed, self._action.arm)

    def _request_home(self) -> None:
        with contextlib.suppress(MavsdkError):
            home = mavlink.MAVLINK_MSG_ID_HOME_POSITION
            self._ask(lambda: self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, home))

    def _take_off(self, altitude_m: float, climbing: Callable[[], bool]) -> None:
        if self.dialect.takeoff_altitude is None:
            self._ask(lambda: self._action.set_takeoff_altitude(altitude_m))
        self._do("takeoff", climbing, self._action.takeoff)

    # Asking MAVSDK: its calls block on a thread of their own, since ours must go on polling for them to end.

    def _ask(self, call: Callable[[], T]) -> T:
        """What `call` returns or raises; vehicle time goes on meanwhile. What `_wait` raises gives it up."""
        while self._given_up is not None and not self._given_up.done():
            self._wait()
        self._flush()
        future, self._given_up = self._calls.submit(call), None
        try:
            while not future.done():
                self._wait()
        except BaseException:
            self._given_up = future
            raise
        return future.result()

    def _do(self, what: str, done: Callable[[], bool], call: Callable[[], object]) -> None:
        """`call`, unless it is `done`, until telemetry shows it. Raises RefusedError, VehicleError."""
        if done():
            return
        heard = len(self._texts)
        try:
            self._ask(call)
        except MavsdkError as error:
            self._until(done, RETRY_S)  # done without an ACK; or the reason's STATUSTEXT may follow
            if done():
                return
            result = _result(error)
            if result in UNANSWERED:
                raise VehicleError(f"{what}: nothing came of it ({result}){self._since(heard)}") from error
            raise RefusedError(f"{what}: {result} by the autopilot{self._since(heard)}") from error
        if not self._until(done, SHOWN_S):
            raise VehicleError(f"{what}: nothing came of it{self._since(heard)}")

    def _command(self, command: float, *params: float) -> None:
        """A COMMAND_LONG that MAVSDK has no call for. Raises MavsdkError when it is refused."""
        seven = (*params, *[0.0] * (7 - len(params)))
        fields: dict[str, float] = {
            "target_system": self._system_id,
            "target_component": 1,
            "command": int(command),
            "confirmation": 0,
        }
        fields |= {f"param{number}": value for number, value in enumerate(seven, 1)}
        self._direct.send_command(
            MavlinkMessage("COMMAND_LONG", OWN_SYSTEM, 191, self._system_id, 1, json.dumps(fields))
        )

    # The wire. `_hand_over` is called on MAVSDK's threads.

    def _hand_over(self, frame: bytes) -> None:
        self._outbox.append((time.monotonic(), frame))
        if self._is_setpoint(frame) and frame[VELOCITY] == self._wanted:  # not a repeat, that came in between
            self._handed_over.set()

    @staticmethod
    def _is_setpoint(frame: bytes) -> bool:
        return bool(header(frame)[2] == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED)

    def _flush(self) -> None:
        while self._outbox:
            since, frame = self._outbox.popleft()
            refusal = self._refusal(frame, time.monotonic() - since)
            if refusal:
                self.counters[refusal] += 1
                continue
            if self._is_setpoint(frame):
                self._wanted, self._wanted_once = None, True
            self._link.send_frame(frame)

    def _refusal(self, frame: bytes, age_s: float) -> str:
        """Why a frame of MAVSDK's is not sent, as a counter's name; empty when it is."""
        if age_s > (STALE_SETPOINT_WALL_S if self._is_setpoint(frame) else STALE_WALL_S):
            return "stale_dropped"
        if self._is_setpoint(frame):
            return "" if frame[VELOCITY] == self._wanted else "repeats_dropped"
        if header(frame)[2] not in COMMANDS:
            return ""
        if self._given_up is not None:
            return "given_up_dropped"
        dark = self._telemetry.armed and time.monotonic() - self._heard_at > DARK_WALL_S
        return "dark_dropped" if dark else ""


@cache
def _silence() -> None:
    """Keep MAVSDK from writing on our standard output what the bus is told anyway.

    Once a process: to subscribe anew would free the callback that a thread of MAVSDK may be in.
    """
    log_subscribe(lambda *_: True)


def _result(error: MavsdkError) -> str:
    return str(error.args[0].name) if error.args else str(error)
