"""Level 0: what every client does first."""

import struct

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance.checks import State, check
from sitl.conformance.flying import result_name
from sitl.conformance.outcome import Failed, Skipped, require
from sitl.conformance.vehicle import AUTOPILOT_COMPONENT, ON_GROUND, OWN_COMPONENT, OWN_SYSTEM, Message, Vehicle

MULTIROTORS = frozenset({2, 3, 4, 13, 14, 15, 29})
"""MAV_TYPE."""
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE


@check(0, State.ANY, "Heartbeat/Connection Protocol: HEARTBEAT once a second, of the autopilot's component")
def heartbeat(v: Vehicle) -> str:
    with v.hear("HEARTBEAT") as heard:
        v.go_on(6.0)
    beat = v.latest["HEARTBEAT"]
    require(beat.type in MULTIROTORS, f"HEARTBEAT.type {beat.type} is no multirotor")
    require(beat.autopilot == v.autopilot.number, f"HEARTBEAT.autopilot {beat.autopilot} is not {v.autopilot.name}")
    require(beat.mavlink_version == 3, f"HEARTBEAT.mavlink_version {beat.mavlink_version} is not 3")
    require(4 <= len(heard) <= 9, f"{len(heard)} HEARTBEATs in 6 s")
    return f"{len(heard)} in 6 s, system {v.system}"


@check(0, State.ANY, "MAVLink Versions: MAVLink 2 frames for a client that speaks it")
def mavlink_2(v: Vehicle) -> str:
    before = v.old_frames
    v.go_on(1.0)
    require(v.old_frames == before, f"{v.old_frames - before} MAVLink 1 frames in 1 s")
    return "no MAVLink 1 frame in 1 s"


@check(0, State.ANY, "MAV_CMD_REQUEST_MESSAGE, AUTOPILOT_VERSION.capabilities")
def version(v: Vehicle) -> str:
    with v.hear("AUTOPILOT_VERSION") as heard:
        result = v.command(REQUEST, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        require(result == mavlink.MAV_RESULT_ACCEPTED, f"MAV_CMD_REQUEST_MESSAGE: {result_name(result)}")
        require(v.answered(lambda: heard), "ACCEPTED, but no AUTOPILOT_VERSION came")
    told = heard[-1]
    require(bool(told.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2), "no MAVLINK2 in capabilities")
    major, minor, patch = (told.flight_sw_version >> shift & 0xFF for shift in (24, 16, 8))
    return f"{v.autopilot.name} {major}.{minor}.{patch}, capabilities {told.capabilities:#x}"


@check(0, State.ANY, "MAVLink Versions: PROTOCOL_VERSION on request")
def protocol_version(v: Vehicle) -> str:
    result = v.command(REQUEST, 300.0)
    if result != mavlink.MAV_RESULT_ACCEPTED:
        raise Skipped(f"PROTOCOL_VERSION is not sent: {result_name(result)}")
    require(v.answered(lambda: v.protocol_version), "ACCEPTED, but no PROTOCOL_VERSION came")
    spoken, lowest, highest = struct.unpack_from("<HHH", v.protocol_version)
    require(lowest <= spoken <= highest and highest >= 200, f"{lowest} to {highest}, spoken {spoken}")
    return f"{lowest / 100:g} to {highest / 100:g}, spoken {spoken / 100:g}"


@check(0, State.ANY, "Time Synchronization Protocol v2: TIMESYNC with tc1 = 0 is answered, ts1 mirrored")
def timesync(v: Vehicle) -> str:
    def ask(mark: int) -> Message:
        with v.hear("TIMESYNC") as heard:
            v.send(mavlink.MAVLink_timesync_message(0, mark))
            if not v.answered(lambda: any(m.ts1 == mark and m.tc1 for m in heard)):
                raise Failed("TIMESYNC: no answer with our ts1")
            return next(m for m in heard if m.ts1 == mark and m.tc1)

    first, at_ms = ask(1_234_567_890_123), v.time_ms
    v.go_on(2.0)
    second, later_ms = ask(1_234_567_999_999), v.time_ms
    by_sync, by_boot = (second.tc1 - first.tc1) / 1e9, (later_ms - at_ms) / 1000.0
    require(abs(by_sync - by_boot) < 0.5, f"tc1 moved {by_sync:.2f} s, time_boot_ms {by_boot:.2f} s")
    return f"tc1 moved {by_sync:.2f} s while time_boot_ms moved {by_boot:.2f} s"


@check(0, State.ANY, "Ping Protocol: a PING to nobody in particular is answered to its sender")
def ping(v: Vehicle) -> str:
    with v.hear("PING") as heard:
        v.send(mavlink.MAVLink_ping_message(987_654_321, 77, 0, 0))
        answered = v.answered(lambda: any(m.seq == 77 and m.target_system == OWN_SYSTEM for m in heard))
    if not answered and v.autopilot.name == "arducopter":
        raise Skipped("ArduPilot need not answer PING")
    require(answered, "PING: no answer to us with our seq")
    reply = heard[-1]
    require(
        reply.time_usec == 987_654_321 and reply.target_component == OWN_COMPONENT, "PING: time or target not mirrored"
    )
    return "answered"


@check(0, State.GROUND, "MAV_CMD_SET_MESSAGE_INTERVAL, by the message's own time_boot_ms")
def message_interval(v: Vehicle) -> str:
    result = v.set_interval("LOCAL_POSITION_NED", 10.0)
    require(result == mavlink.MAV_RESULT_ACCEPTED, f"MAV_CMD_SET_MESSAGE_INTERVAL: {result_name(result)}")
    v.go_on(0.5)
    with v.track() as samples:
        v.go_on(3.0)
    v.set_interval("LOCAL_POSITION_NED", 20.0)
    require(len(samples) > 2, f"{len(samples)} LOCAL_POSITION_NED in 3 s")
    rate = (len(samples) - 1) / (samples[-1].time_s - samples[0].time_s)
    require(8.0 <= rate <= 12.5, f"10 Hz were asked for, {rate:.1f} Hz came")
    with v.track() as samples:
        v.go_on(3.0)
    again = (len(samples) - 1) / (samples[-1].time_s - samples[0].time_s)
    require(15.0 <= again <= 25.0, f"20 Hz were asked for, {again:.1f} Hz came")
    return f"{rate:.1f} Hz for 10, {again:.1f} Hz for 20"


@check(0, State.GROUND, "MAV_CMD_GET_MESSAGE_INTERVAL, MESSAGE_INTERVAL")
def interval_is_told(v: Vehicle) -> str:
    with v.hear("MESSAGE_INTERVAL") as heard:
        number = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
        v.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, number)
        require(
            v.answered(lambda: [m for m in heard if m.message_id == number]), "no MESSAGE_INTERVAL of what was asked"
        )
    told = next(m for m in heard if m.message_id == number).interval_us
    require(abs(told - 50_000) <= 10_000, f"20 Hz were set, {told} us are told")
    return f"{told} us for 20 Hz"


@check(0, State.GROUND, "HOME_POSITION, GLOBAL_POSITION_INT: where it is, and where home is")
def home(v: Vehicle) -> str:
    told = v.request("HOME_POSITION")
    if told is None:
        raise Failed("HOME_POSITION: not sent on request")
    there = v.latest.get("GLOBAL_POSITION_INT")
    if there is None:
        raise Failed("GLOBAL_POSITION_INT: not sent")
    off = max(abs(told.latitude - there.lat), abs(told.longitude - there.lon)) * 1e-7 * 111_000.0
    require(off < 20.0, f"home is {off:.0f} m from where it stands")
    return f"home {off:.1f} m away, {there.lat * 1e-7:.6f}, {there.lon * 1e-7:.6f}"


@check(0, State.GROUND, "EXTENDED_SYS_STATE.landed_state, HEARTBEAT.base_mode: on the ground, disarmed")
def on_the_ground(v: Vehicle) -> str:
    require(v.landed == ON_GROUND, f"landed_state {v.landed} is not ON_GROUND")
    before = v.now
    v.go_on(2.0)
    moved = max(abs(a - b) for a, b in zip(before.position, v.now.position, strict=True))
    require(moved < 1.0, f"it moved {moved:.1f} m in 2 s on the ground")
    return f"moved {moved:.2f} m in 2 s"


@check(0, State.ANY, "Command Protocol: MAV_COMP_ID_AUTOPILOT1 answers a command once, addressed to its sender")
def command_is_answered(v: Vehicle) -> str:
    with v.hear("COMMAND_ACK") as acks:
        number = mavlink.MAVLINK_MSG_ID_SYS_STATUS
        v.send(
            mavlink.MAVLink_command_long_message(
                v.system, AUTOPILOT_COMPONENT, REQUEST, 0, number, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )
        v.go_on(1.5)
    ours = [ack for ack in acks if ack.command == REQUEST]
    require(len(ours) == 1, f"{len(ours)} COMMAND_ACKs of one command")
    to = (ours[0].target_system, ours[0].target_component)
    require(to in ((OWN_SYSTEM, OWN_COMPONENT), (0, 0)), f"COMMAND_ACK is for {to[0]}/{to[1]}, not for us")
    return f"one COMMAND_ACK, to {to[0]}/{to[1]}"
