"""The autopilots that we fly."""

from typing import Literal

from autopilot_bridge.dialects import Dialect
from autopilot_bridge.dialects.arducopter import ARDUCOPTER
from autopilot_bridge.dialects.px4 import PX4

DialectName = Literal["auto", "px4", "arducopter"]


def dialects(name: DialectName) -> dict[int, Dialect]:
    """By MAV_AUTOPILOT: the one named, or all that we fly."""
    return {dialect.autopilot: dialect for dialect in (PX4, ARDUCOPTER) if name in ("auto", dialect.name)}
