"""What a control client may ask of a vehicle besides moving its clock: request word -> handler.

A handler gets the vehicle's autopilot and the rest of the line, and returns the answer; ValueError is answered as
`error <why>`.
"""

import json
from collections.abc import Callable

from sitl.autopilot import Autopilot
from sitl.injection import inject

Handler = Callable[[Autopilot, str], str]


def counters(autopilot: Autopilot, argument: str) -> str:
    """What every link has counted, as one line of JSON: link name and number -> counter -> value."""
    if argument:
        raise ValueError(f"counters: takes no argument, not {argument!r}")
    return f"counters {json.dumps(autopilot.network.counters(), sort_keys=True)}"


VEHICLE_REQUESTS: dict[str, Handler] = {"counters": counters, "inject": inject}
