"""A flight of the matrix over a UDP relay, paced by the clock of its autopilot."""

from contextlib import ExitStack, contextmanager
from types import SimpleNamespace

from tests.failure_matrix.case import AUTOPILOTS, Case
from tests.failure_matrix.relay import MavlinkRelay
from tests.sitl.process import free_udp_port, sitl_process, step

SPEED = 5.0
FROM_SLOT = 2
LOST_S = 2.0
"""COM_OF_LOSS_T: a busy machine's stalls, `SPEED` times as long, are not to pass for a lost stream."""
LOW = {  # so that takeoff and return are short
    "px4": {"COM_OF_LOSS_T": LOST_S, "RTL_RETURN_ALT": 8, "RTL_DESCEND_ALT": 5, "COM_LOW_BAT_ACT": 3},
    "arducopter": {"RTL_ALT": 800, "RTL_LOIT_TIME": 0, "BATT_FS_LOW_ACT": 2, "BATT_LOW_VOLT": 10.5},
}
ALLOWED_S = 1.5
"""Vehicle time from a fault to our last setpoint, where one is the last."""
BOOTED_MS = {"px4": 0, "arducopter": 42_000}


@contextmanager
def relayed_case(fault, personality, fly, bridge_config, folder, slots=1000):
    """(case, relay) of a flight that has come to slot `FROM_SLOT`; fixtures are those of tests/autopilot_bridge."""
    with ExitStack() as held:
        autopilot = held.enter_context(
            sitl_process(*AUTOPILOTS[personality], lockstep=False, speed=SPEED, parameters=LOW[personality])
        )
        if BOOTED_MS[personality]:
            step(autopilot, BOOTED_MS[personality])
        port = free_udp_port()
        config = bridge_config(
            SimpleNamespace(port=port, control=None),
            clock={"kind": "paced", "speed": SPEED},
            slots=slots,
            takeoff_altitude_m=3.0,
            start_position_enu=(0.0, 0.0, 5.0),
            box={"x": (-50, 50), "y": (-50, 50), "z": (4, 40)},
        )
        case = held.enter_context(
            Case(fault, fly, config, folder, _to_and_fro, gcs=autopilot.gcs_bind, control=autopilot.control)
        )
        relay = MavlinkRelay(autopilot.companion_bind, autopilot.companion, port)
        held.callback(relay.close)
        case.start()
        case.flight.until_slot(FROM_SLOT)
        yield case, relay


def _to_and_fro(opened):
    return (1.0 if opened.slot % 2 else -1.0, 0.0, 0.0)
