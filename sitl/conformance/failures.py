"""Level 3: what must not happen, and what must when a client fails."""

import math
import random

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance import flying, parameters, plans
from sitl.conformance.checks import State, check
from sitl.conformance.flying import (
    ARM,
    NAN,
    SLOW_MPS,
    VELOCITY_YAW,
    distance,
    result_name,
    setpoint,
    take_control,
    velocity,
)
from sitl.conformance.outcome import Failed, Skipped, require
from sitl.conformance.vehicle import AUTOPILOT_COMPONENT, Vec3, Vehicle, tilt_of

ACCEPTED, UNSUPPORTED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_UNSUPPORTED
SPEED = 3.0
BEGINS = 0.8
"""Braking has begun when speed has fallen to this share."""
BRAKES_S = 2.0
"""Beyond the time set, until braking shows: what PX4 takes to see it, and to tilt."""
EARLY_S = 0.4
UPRIGHT = math.radians(60.0)
NOTHING_THERE = 31_010
"""MAV_CMD_USER_1, which nobody implements."""
NO_MESSAGE = 60_000
"""An id that no dialect has."""


def drifted(v: Vehicle, begin: Vec3) -> float:
    """Horizontal way from a place [m]."""
    here = v.now.position
    return math.hypot(here[0] - begin[0], here[1] - begin[1])


def loss_s(v: Vehicle, expected: float) -> float:
    """How long after the last setpoint it brakes, flying north [s]. Raises Failed when that is not as expected."""
    take_control(v)
    v.go_on(4.0, velocity(v, SPEED))
    with v.track() as samples:
        v.go_on(0.3, velocity(v, SPEED))
        stopped_ms = v.time_ms
        speed = v.now.speed
        require(speed > 0.5 * SPEED, f"it flew only {speed:.1f} m/s before the stream ended")
        v.until(lambda: samples[-1].speed < BEGINS * speed, expected + 10.0, "braking after the last setpoint")
    seen = (v.time_ms - stopped_ms) / 1000.0
    require(seen > expected - EARLY_S, f"it braked {seen:.1f} s after the last setpoint, {expected:g} s is set")
    require(seen < expected + BRAKES_S, f"it braked only {seen:.1f} s after the last setpoint, {expected:g} s is set")
    v.until(lambda: v.now.speed < SLOW_MPS, flying.SETTLE_S, "standing after the stream was lost")
    require(v.height > 0.5 * flying.HEIGHT_M, f"it sank to {v.height:.1f} m")
    return seen


@check(3, State.FRESH, "PX4 Preflight Checks / Copter Pre-Arm Safety Checks: not armed before it is ready")
def arm_before_ready(v: Vehicle) -> str:
    v.until(lambda: "SYS_STATUS" in v.latest, 5.0, "SYS_STATUS")
    if v.ready or v.armed:
        raise Skipped("it was ready when it was met: start it anew for this one")
    said = len(v.texts)
    result = v.command(ARM, 1.0, attempts=1)
    require(result not in (None, ACCEPTED), f"arming: {result_name(result)}, though PREARM_CHECK was not set")
    v.go_on(1.5)
    require(not v.armed, "it is armed, though PREARM_CHECK was not set")
    return "; ".join([result_name(result), *v.texts[said:]])


@check(3, State.GROUND, "Command Protocol: MAV_RESULT_UNSUPPORTED for a command that is not known")
def unknown_command(v: Vehicle) -> str:
    result = v.command(NOTHING_THERE)
    require(result == UNSUPPORTED, f"MAV_CMD {NOTHING_THERE}: {result_name(result)}")
    return result_name(result)


@check(3, State.GROUND, "MAV_CMD_REQUEST_MESSAGE, MAV_CMD_SET_MESSAGE_INTERVAL: unknown ids are not accepted")
def unknown_message(v: Vehicle) -> str:
    asked = v.command(mavlink.MAV_CMD_REQUEST_MESSAGE, NO_MESSAGE)
    require(asked not in (None, ACCEPTED), f"REQUEST_MESSAGE of {NO_MESSAGE}: {result_name(asked)}")
    interval = v.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, NO_MESSAGE, 1e6)
    require(interval not in (None, ACCEPTED), f"SET_MESSAGE_INTERVAL of {NO_MESSAGE}: {result_name(interval)}")
    return f"{result_name(asked)}, {result_name(interval)}"


@check(3, State.GROUND, "Parameter Protocol: no PARAM_VALUE for a name that is not there")
def unknown_parameter(v: Vehicle) -> str:
    name = "NO_SUCH_THING"
    with v.hear("PARAM_VALUE") as heard:
        v.send(mavlink.MAVLink_param_request_read_message(v.system, AUTOPILOT_COMPONENT, parameters.wire_id(name), -1))
        v.send(mavlink.MAVLink_param_set_message(v.system, AUTOPILOT_COMPONENT, parameters.wire_id(name), 1.0, 9))
        v.go_on(2.0)
    told = [m.param_id for m in heard]
    require(not told, f"PARAM_VALUE of {told[:1]} came")
    return "no PARAM_VALUE"


@check(3, State.GROUND, "Routing: a command for another system is not obeyed, nor answered")
def foreign_system(v: Vehicle) -> str:
    result = v.command(ARM, 1.0, system=v.system % 250 + 1, attempts=1)
    v.go_on(2.0)
    require(not v.armed, "it armed by a command for another system")
    require(result is None, f"COMMAND_ACK {result_name(result)} to a command for another system")
    return "not armed, no COMMAND_ACK"


@check(3, State.GROUND, "Routing: a command for another component is not obeyed (ArduPilot does obey)")
def foreign_component(v: Vehicle) -> str:
    if not v.autopilot.one_component:
        raise Skipped(f"{v.autopilot.name} takes commands for other components of its system")
    result = v.command(ARM, 1.0, component=154, attempts=1)
    v.go_on(2.0)
    require(not v.armed, "it armed by a command for a gimbal")
    require(result is None, f"COMMAND_ACK {result_name(result)} to a command for a gimbal")
    return "not armed, no COMMAND_ACK"


@check(3, State.GROUND, "MAV_CMD_COMPONENT_ARM_DISARM: param1 is 0 or 1")
def arm_by_another_value(v: Vehicle) -> str:
    result = v.command(ARM, 2.0, attempts=1)
    v.go_on(2.0)
    require(not v.armed, "it armed by param1 = 2")
    require(result != ACCEPTED, "param1 = 2: ACCEPTED")
    return result_name(result)


@check(3, State.GROUND, "MAV_CMD_NAV_TAKEOFF: a vehicle that is disarmed stays where it is")
def takeoff_disarmed(v: Vehicle) -> str:
    v.start = v.now.position
    result = v.command(flying.TAKEOFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, 5.0)
    v.go_on(4.0)
    require(not v.armed, "it armed by itself")
    require(abs(v.height) < 0.5, f"{v.height:.1f} m high")
    return f"{result_name(result)}, on the ground"


@check(3, State.GROUND, "Serialization: bytes that are no frame, cut frames and bad checksums are passed over")
def garbage(v: Vehicle) -> str:
    noise = random.Random(4)
    frame = bytearray(mavlink.MAVLink_command_long_message(v.system, 1, ARM, 0, 1.0, *[0.0] * 6).pack(v.mav))
    frame[-1] ^= 0xFF
    for _ in range(50):
        v.wire.send(noise.randbytes(noise.randrange(1, 280)))
        v.wire.send(bytes(frame))
        v.wire.send(bytes(frame[: noise.randrange(1, len(frame))]))
    v.wire.send(bytes(300))  # ends whatever frame a stream's reader believes to be in
    v.go_on(2.0)
    require(not v.armed, "it armed by a command with a bad checksum")
    mark = 42_424_242
    with v.hear("TIMESYNC") as heard:
        for _ in range(3):
            v.send(mavlink.MAVLink_timesync_message(0, mark))
            if v.answered(lambda: any(m.ts1 == mark for m in heard)):
                break
        else:
            raise Failed("TIMESYNC is not answered any more")
    return "150 bad datagrams, then TIMESYNC was answered"


@check(3, State.AIR, "MAV_CMD_COMPONENT_ARM_DISARM: disarming in the air is refused")
def disarm_in_the_air(v: Vehicle) -> str:
    before = v.height
    result = v.command(ARM, 0.0)
    v.go_on(2.0)
    require(v.armed, "it disarmed in the air")
    require(result not in (None, ACCEPTED), f"disarming in the air: {result_name(result)}")
    require(abs(v.height - before) < 1.0, f"it went from {before:.1f} to {v.height:.1f} m")
    return result_name(result)


@check(3, State.AIR, "PX4 Offboard Mode: not entered without a stream of setpoints")
def control_without_stream(v: Vehicle) -> str:
    if not v.autopilot.needs_stream:
        raise Skipped(f"{v.autopilot.name} is flown without a stream")
    v.go_on(2.0)
    begin, mode = v.now.position, v.mode
    result = v.set_mode(v.autopilot.external)
    v.go_on(2.0)
    require(result not in (None, ACCEPTED), f"mode for setpoints without any: {result_name(result)}")
    require(v.mode == mode, f"custom_mode went from {mode:#x} to {v.mode:#x}")
    require(distance(v.now.position, begin) < 1.0, f"it moved {distance(v.now.position, begin):.1f} m")
    return result_name(result)


@check(3, State.AIR, "PX4 Mission Mode / Copter Auto Mode: not entered without a mission")
def mission_without_items(v: Vehicle) -> str:
    plans.clear(v)
    mode, begin = v.mode, v.now.position
    result = v.set_mode(v.autopilot.mission)
    v.go_on(2.0)
    require(result not in (None, ACCEPTED), f"mission mode without a mission: {result_name(result)}")
    require(v.mode == mode, f"custom_mode went from {mode:#x} to {v.mode:#x}")
    require(distance(v.now.position, begin) < 1.0, f"it moved {distance(v.now.position, begin):.1f} m")
    return result_name(result)


@check(3, State.AIR, "SET_POSITION_TARGET_LOCAL_NED: a velocity that is not a number brakes, and is not flown")
def nan_velocity(v: Vehicle) -> str:
    take_control(v)
    v.go_on(3.0, velocity(v, SPEED))
    require(v.now.speed > 0.5 * SPEED, f"it flew only {v.now.speed:.1f} m/s before")
    heading, before = v.yaw, v.height

    def stream() -> None:
        setpoint(v, VELOCITY_YAW, (NAN, SPEED, 0.0), yaw=heading)

    with v.track() as samples, v.hear("ATTITUDE") as attitudes:
        v.until(lambda: v.now.speed < 0.5, 12.0, "braked by NaN", stream)
        v.go_on(1.0, stream)
    require(samples[-1].speed < 1.0, f"{samples[-1].speed:.1f} m/s while NaN is streamed")
    tilt = max(tilt_of(m) for m in attitudes)
    require(tilt < UPRIGHT, f"it tilted by {math.degrees(tilt):.0f} deg")
    require(abs(v.height - before) < 3.0, f"it went from {before:.1f} to {v.height:.1f} m")
    return f"{samples[-1].speed:.2f} m/s then, tilted at most {math.degrees(tilt):.0f} deg"


@check(3, State.AIR, "MAV_FRAME: a velocity in a frame that is not supported is not flown")
def wrong_frame(v: Vehicle) -> str:
    parameters.change(v, v.autopilot.loss_settings)
    take_control(v)
    begin, heading = v.now.position, v.yaw
    v.go_on(3.0, lambda: setpoint(v, velocity=(SPEED, 0.0, 0.0), yaw=heading, frame=mavlink.MAV_FRAME_MISSION))
    far = drifted(v, begin)
    parameters.restore(v)
    require(far < 1.0, f"it moved {far:.1f} m by setpoints in MAV_FRAME_MISSION")
    return f"moved {far:.2f} m in 3 s"


@check(3, State.AIR, "Routing: setpoints for another system are not flown")
def foreign_setpoints(v: Vehicle) -> str:
    take_control(v)
    begin, heading = v.now.position, v.yaw
    other = v.system % 250 + 1

    def stream() -> None:
        setpoint(v, yaw=heading)
        setpoint(v, velocity=(SPEED, 0.0, 0.0), yaw=heading, system=other)

    with v.track() as samples:
        v.go_on(3.0, stream)
    far, fast = drifted(v, begin), max(s.speed for s in samples)
    require(far < 1.0 and fast < 0.5, f"it moved {far:.1f} m, at up to {fast:.1f} m/s")
    return f"moved {far:.2f} m in 3 s"


@check(3, State.AIR, "PX4 MPC_XY_VEL_MAX, MPC_TILTMAX_AIR / ArduPilot WPNAV_SPEED, ANGLE_MAX: limits that always hold")
def huge_velocity(v: Vehicle) -> str:
    take_control(v)
    heading, before = v.yaw, v.height

    def stream() -> None:
        setpoint(v, velocity=(1e6, 0.0, 0.0), yaw=heading)

    with v.track() as samples, v.hear("ATTITUDE") as attitudes:
        v.go_on(2.0, stream)
    fast = max(s.speed for s in samples)
    taken = flying.stop(v)
    require(fast < 25.0, f"it flew {fast:.0f} m/s")
    tilt = max(tilt_of(m) for m in attitudes)
    require(tilt < UPRIGHT, f"it tilted by {math.degrees(tilt):.0f} deg")
    require(abs(v.height - before) < 4.0, f"it went from {before:.1f} to {v.height:.1f} m")
    require(fast > 1.0, f"it flew at {fast:.1f} m/s at most: was the setpoint taken at all?")
    return f"{fast:.1f} m/s, tilted by {math.degrees(tilt):.0f} deg, stopped after {taken:.1f} s"


@check(3, State.AIR, "PX4 COM_OF_LOSS_T, COM_OBL_RC_ACT / ArduPilot GUID_TIMEOUT: the end of a stream is noticed")
def stream_lost(v: Vehicle) -> str:
    parameters.change(v, v.autopilot.loss_settings)
    set_to = parameters.read(v, v.autopilot.loss_parameter)
    if set_to is None:
        raise Failed(f"{v.autopilot.loss_parameter} is not there")
    seen = loss_s(v, set_to.value)
    if v.autopilot.needs_stream:
        require(v.mode != v.autopilot.external, "it is still in the mode for setpoints")
    parameters.restore(v)
    return f"brakes {seen:.1f} s after the last setpoint, {set_to.value:g} s is set"


@check(3, State.ANY, "LOCAL_POSITION_NED, ATTITUDE, ...: time_boot_ms never goes back")
def clock(v: Vehicle) -> str:
    require(not v.backwards, f"{len(v.backwards)} times, first {v.backwards[:1]}")
    return f"{v.time_ms / 1000.0:.0f} s, always forward"
