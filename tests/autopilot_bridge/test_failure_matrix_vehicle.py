"""The failure matrix's rows of what happens to the vehicle itself, injected into the simulator in lockstep."""

import threading

import pytest

from bus import topics
from tests.failure_matrix.case import AUTOPILOTS, Case, ports
from tests.failure_matrix.rows import BOTH

SLOTS = 1000  # none of these flights comes to its planned end
FROM_SLOT = 2
BATTERY = {
    "px4": ("--param", "COM_LOW_BAT_ACT=3"),
    "arducopter": ("--param", "BATT_FS_LOW_ACT=2", "--param", "BATT_LOW_VOLT=10.5"),
}
TOO_LOW = {"px4": 0.06, "arducopter": 0.0}
RETURNING = {"px4": 4 << 16 | 5 << 24, "arducopter": 6}
"""HEARTBEAT.custom_mode of their return."""
GALE_S = 20.0
RELEASED_S = 1.0
"""From the autopilot's change of mode to our last setpoint."""


@pytest.fixture
def flown(sitl, fly, bridge_config, tmp_path):
    """Fly `fault`, which `inject(case, slot)` causes while the vehicle stands still for an action."""

    def start(fault, personality, inject, options=(), **changes):
        autopilot = sitl("--lockstep", *AUTOPILOTS[personality], *options)

        def decide(opened):
            inject(case, opened)
            return (1.0 if opened.slot % 2 else -1.0, 0.0, 0.0)

        config = bridge_config(autopilot, slots=SLOTS, **changes)
        with Case(fault, fly, config, tmp_path, decide, **ports(autopilot)) as case:
            case.start()
            case.over()
            return case

    return start


def in_slot(number, what, at):
    def inject(case, opened):
        if opened.slot == number:
            case.inject(what)
            at.append(opened.time_s)

    return inject


def left_s(case):
    """When the autopilot's HEARTBEATs said that it no longer flew setpoints."""
    flying, heard_s = False, 0.0
    for message in case.frames:
        if message.get_type() == "HEARTBEAT" and message.get_srcSystem() == 1:
            offboard = message.custom_mode in (6 << 16, 4)
            if flying and not offboard:
                return heard_s
            flying = offboard
        elif message.get_type() == "LOCAL_POSITION_NED":
            heard_s = message.time_boot_ms / 1000
    raise AssertionError("it never left the mode that flies setpoints")


@pytest.mark.parametrize("personality", BOTH)
@pytest.mark.parametrize("fault", ["GPS loss", "battery low"])
def test_the_autopilots_own_failsafe_is_obeyed(flown, fault, personality):
    at = []
    what = "gps_loss" if fault == "GPS loss" else f"battery {TOO_LOW[personality]}"
    case = flown(fault, personality, in_slot(FROM_SLOT, what, at), BATTERY[personality])
    case.judge(at[0])
    assert max(case.setpoints_s) < left_s(case) + RELEASED_S


@pytest.mark.parametrize("personality", BOTH)
def test_fence_breach_by_wind(flown, personality):
    at = []

    def inject(case, opened):
        if opened.slot == FROM_SLOT:
            case.inject("wind 0,30,0")
            at.append(opened.time_s)
            threading.Thread(target=calm, args=(case,)).start()

    def calm(case):
        case.witness.until(lambda sight: sight.time_s > at[0] + GALE_S, "the end of the gale")
        case.inject("wind 0,0,0")

    case = flown("fence breach by wind", personality, inject)
    log = case.judge(at[0])
    breach_s = next(event.time_s for event in log.messages(topics.EVENT) if event.kind == "failsafe")
    assert max(case.setpoints_s) < breach_s + RELEASED_S
    gone = [sight for sight in case.witness.since(breach_s + 3.0) if sight.time_s < at[0] + GALE_S]
    assert {sight.custom_mode for sight in gone} == {RETURNING[personality]}
    assert gone[-1].position_enu[0] > case.fence_m, "it was blown out of the fence"


@pytest.mark.parametrize("personality", BOTH)
def test_a_motor_fails(flown, personality):
    at = []
    case = flown("a motor fails", personality, in_slot(FROM_SLOT, "motor 1 fail", at))
    case.judge(at[0])
    fallen = next(sight.time_s for sight in case.witness.since(at[0]) if sight.landed)
    assert max(case.setpoints_s) < fallen + RELEASED_S
