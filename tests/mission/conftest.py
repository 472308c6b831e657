"""A short flight made of synthetic messages, for the tests of what reads recordings."""

import math
import time

import pytest

from bus import messages as m
from bus import topics
from bus.session import free_endpoint, open_session
from mission import flight_log
from mission.recorder import Recorder

ELEMENTS, ANTENNAS, USERS, SLOTS = 4, 2, 2, 5


def state(time_s):
    return m.VehicleState(
        time_s=time_s,
        position_enu=(time_s, 0.0, 60.0),
        velocity_enu=(1.0, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
        mode="OFFBOARD",
        armed=True,
        landed=False,
        battery_remaining=0.9,
        home_lat_lon_alt=(47.4, 8.5, 488.0),
        phase="slots",
    )


def sample(time_s, lag=0.0):
    return m.TrackSample(time_s=time_s, position_enu=(time_s - lag, 0.0, 60.0 - lag), velocity_enu=(1.0, 0.0, 0.0))


def flown(slot, outcome="flown", flown_m=0.9):
    times = [slot + 0.1 * step for step in range(11)]
    moved = outcome in ("flown", "clipped")
    return m.FlownSlot(
        slot=slot,
        outcome=outcome,
        reasons=["fence"] if outcome == "clipped" else [],
        commanded_enu=(3.0 if moved else 0.0, 4.0 if moved else 0.0, 0.0),
        planned_enu=(1.0 if moved else 0.0, 0.0, 0.0),
        flown_enu=(flown_m, 0.0, 0.0),
        track=[sample(time, lag=0.05) for time in times],
        plan=[sample(time) for time in times],
    )


def slot_opened(slot, outcome="flown"):
    return m.SlotOpened(
        slot=slot,
        slots=SLOTS,
        time_s=float(slot),
        position_enu=(float(slot), 0.0, 60.0),
        velocity_enu=(1.0, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
        closing=slot == SLOTS,
        flown=flown(slot - 1, outcome) if slot else None,
    )


def matrix(rows, columns):
    return [[(0.1 * row, -0.2 * column) for column in range(columns)] for row in range(rows)]


def channel_state(slot):
    return m.ChannelState(
        slot=slot,
        time_s=float(slot),
        position_enu=(float(slot), 0.0, 60.0),
        attitude_rad=(0.0, 0.0, 0.0),
        users_enu=[(-20.0, 10.0, 1.5), (30.0, -5.0, 1.5)],
        regions=["reflection", "transmission"],
        direct=matrix(USERS, ANTENNAS),
        bs_ris=matrix(ELEMENTS, ANTENNAS),
        ris_user=matrix(USERS, ELEMENTS),
    )


def action(slot):
    return m.Action(
        slot=slot,
        time_s=float(slot),
        source="test",
        displacement_enu=(3.0, 4.0, 0.0),
        theta_reflection=[0.1] * ELEMENTS,
        split_angle=[math.pi / 4] * ELEMENTS,
        sign=[1] * ELEMENTS,
        beamforming=matrix(ANTENNAS, USERS),
        raw=[0.0],
    )


def setpoint(slot):
    return m.Setpoint(
        time_s=slot + 0.5,
        slot=slot,
        source="hold",
        action_slot=None,
        action_age_s=None,
        state_age_s=0.02,
        wanted_enu=(1.0, 0.0, 0.0),
        velocity_enu=(1.0, 0.0, 0.0),
        yaw_rad=0.0,
        reasons=[],
    )


def configuration(slot):
    angles = [0.3 * slot + element for element in range(ELEMENTS)]
    return m.RisConfiguration(
        slot=slot,
        time_s=float(slot),
        source="action",
        theta_reflection=angles,
        theta_transmission=[math.remainder(angle + math.pi / 2, 2 * math.pi) for angle in angles],
        beta_reflection=[math.sqrt(0.5)] * ELEMENTS,
        beta_transmission=[math.sqrt(0.5)] * ELEMENTS,
        sign=[1] * ELEMENTS,
        split_angle=[math.pi / 4] * ELEMENTS,
        beamforming=matrix(ANTENNAS, USERS),
    )


def link_report(slot, rates=(1e6, 3e6)):
    total = sum(rates)
    fair = len(rates) ** 2 / sum(1 / rate for rate in rates)
    return m.LinkReport(
        slot=slot,
        time_s=float(slot),
        configuration="action",
        position_enu=(float(slot), 0.0, 60.0),
        users_enu=[(-20.0, 10.0, 1.5), (30.0, -5.0, 1.5)],
        regions=["reflection", "transmission"],
        sinr=[1.0, 3.0],
        rate_bps=list(rates),
        sum_rate_bps=total,
        fair_rate_bps=fair,
        hfi=fair / total,
        jfi=total**2 / (len(rates) * sum(rate**2 for rate in rates)),
        qos_bps=2e5,
        below_qos=[rate < 2e5 for rate in rates],
        power_w=200.0,
        energy_j=200.0,
        reward=1.0,
    )


OUTCOMES = ["flown", "clipped", "late", "missing", "rejected"]


@pytest.fixture
def mission(tmp_path):
    """`mission(text)`: the path of a mission file."""

    def make(text):
        path = tmp_path / "m.yaml"
        path.write_text(text)
        return path

    return make


@pytest.fixture
def flight():
    """Every message of a five-slot flight as (topic name, message): one slot of each outcome, the second starved."""
    messages = [("event", m.MissionEvent(time_s=0.0, source="bridge", kind="phase", text="slots"))]
    for slot in range(SLOTS + 1):
        messages.append(("state", state(float(slot))))
        messages.append(("slot", slot_opened(slot, OUTCOMES[slot - 1] if slot else "flown")))
        if slot:
            messages.append(("rf/link", link_report(slot - 1, (1e5, 3e6) if slot == 2 else (1e6, 3e6))))
        if slot < SLOTS:
            messages.append(("rf/csi", channel_state(slot)))
            messages.append(("agent/action", action(slot)))
            messages.append(("ris/configuration", configuration(slot)))
            messages.append(("setpoint", setpoint(slot)))
    health = m.NodeHealth(node="rf", wall_time_s=1.0, counters={"refused.action": 2})
    ended = m.MissionEvent(time_s=9.0, source="bridge", kind="ended", text="flown as planned", exit_code=0)
    return [*messages, ("health", health), ("event", ended)]


def _record(folder, messages):
    """Send messages from one session, record them in another; returns the run folder."""
    endpoint = free_endpoint()
    with (
        open_session(listen=endpoint) as session,
        Recorder(session, "t", folder / "flight.mcap") as recorder,
        open_session(connect=[endpoint]) as sender,
    ):
        for name, message in messages:
            if name == topics.COMMAND:
                recorder.command(message)
            else:
                sender.put(topics.key("t", name), topics.encode(message), encoding=topics.encoding(type(message)))
        for _ in range(2):  # the second puts the first on disk
            sender.put(topics.key("t", "end"), b"end")
        deadline = time.monotonic() + 10.0
        while "end" not in [entry.topic for entry in flight_log.read(folder).entries]:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    return folder


@pytest.fixture
def record():
    """Record (topic name, message) pairs over a real bus into a folder, which it returns."""
    return _record
