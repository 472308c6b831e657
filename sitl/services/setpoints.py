"""Setpoints: SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT, SET_ATTITUDE_TARGET.

What is flown of them is the commander's to say.
"""

from sitl.flight.reference import Vec3
from sitl.links.frames import Message
from sitl.links.link import Link
from sitl.plan import AMSL_FRAMES, RELATIVE_FRAMES
from sitl.targets import AttitudeTarget, PositionTarget
from sitl.vehicle import Vehicle

LOCAL_NED = 1


def set_position_target_local_ned(v: Vehicle, _: Link, message: Message) -> None:
    v.commander.receive(position_target(message, message.coordinate_frame, (message.x, message.y, message.z)))


def set_position_target_global_int(v: Vehicle, _: Link, message: Message) -> None:
    """The same on the globe; velocities and accelerations are north, east, down."""
    frame = message.coordinate_frame
    north, east = v.origin.local(message.lat_int * 1e-7, message.lon_int * 1e-7)
    if frame in AMSL_FRAMES:
        place = (north, east, v.origin.altitude - message.alt)
    elif frame in RELATIVE_FRAMES and v.commander.home is not None:
        place = (north, east, v.commander.home[2] - message.alt)
    else:
        v.commander.say(f"SET_POSITION_TARGET_GLOBAL_INT coordinate frame {frame} unsupported", 3)
        return
    v.commander.receive(position_target(message, LOCAL_NED, place))


def position_target(m: Message, frame: int, position: Vec3) -> PositionTarget:
    return PositionTarget(
        frame=frame,
        mask=m.type_mask,
        position=position,
        velocity=(m.vx, m.vy, m.vz),
        acceleration=(m.afx, m.afy, m.afz),
        yaw=m.yaw,
        yaw_rate=m.yaw_rate,
        message=m.get_type(),
    )


def set_attitude_target(v: Vehicle, _: Link, m: Message) -> None:
    w, x, y, z = m.q
    rates = (m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate)
    v.commander.receive_attitude(AttitudeTarget(m.type_mask, (w, x, y, z), rates, m.thrust))
