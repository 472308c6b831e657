"""The failure matrix's rows of a bad link, in lockstep: faults on every datagram, from slot 2 to the end."""

import random
from functools import partial

import pytest

from autopilot_bridge import node
from autopilot_bridge.link import Link
from tests.failure_matrix.case import AUTOPILOTS, Case, ports
from tests.failure_matrix.rows import BOTH, ROWS

SLOTS = 12
FROM_SLOT = 2
TOWARDS_M, FAST_MPS = 20.0, 8.0
BOX_M, V_MAX_MPS, NOTICED_S = 50.0, 10.0, 1.25
"""Plans stop in the box; an autopilot that loses the stream flies its last velocity for a second or so."""


class Fault:
    """What becomes of datagrams from slot `FROM_SLOT` on."""

    def __init__(self, spoil):
        self.spoil = spoil
        self.on = False

    def __call__(self, datagram):
        return self.spoil(datagram) if self.on else (datagram,)


def lost(share, seed):
    chance = random.Random(seed)
    return lambda datagram: () if chance.random() < share else (datagram,)


def twice(datagram):
    return (datagram, datagram)


def swapped():
    """Every other one waits for the next."""
    kept = []

    def swap(datagram):
        if not kept:
            kept.append(datagram)
            return ()
        return (datagram, kept.pop())

    return swap


CASES = {
    "MAVLink loss 10 %": lambda seed: lost(0.1, seed),
    "MAVLink loss 30 %": lambda seed: lost(0.3, seed),
    "MAVLink loss 60 %": lambda seed: lost(0.6, seed),
    "MAVLink duplicate": lambda _: twice,
    "MAVLink reorder": lambda _: swapped(),
}


def nothing(datagram):
    return ()


@pytest.mark.parametrize("personality", BOTH)
def test_link_dead_at_full_speed(sitl, fly, bridge_config, tmp_path, monkeypatch, personality):
    fault = Fault(nothing)
    monkeypatch.setattr(node, "Link", partial(Link, tamper_in=fault, tamper_out=fault))
    autopilot = sitl("--lockstep", *AUTOPILOTS[personality])
    at = []

    def decide(opened):
        if opened.position_enu[0] > TOWARDS_M and not fault.on:
            fault.on = True
            at.append(opened)
        return (10.0, 0.0, 0.0)

    config = bridge_config(autopilot, slots=1000)
    with Case("link dead at full speed", fly, config, tmp_path, decide, **ports(autopilot)) as case:
        case.start()
        case.witness.until(lambda sight: at and sight.time_s > at[0].time_s + 10.0 and sight.down, "home")
        fault.on = False
        case.fence_m = BOX_M + NOTICED_S * V_MAX_MPS
        case.judge(at[0].time_s)
    assert at[0].velocity_enu[0] > FAST_MPS


@pytest.mark.parametrize(
    ("fault", "personality"), [(fault, personality) for fault in CASES for personality in ROWS[fault].personalities]
)
def test_row(sitl, fly, bridge_config, tmp_path, monkeypatch, fault, personality):
    faults = [Fault(CASES[fault](seed)) for seed in (1, 2)]
    monkeypatch.setattr(node, "Link", partial(Link, tamper_in=faults[0], tamper_out=faults[1]))
    autopilot = sitl("--lockstep", *AUTOPILOTS[personality])
    at = []

    def decide(opened):
        if opened.slot == FROM_SLOT:
            for one in faults:
                one.on = True
            at.append(opened.time_s)
        return (2.0 if opened.slot % 4 < 2 else -2.0, 1.0, 0.0)

    with Case(fault, fly, bridge_config(autopilot, slots=SLOTS), tmp_path, decide, **ports(autopilot)) as case:
        case.start()
        case.over()
        case.judge(at[0])
        flown = [slot.flown_enu for slot in case.flight.flown]
        assert len(flown) == SLOTS or case.flight.code == 3
