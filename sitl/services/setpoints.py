"""Setpoints: SET_POSITION_TARGET_LOCAL_NED."""

from sitl.frames import Message
from sitl.link import Link
from sitl.targets import PositionTarget
from sitl.vehicle import Vehicle


def set_position_target_local_ned(v: Vehicle, _: Link, message: Message) -> None:
    """What is flown of it is the commander's to say."""
    v.commander.receive(
        PositionTarget(
            frame=message.coordinate_frame,
            mask=message.type_mask,
            position=(message.x, message.y, message.z),
            velocity=(message.vx, message.vy, message.vz),
            acceleration=(message.afx, message.afy, message.afz),
            yaw=message.yaw,
            yaw_rate=message.yaw_rate,
        )
    )
