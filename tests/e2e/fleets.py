"""What the tests of several vehicles fly, and how they look at it."""

import math
import queue
import time
from bisect import bisect
from collections import Counter

import pytest

from bus import topics
from mission import flight_log

SPACING_M, SEPARATION_M = 14.0, 5.0
FLEET = {
    "seed": 85,  # three random walks that, flown without a separation, come within 3.4, 5.3 and 5.7 m of one another
    "scenario": {
        "preset": "physical_small",
        "box_enu": [[-30, 30], [-8, 8], [10, 18]],
        "start_enu": [0, 0, 12],
    },
    "speed": 3,
    "slots": 12,
    "policy": {"kind": "random"},
    "limits": {"horizontal_mps": 5, "separation_m": SEPARATION_M},
    "at_end": "land",
    "vehicles_spacing_m": SPACING_M,
}
PATIENCE_S = 120.0


def fleet(count, **changes):
    return FLEET | {"vehicles": [{"name": name} for name in "abcdef"[:count]]} | changes


def logs(flight, names):
    return {name: flight_log.read(flight.run / name) for name in names}


def paths(recorded):
    """Of each vehicle: (vehicle time, east, north) about the first one's home. One simulator, so one vehicle time."""
    return {
        name: [
            (state.time_s, state.position_enu[0] + nth * SPACING_M, state.position_enu[1])
            for state in log.messages(topics.STATE)
            if state.phase in ("transit", "slots", "holding")
        ]
        for nth, (name, log) in enumerate(recorded.items())
    }


def gaps(first, second):
    """Distances in plan at each time of the first path at which the second is known, interpolated."""
    times = [time_s for time_s, *_ in second]
    for time_s, *place in first:
        after = bisect(times, time_s)
        if 0 < after < len(times):
            (t0, *p0), (t1, *p1) = second[after - 1], second[after]
            share = (time_s - t0) / (t1 - t0)
            yield math.dist(place, [a + share * (b - a) for a, b in zip(p0, p1, strict=True)])


def await_slot(flight, name, slot):
    opened = queue.SimpleQueue()
    bridge(flight, name)
    with flight.session() as session:
        keep = topics.subscribe(session, name, topics.SLOT, opened.put, Counter())
        while opened.get(timeout=PATIENCE_S).slot < slot:
            pass
        del keep


def bridge(flight, name):
    """Its process id, once it is there."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        for pid, line in flight.processes().items():
            if line[2:4] == ["mission", "bridge"] and line[line.index("--vehicle") + 1] == name:
                return pid
        assert flight.process.poll() is None, flight.text
        time.sleep(0.02)
    pytest.fail(f"no bridge of {name}:\n{flight.text}")
