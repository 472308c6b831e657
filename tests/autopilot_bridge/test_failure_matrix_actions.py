"""The failure matrix's rows of actions that are none, or do not come: the bridge in lockstep, a real bus."""

import math
import time

import numpy as np
import pytest

from bus import topics
from tests.failure_matrix.case import AUTOPILOTS, Case, ports
from tests.failure_matrix.relay import TcpRelay
from tests.failure_matrix.rows import BOTH

FROM_SLOT = 2
SLOTS = 10
STOPPED_SLOTS = 3
"""A vehicle that holds has stopped by then."""


@pytest.fixture
def flown(sitl, fly, bridge_config, tmp_path):
    """Fly `fault`; `spoil(case, opened)` says whether it answers the slot in the agent's place.

    Gives the case and the opening of slot `FROM_SLOT`.
    """

    def start(fault, personality, spoil, slots=SLOTS, through=lambda endpoint: endpoint, **changes):
        autopilot = sitl("--lockstep", *AUTOPILOTS[personality])
        opened_at = {}

        def decide(opened):
            opened_at.setdefault(opened.slot, opened.time_s)
            if spoil(case, opened):
                return None
            return (1.0 if opened.slot % 2 else -1.0, 0.0, 0.0)

        config = bridge_config(autopilot, slots=slots, **changes)
        with Case(fault, fly, config, tmp_path, decide, **ports(autopilot), through=through) as case:
            case.agent_alive = topics.declare_alive(case.flight.ground, case.flight.vehicle, "agent")
            case.start()
            case.over()
            return case, opened_at[FROM_SLOT]

    return start


def put(case, payload):
    """An action as it stands."""
    case.flight.ground.put(topics.key(case.flight.vehicle, topics.ACTION.name), payload)


def outcomes(log):
    return [opened.flown.outcome for opened in log.messages(topics.SLOT) if opened.flown]


def held(log, since):
    """Whether the vehicle stood still in the slots from then on, as their tracks tell."""
    flown = [opened.flown for opened in log.messages(topics.SLOT) if opened.flown]
    return all(np.linalg.norm(slot.flown_enu) < 0.5 for slot in flown[since + STOPPED_SLOTS :])


def test_agent_sending_nan(flown, make_action):
    written = {
        2: lambda good: topics.encode(make_action(2, (math.nan, 0.0, 0.0))),
        3: lambda good: good.replace(b"1.0,0.0,0.0", b"NaN,0.0,0.0"),
        4: lambda good: good.replace(b"1.0,0.0,0.0", b"1e999,0.0,0.0"),
        5: lambda good: b"\xff\x00{",
    }

    def spoil(case, opened):
        if opened.slot in written:
            good = topics.encode(make_action(opened.slot, (1.0, 0.0, 0.0)))
            put(case, written[opened.slot](good))
        return opened.slot in written

    case, at_s = flown("agent sending NaN", "px4", spoil)
    done = outcomes(case.judge(at_s))
    assert done[2:6] == ["rejected"] * 4
    assert set(done[6:]) <= {"flown", "clipped"}


@pytest.mark.parametrize("personality", BOTH)
def test_agent_sending_nan_for_good(flown, make_action, personality):
    def spoil(case, opened):
        if opened.slot >= FROM_SLOT:
            put(case, topics.encode(make_action(opened.slot, (math.nan, 0.0, 0.0))))
        return opened.slot >= FROM_SLOT

    case, at_s = flown("agent sending NaN for good", personality, spoil, slots=1000)
    log = case.judge(at_s)
    assert set(outcomes(log)[FROM_SLOT:]) <= {"rejected", "missing"}
    assert held(log, FROM_SLOT)


@pytest.fixture
def cable():
    """A TCP relay on the way to the bridge's session: `cable.lay` is for `through`."""

    class Cable:
        relay = None

        def lay(self, endpoint):
            self.relay = TcpRelay(int(endpoint.rsplit(":", 1)[1]))
            return f"tcp/127.0.0.1:{self.relay.port}"

    laid = Cable()
    yield laid
    laid.relay.close()


def test_zenoh_session_lost_and_back(flown, cable):
    def spoil(case, opened):
        if opened.slot == FROM_SLOT and not case.flight.told("node_lost"):
            cable.relay.cut()
            time.sleep(1.0)
            cable.relay.mend()
        return False

    case, at_s = flown("zenoh session lost and back", "px4", spoil, slots=20, through=cable.lay)
    log = case.judge(at_s)
    assert outcomes(log)[-1] in ("flown", "clipped")
    assert len(outcomes(log)) == 20


def test_zenoh_session_lost_for_good(flown, cable):
    def spoil(case, opened):
        if opened.slot == FROM_SLOT:
            cable.relay.cut()
        return False

    case, at_s = flown(
        "zenoh session lost for good", "px4", spoil, slots=1000, through=cable.lay, action_wait_wall_s=0.2
    )
    assert held(case.judge(at_s), FROM_SLOT)
