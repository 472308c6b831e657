"""OFFBOARD setpoints: SET_POSITION_TARGET_LOCAL_NED."""

from sitl.frames import Message
from sitl.link import Link
from sitl.offboard import SetpointRefusedError, read_target
from sitl.physics import heading
from sitl.telemetry import Vehicle


def set_position_target_local_ned(v: Vehicle, _: Link, message: Message) -> None:
    """A setpoint that PX4 would not fly is told by STATUSTEXT and does not keep the stream alive."""
    try:
        target = read_target(
            frame=message.coordinate_frame,
            mask=message.type_mask,
            position=(message.x, message.y, message.z),
            velocity=(message.vx, message.vy, message.vz),
            acceleration=(message.afx, message.afy, message.afz),
            yaw=message.yaw,
            yaw_rate=message.yaw_rate,
            heading=heading(v.body.attitude),
        )
    except SetpointRefusedError as error:
        v.commander.say(str(error), 3)
        return
    v.commander.receive(target)
