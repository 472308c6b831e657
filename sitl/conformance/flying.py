"""Getting the vehicle into the air and down again, and the setpoints it is flown by."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance.outcome import Failed, require
from sitl.conformance.vehicle import AUTOPILOT_COMPONENT, IN_AIR, ON_GROUND, Sample, Vec3, Vehicle

NAN = math.nan
ARM, TAKEOFF, LAND, RETURN = 400, 22, 21, 20
VELOCITY_YAW, VELOCITY = 2503, 3527
"""POSITION_TARGET_TYPEMASK of what is ignored: all but velocity and yaw; all but velocity."""
POSITION_YAW, POSITION, POSITION_VELOCITY_YAW = 2552, 3576, 2496
LOCAL_NED, BODY_NED, GLOBAL_RELATIVE = 1, 8, 6
"""MAV_FRAME."""

HEIGHT_M = 8.0
"""Where the checks are flown."""
NEAR_M = 0.7
AREA_M = 10.0
"""A check begins at most so far from where the vehicle took off."""
SLOW_MPS = 0.3
HEARD_S = 3.0
"""A HEARTBEAT, sent once a second, has told of a change by then."""
SETTLE_S = 20.0
DOWN_S = 90.0

Stream = Callable[[], None]
STILL: Vec3 = (0.0, 0.0, 0.0)


def setpoint(
    v: Vehicle,
    mask: int = VELOCITY_YAW,
    velocity: Vec3 = STILL,
    position: Vec3 = STILL,
    yaw: float = 0.0,
    frame: int = LOCAL_NED,
    system: int | None = None,
) -> None:
    """SET_POSITION_TARGET_LOCAL_NED; positions are from the estimator's origin."""
    target = v.system if system is None else system
    v.send(
        mavlink.MAVLink_set_position_target_local_ned_message(
            v.time_ms, target, AUTOPILOT_COMPONENT, frame, mask, *position, *velocity, 0.0, 0.0, 0.0, yaw, 0.0
        )
    )


def velocity(v: Vehicle, north: float = 0.0, east: float = 0.0, down: float = 0.0, yaw: float | None = None) -> Stream:
    """A stream of velocities [m/s], with a yaw [rad] (as it is now)."""
    heading = v.yaw if yaw is None else yaw
    return lambda: setpoint(v, velocity=(north, east, down), yaw=heading)


def place(v: Vehicle, north: float, east: float, up: float = HEIGHT_M) -> Vec3:
    """A place so far from where the vehicle took off, NED from the estimator's origin."""
    return v.start[0] + north, v.start[1] + east, v.start[2] - up


def distance(a: Vec3, b: Vec3) -> float:
    return math.dist(a, b)


def turned(angle: float) -> float:
    """An angle [rad] between -pi and pi."""
    return math.remainder(angle, math.tau)


def mean_velocity(samples: Sequence[Sample], seconds: float) -> Vec3:
    """Of the last so many seconds of a track. Raises Failed when it is shorter."""
    if not samples or samples[-1].time_s - samples[0].time_s < seconds:
        raise Failed("LOCAL_POSITION_NED came too seldom")
    last = samples[-1]
    first = next(s for s in samples if s.time_s >= last.time_s - seconds)
    time_s = last.time_s - first.time_s
    north, east, down = ((b - a) / time_s for a, b in zip(first.position, last.position, strict=True))
    return north, east, down


# Ground


def until_ready(v: Vehicle) -> None:
    """In the mode that flights begin in, and ready to arm. Raises Failed."""
    if v.mode != v.autopilot.hold:
        v.set_mode(v.autopilot.hold)  # refused by ArduCopter while it has no position: then once more below
    v.until(lambda: v.ready, v.autopilot.ready_s, "ready to arm (PREARM_CHECK of SYS_STATUS)")
    if v.mode != v.autopilot.hold:
        v.set_mode(v.autopilot.hold)
        v.until(lambda: v.mode == v.autopilot.hold, HEARD_S, "mode to take off from")
    v.start = v.now.position


def arm(v: Vehicle) -> None:
    """In the mode that flights begin in. Raises Failed."""
    until_ready(v)
    result = v.command(ARM, 1.0)
    require(result == mavlink.MAV_RESULT_ACCEPTED, f"arming: {result_name(result)}")
    v.until(lambda: v.armed, HEARD_S, "armed by HEARTBEAT")


def take_off(v: Vehicle, height: float = HEIGHT_M) -> float:
    """Arm, take off and wait until it hovers; vehicle time taken from the command on [s]. Raises Failed."""
    arm(v)
    altitude = height
    if v.autopilot.takeoff_amsl:
        there = v.latest.get("GLOBAL_POSITION_INT")
        require(there is not None, "no GLOBAL_POSITION_INT to take off by")
        altitude += there.alt / 1000.0  # type: ignore[union-attr]
    begun = v.time_ms
    result = v.command(TAKEOFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, altitude)
    require(result == mavlink.MAV_RESULT_ACCEPTED, f"takeoff: {result_name(result)}")
    v.until(lambda: abs(v.height - height) < NEAR_M, 40.0, f"{height:g} m above the ground")
    taken = (v.time_ms - begun) / 1000.0
    settle(v)
    return taken


def settle(v: Vehicle) -> None:
    """Wait until it hovers in its own hold mode, in the air by its own account. Raises Failed."""
    still = velocity(v) if v.mode == v.autopilot.external and not v.autopilot.needs_stream else None
    if v.mode != v.autopilot.hold:
        v.until(lambda: v.mode == v.autopilot.hold, HEARD_S + 5.0, "hold mode")
    v.until(lambda: v.now.speed < SLOW_MPS and abs(v.now.velocity[2]) < SLOW_MPS, SETTLE_S, "hovering", still)
    v.until(lambda: v.landed == IN_AIR, 5.0, "in the air by EXTENDED_SYS_STATE", still)


def hold(v: Vehicle) -> None:
    """Whatever it flies: stop, in its own hold mode."""
    if v.mode != v.autopilot.hold:
        v.set_mode(v.autopilot.hold)
    settle(v)


def into_the_air(v: Vehicle) -> None:
    """Hovering near where it took off, as checks in the air begin. Raises Failed."""
    if not v.armed:
        take_off(v)
        return
    if v.landed == ON_GROUND:
        come_down(v)
        take_off(v)
        return
    hold(v)
    here = v.now.position
    there = place(v, 0.0, 0.0)
    if math.hypot(here[0] - there[0], here[1] - there[1]) > AREA_M or abs(here[2] - there[2]) > 0.35 * HEIGHT_M:
        go_to(v, there)
        hold(v)


def to_the_ground(v: Vehicle) -> None:
    """Landed where it took off, disarmed and ready to arm. Raises Failed."""
    if v.armed and v.landed != ON_GROUND:
        with suppress(Failed):  # it lands where it is, then
            into_the_air(v)
            go_to(v, place(v, 0.0, 0.0))
    come_down(v)
    until_ready(v)


def come_down(v: Vehicle) -> None:
    """Land where it is, and disarm. Raises Failed."""
    if v.armed:
        if v.landed == ON_GROUND:
            v.command(ARM, 0.0)
        else:
            v.command(LAND, 0.0, 0.0, 0.0, NAN, NAN, NAN, 0.0)
        v.until(lambda: not v.armed, DOWN_S, "landed and disarmed")


def leave_safely(v: Vehicle) -> bool:
    """Down and disarmed at the end, whatever happened: land, and if that does not help once more; whether it is."""
    for _ in range(2):
        try:
            if not v.known or "HEARTBEAT" not in v.latest or not v.armed:
                return True
            come_down(v)
        except Failed:
            continue
    return "HEARTBEAT" in v.latest and not v.armed


# Setpoints


def take_control(v: Vehicle, stream: Stream | None = None) -> None:
    """Into the mode that flies setpoints, with a stream of them (zero velocity). Raises Failed."""
    still = stream or velocity(v)
    v.go_on(0.4, still)
    if v.mode == v.autopilot.external:
        return
    result = v.set_mode(v.autopilot.external, still)
    require(result == mavlink.MAV_RESULT_ACCEPTED, f"mode for setpoints: {result_name(result)}")
    v.until(lambda: v.mode == v.autopilot.external, HEARD_S, "mode for setpoints by HEARTBEAT", still)


def go_to(v: Vehicle, there: Vec3, limit_s: float = 30.0) -> float:
    """To a place by position setpoints; vehicle time taken [s]. Raises Failed."""
    take_control(v)

    def stream() -> None:
        setpoint(v, POSITION, position=there)

    return v.until(lambda: distance(v.now.position, there) < NEAR_M, limit_s, "place reached", stream)


def stop(v: Vehicle) -> float:
    """Zero velocity until it hardly moves; vehicle time taken [s]. Raises Failed."""
    return v.until(lambda: v.now.speed < SLOW_MPS, SETTLE_S, "stopped by zero velocity", velocity(v))


def result_name(result: int | None) -> str:
    """As a sentence says it."""
    if result is None:
        return "no COMMAND_ACK"
    return str(mavlink.enums["MAV_RESULT"][result].name.removeprefix("MAV_RESULT_")) if result < 10 else str(result)
