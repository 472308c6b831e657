"""Level 1: arm, take off, setpoints of every kind, return and land. What counts is where the vehicle gets."""

import math
from itertools import pairwise

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance import flying, parameters, plans
from sitl.conformance.checks import State, check
from sitl.conformance.flying import (
    BODY_NED,
    GLOBAL_RELATIVE,
    HEARD_S,
    HEIGHT_M,
    NAN,
    POSITION,
    POSITION_VELOCITY_YAW,
    SLOW_MPS,
    VELOCITY,
    distance,
    go_to,
    mean_velocity,
    place,
    result_name,
    setpoint,
    take_control,
    turned,
    velocity,
)
from sitl.conformance.outcome import require
from sitl.conformance.vehicle import AUTOPILOT_COMPONENT, ON_GROUND, Sample, Vec3, Vehicle

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
SPEED = 2.0
SHARE = 0.25
"""A velocity must be flown within this share; PX4's own simulator stays 13 % short of what is commanded."""
NEAR = 0.6
"""[m]"""
BANK = math.radians(8.0)
GRAVITY = 9.81


def near(seen: Vec3, wanted: Vec3, what: str) -> None:
    """Velocities alike within SHARE of the wanted one."""
    off = distance(seen, wanted)
    require(off <= SHARE * math.hypot(*wanted) + 0.1, f"{what} {vector(seen)} m/s, wanted {vector(wanted)}")


def vector(v: Vec3) -> str:
    return f"({v[0]:.2f}, {v[1]:.2f}, {v[2]:.2f})"


def flown(v: Vehicle, stream: flying.Stream, seconds: float) -> list[Sample]:
    """The track while a stream of setpoints is flown."""
    with v.track() as samples:
        v.go_on(seconds, stream)
    return samples


@check(1, State.GROUND, "MAV_CMD_COMPONENT_ARM_DISARM: arms and disarms on the ground, as HEARTBEAT.base_mode tells")
def arm_and_disarm(v: Vehicle) -> str:
    flying.arm(v)
    v.go_on(1.0)
    require(v.armed and abs(v.height) < 0.5, f"armed {v.armed} and {v.height:.1f} m high after 1 s")
    result = v.command(flying.ARM, 0.0)
    require(result == ACCEPTED, f"disarming: {result_name(result)}")
    v.until(lambda: not v.armed, HEARD_S, "disarmed by HEARTBEAT")
    return "armed, stood, disarmed"


@check(1, State.GROUND, "MAV_CMD_NAV_TAKEOFF: climbs to the altitude given, EXTENDED_SYS_STATE in the air")
def takeoff(v: Vehicle) -> str:
    taken = flying.take_off(v)
    relative = v.latest["GLOBAL_POSITION_INT"].relative_alt / 1000.0
    require(abs(v.height - HEIGHT_M) < 1.0, f"{v.height:.1f} m by LOCAL_POSITION_NED, {HEIGHT_M:g} asked for")
    require(abs(relative - v.height) < 1.5, f"relative_alt {relative:.1f} m, LOCAL_POSITION_NED {v.height:.1f} m")
    return f"{v.height:.2f} m after {taken:.1f} s"


@check(1, State.AIR, "PX4 Hold / Copter Guided Mode: stays where it is without setpoints")
def hold(v: Vehicle) -> str:
    begin = v.now.position
    with v.track() as samples:
        v.go_on(5.0)
    far = max(distance(s.position, begin) for s in samples)
    require(far < 1.0, f"it moved {far:.1f} m in 5 s")
    return f"moved at most {far:.2f} m in 5 s"


@check(1, State.AIR, "MAV_CMD_DO_SET_MODE; PX4 Offboard Mode / Copter Commands in Guided Mode: setpoints take control")
def external_control(v: Vehicle) -> str:
    begin = v.now.position
    take_control(v)
    v.go_on(3.0, velocity(v))
    require(v.mode == v.autopilot.external, f"custom_mode {v.mode:#x} after 3 s of setpoints")
    require(distance(v.now.position, begin) < 1.0, f"moved {distance(v.now.position, begin):.1f} m by zero velocity")
    return f"custom_mode {v.mode:#x}"


@check(1, State.AIR, "SET_POSITION_TARGET_LOCAL_NED, MAV_FRAME_LOCAL_NED: velocity north, then east")
def velocity_ned(v: Vehicle) -> str:
    take_control(v)
    seen = []
    for wanted in ((SPEED, 0.0, 0.0), (0.0, SPEED, 0.0)):
        samples = flown(v, velocity(v, *wanted), 6.0)
        seen.append(mean_velocity(samples, 2.0))
        near(seen[-1], wanted, "velocity")
    flying.stop(v)
    return " then ".join(vector(s) for s in seen) + " m/s"


@check(1, State.AIR, "SET_POSITION_TARGET_LOCAL_NED: velocity down is positive")
def velocity_down(v: Vehicle) -> str:
    take_control(v)
    up = mean_velocity(flown(v, velocity(v, 0.0, 0.0, -1.0), 4.0), 1.5)
    near(up, (0.0, 0.0, -1.0), "velocity")
    down = mean_velocity(flown(v, velocity(v, 0.0, 0.0, 1.0), 4.0), 1.5)
    near(down, (0.0, 0.0, 1.0), "velocity")
    v.go_on(2.0, velocity(v))
    return f"{-up[2]:.2f} m/s up, {down[2]:.2f} m/s down"


@check(1, State.AIR, "SET_POSITION_TARGET_LOCAL_NED: zero velocity brakes, and stays")
def zero_velocity(v: Vehicle) -> str:
    take_control(v)
    v.go_on(3.0, velocity(v, SPEED))
    require(v.now.speed > 0.5 * SPEED, f"{v.now.speed:.1f} m/s before braking")
    taken = flying.stop(v)
    begin = v.now.position
    v.go_on(3.0, velocity(v))
    require(distance(v.now.position, begin) < 1.0, f"it moved {distance(v.now.position, begin):.1f} m after it stood")
    return f"below {SLOW_MPS} m/s after {taken:.1f} s"


@check(1, State.AIR, "SET_POSITION_TARGET_LOCAL_NED.yaw: north is 0, clockwise [rad], by ATTITUDE")
def yaw(v: Vehicle) -> str:
    take_control(v)
    wanted = turned(v.yaw + math.pi / 2.0)
    taken = v.until(lambda: abs(turned(v.yaw - wanted)) < 0.1, 15.0, "yaw reached", velocity(v, yaw=wanted))
    v.go_on(2.0, velocity(v, yaw=wanted))
    off = math.degrees(turned(v.yaw - wanted))
    require(abs(off) < 6.0, f"yaw is {off:.0f} deg off after 2 s")
    return f"90 deg in {taken:.1f} s, {off:.1f} deg off then"


@check(1, State.AIR, "MAV_FRAME_BODY_NED: velocity turns with the vehicle")
def velocity_body(v: Vehicle) -> str:
    take_control(v)
    heading = math.pi / 2.0
    v.until(lambda: abs(turned(v.yaw - heading)) < 0.1, 15.0, "heading east", velocity(v, yaw=heading))
    forward = flown(v, lambda: setpoint(v, VELOCITY, (SPEED, 0.0, 0.0), frame=BODY_NED), 6.0)
    seen = mean_velocity(forward, 2.0)
    near(seen, (SPEED * math.cos(v.yaw), SPEED * math.sin(v.yaw), 0.0), "heading east, forward:")
    flying.stop(v)
    return f"heading {math.degrees(v.yaw):.0f} deg, forward: {vector(seen)} m/s"


@check(1, State.AIR, "SET_POSITION_TARGET_LOCAL_NED: a position is reached and held")
def position_ned(v: Vehicle) -> str:
    there = place(v, 6.0, -4.0, HEIGHT_M + 2.0)
    taken = go_to(v, there)
    v.go_on(4.0, lambda: setpoint(v, POSITION, position=there))
    off = distance(v.now.position, there)
    require(off < NEAR, f"{off:.2f} m from it, 4 s after it came near")
    return f"7.5 m in {taken:.1f} s, {off:.2f} m off then"


@check(1, State.AIR, "SET_POSITION_TARGET_LOCAL_NED: position with velocity, followed along a line")
def position_and_velocity(v: Vehicle) -> str:
    take_control(v)
    begin, begin_ms, heading = v.now.position, v.time_ms, v.yaw

    def where() -> Vec3:
        return begin[0] + 1.0 * (v.time_ms - begin_ms) / 1000.0, begin[1], begin[2]

    with v.track() as samples:
        v.go_on(7.0, lambda: setpoint(v, POSITION_VELOCITY_YAW, (1.0, 0.0, 0.0), where(), heading))
    seen = mean_velocity(samples, 2.0)
    near(seen, (1.0, 0.0, 0.0), "velocity along the line")
    off = distance(v.now.position, where())
    flying.stop(v)
    require(off < 1.0, f"{off:.1f} m behind a point that moves at 1 m/s")
    return f"{vector(seen)} m/s, {off:.2f} m from the moving point"


@check(1, State.AIR, "SET_POSITION_TARGET_GLOBAL_INT, MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: the place is reached")
def position_global(v: Vehicle) -> str:
    take_control(v)
    there = place(v, -5.0, 3.0, HEIGHT_M)
    latitude, longitude = plans.globe(v, -5.0, 3.0)
    base = v.latest["GLOBAL_POSITION_INT"].relative_alt / 1000.0 - v.height

    def stream() -> None:
        v.send(
            mavlink.MAVLink_set_position_target_global_int_message(
                v.time_ms, v.system, AUTOPILOT_COMPONENT, GLOBAL_RELATIVE, POSITION, latitude, longitude,
                HEIGHT_M + base, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            )
        )  # fmt: skip

    v.until(lambda: distance(v.now.position, there) < 1.0, 30.0, "place reached", stream)
    v.go_on(4.0, stream)
    off = distance(v.now.position, there)
    require(off < 1.0, f"{off:.2f} m from it, 4 s after it came near")
    return f"{off:.2f} m off"


@check(1, State.AIR, "SET_ATTITUDE_TARGET: a pitch is taken, and carries the vehicle forward")
def attitude(v: Vehicle) -> str:
    heading = v.yaw
    thrust = 0.5
    if not v.autopilot.thrust_is_climb:
        hover = parameters.read(v, "MPC_THR_HOVER")
        thrust = 0.5 if hover is None else hover.value
    take_control(v)
    begin = v.now.velocity
    half_pitch, half_yaw = -BANK / 2.0, heading / 2.0
    q = (
        math.cos(half_pitch) * math.cos(half_yaw),
        -math.sin(half_pitch) * math.sin(half_yaw),
        math.sin(half_pitch) * math.cos(half_yaw),
        math.cos(half_pitch) * math.sin(half_yaw),
    )

    def stream() -> None:
        v.send(
            mavlink.MAVLink_set_attitude_target_message(
                v.time_ms, v.system, AUTOPILOT_COMPONENT, 7, q, 0.0, 0.0, 0.0, thrust
            )
        )

    v.go_on(1.5, stream)
    pitch, now = v.latest["ATTITUDE"].pitch, v.now.velocity
    gained = (now[0] - begin[0]) * math.cos(heading) + (now[1] - begin[1]) * math.sin(heading)
    v.go_on(0.5, velocity(v, yaw=heading))
    flying.stop(v)
    require(abs(pitch + BANK) < math.radians(3.0), f"pitch {math.degrees(pitch):.1f} deg, -8 was asked for")
    require(0.3 < gained / (GRAVITY * BANK * 1.5) < 1.3, f"{gained:.1f} m/s forward after 1.5 s at 8 deg")
    return f"pitch {math.degrees(pitch):.1f} deg, {gained:.1f} m/s forward after 1.5 s"


@check(1, State.AIR, "LOCAL_POSITION_NED, GLOBAL_POSITION_INT: velocity is the change of position, in both")
def telemetry_agrees(v: Vehicle) -> str:
    take_control(v)
    begin = v.latest["GLOBAL_POSITION_INT"]
    samples = flown(v, velocity(v, SPEED, -SPEED), 4.0)
    end = v.latest["GLOBAL_POSITION_INT"]
    flying.stop(v)
    summed = [0.0, 0.0, 0.0]
    for a, b in pairwise(samples):
        for axis in range(3):
            summed[axis] += 0.5 * (a.velocity[axis] + b.velocity[axis]) * (b.time_s - a.time_s)
    moved = tuple(b - a for a, b in zip(samples[0].position, samples[-1].position, strict=True))
    off = math.dist(summed, moved)
    require(math.hypot(*moved) > 3.0, f"it moved only {math.hypot(*moved):.1f} m")
    require(off < 0.5, f"moved {off:.1f} m other than its velocity says")
    degrees = 1e-7 * math.radians(1.0) * plans.EARTH_M
    north = (end.lat - begin.lat) * degrees
    east = (end.lon - begin.lon) * degrees * math.cos(math.radians(end.lat * 1e-7))
    apart = math.hypot(north - moved[0], east - moved[1])
    require(apart < 1.5, f"GLOBAL_POSITION_INT moved {apart:.1f} m other than LOCAL_POSITION_NED")
    return f"{off:.2f} m between velocity and position, {apart:.2f} m between the two messages"


@check(1, State.AIR, "MAV_CMD_DO_REPOSITION in COMMAND_INT: goes there and holds")
def reposition(v: Vehicle) -> str:
    there = place(v, 5.0, 5.0)
    latitude, longitude = plans.globe(v, 5.0, 5.0)
    altitude = v.latest["GLOBAL_POSITION_INT"].alt / 1000.0 - v.height + HEIGHT_M
    result = v.command_int(192, 0, (-1.0, 1.0, 0.0, NAN), latitude, longitude, altitude)
    require(result == ACCEPTED, f"MAV_CMD_DO_REPOSITION: {result_name(result)}")
    taken = v.until(lambda: distance(v.now.position, there) < 1.0, 30.0, "place reached")
    v.go_on(4.0)
    off = distance(v.now.position, there)
    require(off < 1.5, f"{off:.1f} m from it 4 s later")
    return f"there after {taken:.1f} s, {off:.2f} m off"


@check(1, State.AIR, "MAV_CMD_NAV_LAND: descends where it is, EXTENDED_SYS_STATE on the ground, disarms by itself")
def land(v: Vehicle) -> str:
    begin = v.now.position
    result = v.command(flying.LAND, 0.0, 0.0, 0.0, NAN, NAN, NAN, 0.0)
    require(result == ACCEPTED, f"MAV_CMD_NAV_LAND: {result_name(result)}")
    taken = v.until(lambda: not v.armed, flying.DOWN_S, "landed and disarmed")
    v.until(lambda: v.landed == ON_GROUND, HEARD_S, "on the ground by EXTENDED_SYS_STATE")
    there = v.now.position
    off = math.hypot(there[0] - begin[0], there[1] - begin[1])
    require(off < 1.5, f"landed {off:.1f} m from where it was told to")
    require(abs(v.height) < 1.0, f"disarmed {v.height:.1f} m above where it took off")
    return f"down and disarmed after {taken:.1f} s, {off:.2f} m off"


@check(1, State.AIR, "MAV_CMD_NAV_RETURN_TO_LAUNCH: lands at home and disarms")
def return_to_launch(v: Vehicle) -> str:
    parameters.change(v, v.autopilot.return_settings)
    go_to(v, place(v, 8.0, 0.0))
    result = v.command(flying.RETURN)
    require(result == ACCEPTED, f"MAV_CMD_NAV_RETURN_TO_LAUNCH: {result_name(result)}")
    taken = v.until(lambda: not v.armed, 2.0 * flying.DOWN_S, "returned, landed and disarmed")
    here = v.now.position
    off = math.hypot(here[0] - v.start[0], here[1] - v.start[1])
    require(off < 1.5, f"landed {off:.1f} m from home")
    require(abs(v.height) < 1.0, f"disarmed {v.height:.1f} m above the ground")
    return f"down and disarmed after {taken:.1f} s, {off:.2f} m from home"
