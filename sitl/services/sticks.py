"""A pilot's sticks: MANUAL_CONTROL of a joystick, RC_CHANNELS_OVERRIDE of a radio."""

from sitl.flight.sensors import Loss
from sitl.links.frames import Message
from sitl.links.link import Link
from sitl.targets import Sticks
from sitl.vehicle import Vehicle

FULL = 1000.0
"""Full deflection in MANUAL_CONTROL."""
MIDDLE_US, SPAN_US = 1500.0, 400.0
"""Pulses of RC_CHANNELS_OVERRIDE: 1100 to 1900 us."""
UNUSED_US = (0, 65535)
"""A channel that is given back to the radio, or left as it is."""


def unit(value: float) -> float:
    return min(max(value, -1.0), 1.0)


def manual_control(v: Vehicle, _: Link, m: Message) -> None:
    """x forward, y right, r clockwise from -1000 to 1000; z from 0 to 1000. Axes out of range are not there."""
    if m.target not in (0, int(v.parameters[v.personality.system_id])) or v.model.faults.lost(Loss.STICKS, v.now_ms):
        return
    axes = (m.x, m.y, m.z, m.r)
    if any(abs(value) > FULL for value in axes):
        return
    forward, right, throttle, yaw = (value / FULL for value in axes)
    v.commander.pilot(Sticks(unit(forward), unit(right), unit(2.0 * throttle - 1.0), unit(yaw)), radio=False)


def rc_channels_override(v: Vehicle, _: Link, m: Message) -> None:
    """Channels 1 to 4: roll, pitch (low is forward), throttle, yaw."""
    if v.model.faults.lost(Loss.STICKS, v.now_ms):
        return
    pulses = (m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw)
    if all(pulse in UNUSED_US for pulse in pulses):
        v.commander.pilot(None, radio=True)
        return
    roll, pitch, throttle, yaw = (
        0.0 if pulse in UNUSED_US else unit((pulse - MIDDLE_US) / SPAN_US) for pulse in pulses
    )
    v.commander.pilot(Sticks(-pitch, roll, throttle, yaw), radio=True)
