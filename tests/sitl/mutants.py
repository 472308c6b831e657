"""Autopilots that are wrong in one way each: a wire that spoils what passes it, in front of a right one.

Each names the checks that must fail because of it.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance.vehicle import OWN_COMPONENT, OWN_SYSTEM
from tests.sitl.stepped_wire import SteppedWire

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
ARM, TAKEOFF, LAND, RETURN, MODE, INTERVAL, REPOSITION = 400, 22, 21, 20, 176, 511, 192
SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"
SETPOINTS = (SETPOINT, "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
NUMBERS = {kind.msgname: number for number, kind in mavlink.mavlink_map.items()}
NUMBERS["PROTOCOL_VERSION"] = 300

Spoil = Callable[["Spoiled", object], object]
"""Changes a message in place and returns it, or returns None to swallow it, or several messages."""


@dataclass(frozen=True)
class Mutant:
    """`outward` spoils what the kit sends, `inward` what the vehicle sends: message name -> what is done to it."""

    name: str
    kills: tuple[str, ...]
    outward: dict[str, Spoil] = field(default_factory=dict)
    inward: dict[str, Spoil] = field(default_factory=dict)
    frames: Callable[["Spoiled", bytes], Iterable[bytes]] | None = None
    """Done to every frame of the kit before."""
    each_step: Callable[["Spoiled"], None] | None = None
    """Done whenever the vehicle moves on."""
    along: tuple[str, ...] = ()
    """Checks that must run too, before those that fail."""
    personality: str = "px4"
    parameters: dict[str, float] = field(default_factory=dict)


class Spoiled(SteppedWire):
    """A wire with a mutant on it."""

    def __init__(self, mutant: Mutant) -> None:
        super().__init__(mutant.personality, self.to_vehicle, self.to_kit, **mutant.parameters)
        self.mutant = mutant
        self.memory: dict = {}
        self._answers: list[bytes] = []
        self._kit = mavlink.MAVLink(None, srcSystem=OWN_SYSTEM, srcComponent=OWN_COMPONENT)
        self._vehicle = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    def to_vehicle(self, frame: bytes) -> Iterable[bytes]:
        frames = [frame] if self.mutant.frames is None else self.mutant.frames(self, frame)
        return [out for one in frames for out in self._spoiled(one, self.mutant.outward, self._kit)]

    def to_kit(self, frame: bytes) -> Iterable[bytes]:
        return self._spoiled(frame, self.mutant.inward, self._vehicle)

    def _spoiled(self, frame: bytes, spoils: dict[str, Spoil], codec) -> list[bytes]:
        spoil = {NUMBERS[name]: spoil for name, spoil in spoils.items()}.get(int.from_bytes(frame[7:10], "little"))
        if spoil is None or frame[0] != 0xFD:
            return [frame]
        if spoil is swallow:
            return []
        try:
            message = codec.decode(bytearray(frame))
        except mavlink.MAVError:
            return [frame]
        spoiled = spoil(self, message)
        messages = spoiled if isinstance(spoiled, list) else [spoiled]
        return [m if isinstance(m, bytes) else bytes(m.pack(codec)) for m in messages if m is not None]

    def receive(self, timeout_s: float) -> list[bytes]:
        if self.mutant.each_step is not None:
            self.mutant.each_step(self)
        answers, self._answers = self._answers, []
        return answers or super().receive(timeout_s)

    def answer(self, message) -> None:
        """Tell the kit something that the vehicle never said."""
        self._answers.append(bytes(message.pack(self._vehicle)))

    def lie(self, command: int) -> None:
        self.answer(mavlink.MAVLink_command_ack_message(command, ACCEPTED, 0, 0, OWN_SYSTEM, OWN_COMPONENT))


def swallow(_wire, _message):
    return None


def setting(**values):
    """These fields always have these values."""

    def spoil(_wire, message):
        for name, value in values.items():
            setattr(message, name, value)
        return message

    return spoil


def adding(**values):
    def spoil(_wire, message):
        for name, value in values.items():
            setattr(message, name, getattr(message, name) + value)
        return message

    return spoil


def scaling(**values):
    def spoil(_wire, message):
        for name, value in values.items():
            setattr(message, name, getattr(message, name) * value)
        return message

    return spoil


def only_accepting(*commands):
    """These commands are acknowledged, and not done."""

    def spoil(wire, message):
        if message.command not in commands:
            return message
        wire.lie(message.command)
        return None

    return spoil


def changed(command, **values):
    """A command's parameters are others than those asked for."""

    def spoil(wire, message):
        return setting(**values)(wire, message) if message.command == command else message

    return spoil


def where(condition, spoil):
    return lambda wire, message: spoil(wire, message) if condition(message) else message


def every(number, spoil):
    """Only every so many messages."""

    def spoil_some(wire, message):
        wire.memory["count"] = wire.memory.get("count", 0) + 1
        return spoil(wire, message) if wire.memory["count"] % number == 0 else message

    return spoil_some


def east_for_north(_wire, message):
    message.vx, message.vy = message.vy, message.vx
    return message


def numbers_for_nan(_wire, message):
    message.vx = 3.0 if math.isnan(message.vx) else message.vx
    return message


def pitch_up(_wire, message):
    w, x, y, z = message.q
    message.q = [w, -x, -y, z]
    return message


def remember(wire, message):
    """Setpoints go on after the client has stopped sending them, as a client library may do."""
    wire.memory["last"] = message
    return message


def repeat(wire):
    if "last" in wire.memory:
        wire.direct.send(wire.memory["last"])


def drift(wire, message):
    message.x += 0.7 * message.time_boot_ms / 1000.0
    return message


def frozen(wire, message):
    first = wire.memory.setdefault("first", (message.x, message.y, message.z))
    message.x, message.y, message.z = first
    return message


def repaired(_wire, frame):
    """A parser that does not look at checksums."""
    codec = mavlink.MAVLink(None, srcSystem=OWN_SYSTEM, srcComponent=OWN_COMPONENT)
    if len(frame) > 12 and frame[0] == 0xFD and len(frame) == frame[1] + 12:
        kind = mavlink.mavlink_map.get(int.from_bytes(frame[7:10], "little"))
        if kind is not None:
            crc = mavlink.x25crc(frame[1:-2])
            crc.accumulate(bytes([kind.crc_extra]))
            frame = frame[:-2] + crc.crc.to_bytes(2, "little")
            codec.decode(bytearray(frame))
    return [frame]


def old_frame(_wire, message):
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=True))


def twice(_wire, message):
    return [message, message]


def arm_first(wire, message):
    if message.command == TAKEOFF:
        return [mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *[0.0] * 6), message]
    return message


def set_in_words_only(wire, message):
    """PARAM_SET is told back, and not kept."""
    name = message.param_id
    wire.answer(mavlink.MAVLink_param_value_message(name.encode(), message.param_value, message.param_type, 100, 65535))


def to_another_name(_wire, message):
    if message.param_id == "NO_SUCH_THING":
        message.param_id = "COM_OF_LOSS_T"
        return mavlink.MAVLink_param_request_read_message(1, 1, b"COM_OF_LOSS_T", -1)
    return message


def cleared_in_words_only(wire, message):
    wire.answer(mavlink.MAVLink_mission_ack_message(OWN_SYSTEM, OWN_COMPONENT, 0, message.mission_type))


def another_value_by_index(wire, message):
    """What is asked by index is told with another value."""
    if wire.memory.pop("by index", False):
        message.param_value += 1.0
    return message


def note_index(wire, message):
    wire.memory["by index"] = message.param_index >= 0
    return message


def mask_of_velocity(message):
    return message.type_mask in (2503, 3527)


STILL = scaling(vx=0.0, vy=0.0, vz=0.0)
UNKNOWN_ITEM = where(lambda m: m.command == 45678, setting(command=16))

MUTANTS = (
    Mutant("heartbeat comes half as often", ("heartbeat",), inward={"HEARTBEAT": every(2, swallow)}),
    Mutant("a fixed wing", ("heartbeat",), inward={"HEARTBEAT": setting(type=1)}),
    Mutant("speaks MAVLink 1", ("mavlink 2",), inward={"ATTITUDE": old_frame}),
    Mutant("no version", ("version",), inward={"AUTOPILOT_VERSION": swallow}),
    Mutant("no protocol version", ("protocol version",), inward={"PROTOCOL_VERSION": swallow}),
    Mutant("no ping", ("ping",), inward={"PING": swallow}),
    Mutant("timesync tells its own time only", ("timesync", "garbage"), inward={"TIMESYNC": setting(ts1=5)}),
    Mutant("timesync stands still", ("timesync",), inward={"TIMESYNC": setting(tc1=5)}),
    Mutant(
        "intervals are halved",
        ("message interval", "interval is told"),
        outward={"COMMAND_LONG": where(lambda m: m.command == INTERVAL, scaling(param2=0.5))},
    ),
    Mutant("home is elsewhere", ("home",), inward={"HOME_POSITION": adding(latitude=5000)}),
    Mutant("in the air on the ground", ("on the ground",), inward={"EXTENDED_SYS_STATE": setting(landed_state=2)}),
    Mutant("answers twice", ("command is answered",), inward={"COMMAND_ACK": twice}),
    Mutant("answers to somebody else", ("command is answered",), inward={"COMMAND_ACK": setting(target_system=9)}),
    Mutant(
        "the clock goes back",
        ("clock",),
        inward={"ATTITUDE": every(7, adding(time_boot_ms=-500))},
        along=("on the ground",),
    ),
    Mutant("acknowledges arming only", ("arm and disarm", "takeoff"), outward={"COMMAND_LONG": only_accepting(ARM)}),
    Mutant("acknowledges takeoff only", ("takeoff",), outward={"COMMAND_LONG": only_accepting(TAKEOFF)}),
    Mutant("acknowledges landing only", ("land",), outward={"COMMAND_LONG": only_accepting(LAND)}),
    Mutant("acknowledges return only", ("return to launch",), outward={"COMMAND_LONG": only_accepting(RETURN)}),
    Mutant("acknowledges goto only", ("reposition",), outward={"COMMAND_INT": only_accepting(REPOSITION)}),
    Mutant(
        "acknowledges modes only",
        ("external control", "mission flown", "mission paused"),
        outward={"COMMAND_LONG": only_accepting(MODE)},
    ),
    Mutant(
        "climbs too high",
        ("takeoff",),
        outward={"COMMAND_LONG": where(lambda m: m.command == TAKEOFF, adding(param7=4))},
    ),
    Mutant("says where it took off, not where it is", ("takeoff",), inward={"LOCAL_POSITION_NED": frozen}),
    Mutant("wanders off", ("hold",), inward={"LOCAL_POSITION_NED": drift}),
    Mutant(
        "takes no setpoints",
        ("external control", "velocity ned", "position ned", "stream lost", "fence holds"),
        outward=dict.fromkeys(SETPOINTS, swallow),
    ),
    Mutant(
        "keeps the mode, does not move",
        ("velocity ned", "velocity down", "velocity body", "telemetry agrees", "huge velocity", "zero velocity"),
        outward={SETPOINT: where(mask_of_velocity, STILL)},
    ),
    Mutant("takes east for north", ("velocity ned", "velocity body"), outward={SETPOINT: east_for_north}),
    Mutant("takes up for down", ("velocity down",), outward={SETPOINT: scaling(vz=-1.0)}),
    Mutant("does not brake", ("zero velocity", "external control"), outward={SETPOINT: adding(vy=1.5)}),
    Mutant("keeps its yaw", ("yaw",), outward={SETPOINT: setting(yaw=0.0)}),
    Mutant("is off by three metres", ("position ned", "position and velocity"), outward={SETPOINT: adding(x=3.0)}),
    Mutant(
        "is off on the globe",
        ("position global",),
        outward={"SET_POSITION_TARGET_GLOBAL_INT": adding(lat_int=300)},
    ),
    Mutant("pitches the wrong way", ("attitude",), outward={"SET_ATTITUDE_TARGET": pitch_up}),
    Mutant("tells too high a speed", ("telemetry agrees",), inward={"LOCAL_POSITION_NED": scaling(vx=1.3, vy=1.3)}),
    Mutant(
        "loses a parameter",
        ("parameter list",),
        inward={"PARAM_VALUE": where(lambda m: m.param_index == 7, swallow)},
    ),
    Mutant(
        "tells another value by index",
        ("parameter read",),
        outward={"PARAM_REQUEST_READ": note_index},
        inward={"PARAM_VALUE": another_value_by_index},
    ),
    Mutant("keeps no parameter", ("parameter set", "parameter acts"), outward={"PARAM_SET": set_in_words_only}),
    Mutant(
        "tells integers by value",
        ("parameter integer",),
        inward={"PARAM_VALUE": where(lambda m: m.param_type == 6, setting(param_value=2.0))},
    ),
    Mutant(
        "answers for names that are not there",
        ("unknown parameter",),
        outward={"PARAM_REQUEST_READ": to_another_name, "PARAM_SET": swallow},
    ),
    Mutant(
        "shifts items up",
        ("mission transfer", "mission flown"),
        outward={"MISSION_ITEM_INT": where(lambda m: m.mission_type == 0, adding(z=4.0))},
    ),
    Mutant("tells no progress", ("mission flown",), inward={"MISSION_ITEM_REACHED": swallow}),
    Mutant("clears nothing", ("mission clear", "fence transfer"), outward={"MISSION_CLEAR_ALL": cleared_in_words_only}),
    Mutant("takes any item", ("mission refused",), outward={"MISSION_ITEM_INT": UNKNOWN_ITEM}),
    Mutant(
        "does nothing about the fence",
        ("fence holds",),
        outward={"PARAM_SET": where(lambda m: m.param_id == "GF_ACTION", setting(param_value=0.0))},
    ),
    Mutant(
        "refuses rally points by the wrong word",
        ("rally points",),
        inward={"MISSION_ACK": where(lambda m: m.mission_type == 2, setting(type=1))},
    ),
    Mutant(
        "arms whatever the checks say",
        ("arm before ready",),
        outward={"COMMAND_LONG": changed(ARM, param2=21196.0)},
    ),
    Mutant(
        "accepts everything",
        (
            "arm before ready",
            "unknown command",
            "unknown message",
            "disarm in the air",
            "control without stream",
            "mission without items",
        ),
        inward={"COMMAND_ACK": setting(result=ACCEPTED)},
    ),
    Mutant(
        "disarms in the air",
        ("disarm in the air",),
        outward={"COMMAND_LONG": where(lambda m: m.command == ARM and m.param1 == 0.0, setting(param2=21196.0))},
    ),
    Mutant(
        "obeys what is for others",
        ("foreign system", "foreign component", "foreign setpoints"),
        outward=dict.fromkeys(("COMMAND_LONG", SETPOINT), setting(target_system=1, target_component=1)),
    ),
    Mutant(
        "arms by any value",
        ("arm by another value",),
        outward={"COMMAND_LONG": where(lambda m: m.command == ARM and m.param1 == 2.0, setting(param1=1.0))},
    ),
    Mutant("takes off disarmed", ("takeoff disarmed",), outward={"COMMAND_LONG": arm_first}),
    Mutant("believes bad checksums", ("garbage",), frames=repaired),
    Mutant("takes NaN for a number", ("nan velocity",), outward={SETPOINT: numbers_for_nan}),
    Mutant(
        "takes any frame for its own", ("wrong frame", "velocity body"), outward={SETPOINT: setting(coordinate_frame=1)}
    ),
    Mutant("tilts as far as it can", ("huge velocity",), parameters={"MPC_TILTMAX_AIR": 80.0, "MPC_ACC_HOR_MAX": 15.0}),
    Mutant(
        "flies the last setpoint for ever",
        ("stream lost", "parameter acts", "control without stream"),
        outward={SETPOINT: remember},
        each_step=repeat,
        along=("external control",),
    ),
    Mutant(
        "accepts any value to arm by, as Copter",
        ("arm by another value",),
        inward={"COMMAND_ACK": setting(result=ACCEPTED)},
        personality="arducopter",
    ),
    Mutant(
        "flies the last velocity for ever, as Copter",
        ("stream lost",),
        outward={SETPOINT: remember},
        each_step=repeat,
        personality="arducopter",
    ),
)
