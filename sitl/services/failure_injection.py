"""MAV_CMD_INJECT_FAILURE: PX4's way of injecting faults, behind SYS_FAILURE_EN. ArduPilot does not know it.

What PX4's simulators can do is done here; every other unit or type is UNSUPPORTED.
"""

import math

from sitl.flight.sensors import Loss
from sitl.links.link import Link
from sitl.personality import CRITICAL, Result
from sitl.services.command import Command
from sitl.vehicle import Vehicle

BATTERY, MOTOR = 100, 101
LOSSES: dict[float, Loss] = {4: Loss.GPS, 104: Loss.STICKS, 105: Loss.GCS}
"""FAILURE_UNIT."""
OK, OFF = 0.0, 1.0
"""FAILURE_TYPE."""
SWITCH = "SYS_FAILURE_EN"


def inject_failure(v: Vehicle, _: Link, command: Command) -> Result:
    """param1 FAILURE_UNIT, param2 FAILURE_TYPE, param3 the motor from 1, 0 = all."""
    if SWITCH not in v.parameters:
        return Result.UNSUPPORTED
    if not v.parameters[SWITCH]:
        v.commander.say(f"Failure injection is disabled, {SWITCH} is 0", CRITICAL)
        return Result.DENIED
    unit, kind, instance = command.p[:3]
    if kind not in (OK, OFF):
        return Result.UNSUPPORTED
    model = v.model
    until = math.inf if kind == OFF else 0.0
    if unit in LOSSES:
        model.faults.lose(LOSSES[unit], until)
    elif unit == BATTERY:
        v.commander.battery.leave(0.0 if kind == OFF else 1.0)
    elif unit == MOTOR and instance in range(5):
        motors = range(4) if instance == 0.0 else [int(instance) - 1]
        for motor in motors:
            model.faults.motors[motor] = 1.0 - kind
        if kind == OK and instance == 0.0:
            model.repair()
    else:
        return Result.UNSUPPORTED
    return Result.ACCEPTED
