"""The bus contract over real zenoh sessions: what is sent arrives as it was, what is no message is refused."""

import math
import queue
import socket
import subprocess
import sys
import time
import uuid
from collections import Counter
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bus import messages as m
from bus import topics
from bus.session import BusError, free_endpoint, open_session

PATIENCE_S = 10.0  # how long a test waits for what must come; only a failing test waits that long

finite = st.floats(allow_nan=False, allow_infinity=False)
count = st.integers(0, 10**6)
text = st.text(st.characters(codec="utf-8"), max_size=20)
vec3 = st.tuples(finite, finite, finite)
complex_matrix = st.lists(st.lists(st.tuples(finite, finite), max_size=3), max_size=3)
vectors = st.lists(vec3, max_size=3)
numbers = st.lists(finite, max_size=4)
signs = st.lists(st.sampled_from([-1, 1]), max_size=4)
regions = st.lists(st.sampled_from(["reflection", "transmission"]), max_size=3)
sources = st.sampled_from(["action", "held", "default", "closed_form", "optimised"])
track = st.lists(st.builds(m.TrackSample, time_s=finite, position_enu=vec3, velocity_enu=vec3), max_size=3)
flown = st.builds(
    m.FlownSlot,
    slot=count,
    outcome=st.sampled_from(["flown", "clipped", "late", "missing", "rejected"]),
    reasons=st.lists(text, max_size=2),
    commanded_enu=vec3,
    planned_enu=vec3,
    flown_enu=vec3,
    track=track,
    plan=track,
)
MESSAGES = {
    m.VehicleState: st.builds(
        m.VehicleState,
        time_s=finite,
        position_enu=vec3,
        velocity_enu=vec3,
        attitude_rad=vec3,
        mode=text,
        armed=st.booleans(),
        landed=st.booleans(),
        battery_remaining=st.none() | st.floats(0, 1),
        home_lat_lon_alt=st.none() | vec3,
        phase=text,
        position_age_s=st.floats(0, 1e308),
        stop_enu=st.none() | vec3,
    ),
    m.SlotOpened: st.builds(
        m.SlotOpened,
        slot=count,
        slots=count,
        time_s=finite,
        position_enu=vec3,
        velocity_enu=vec3,
        attitude_rad=vec3,
        closing=st.booleans(),
        flown=st.none() | flown,
    ),
    m.ChannelState: st.builds(
        m.ChannelState,
        slot=count,
        time_s=finite,
        position_enu=vec3,
        attitude_rad=vec3,
        users_enu=vectors,
        regions=regions,
        direct=complex_matrix,
        bs_ris=complex_matrix,
        ris_user=complex_matrix,
    ),
    m.Action: st.builds(
        m.Action,
        slot=count,
        time_s=finite,
        source=text,
        displacement_enu=vec3,
        theta_reflection=numbers,
        split_angle=numbers,
        sign=signs,
        beamforming=complex_matrix,
        raw=numbers,
    ),
    m.Setpoint: st.builds(
        m.Setpoint,
        time_s=finite,
        slot=st.none() | count,
        source=text,
        action_slot=st.none() | count,
        action_age_s=st.none() | st.floats(0, 1e9),
        state_age_s=st.floats(0, 1e9),
        wanted_enu=st.none() | vec3,
        velocity_enu=vec3,
        yaw_rad=finite,
        reasons=st.lists(text, max_size=2),
    ),
    m.RisConfiguration: st.builds(
        m.RisConfiguration,
        slot=count,
        time_s=finite,
        source=sources,
        theta_reflection=numbers,
        theta_transmission=numbers,
        beta_reflection=numbers,
        beta_transmission=numbers,
        sign=signs,
        split_angle=numbers,
        beamforming=complex_matrix,
    ),
    m.LinkReport: st.builds(
        m.LinkReport,
        slot=count,
        time_s=finite,
        configuration=sources,
        position_enu=vec3,
        users_enu=vectors,
        regions=regions,
        sinr=numbers,
        rate_bps=numbers,
        sum_rate_bps=finite,
        fair_rate_bps=finite,
        hfi=finite,
        jfi=finite,
        qos_bps=finite,
        below_qos=st.lists(st.booleans(), max_size=3),
        power_w=finite,
        energy_j=finite,
        reward=finite,
    ),
    m.Command: st.builds(m.Command, name=st.sampled_from(["start", "hold", "resume", "return", "land"])),
    m.CommandReply: st.builds(m.CommandReply, accepted=st.booleans(), reason=text),
    m.MissionEvent: st.builds(
        m.MissionEvent, time_s=finite, source=text, kind=text, text=text, exit_code=st.none() | count
    ),
    m.NodeHealth: st.builds(
        m.NodeHealth, node=text, wall_time_s=finite, counters=st.dictionaries(text, count, max_size=3)
    ),
}
ANY_MESSAGE = st.one_of(*MESSAGES.values())
EVENT = m.MissionEvent(time_s=1.5, source="test", kind="phase", text="ready")


@pytest.fixture
def hub():
    endpoint = free_endpoint()
    with open_session(listen=endpoint) as session:
        yield endpoint, session


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "what should have come never came"
        time.sleep(0.01)


def test_every_message_of_the_contract_is_tested():
    assert set(MESSAGES) == set(m.Message.__subclasses__()) - {m.TrackSample, m.FlownSlot}


@given(ANY_MESSAGE)
@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=200)
def test_a_message_survives_the_wire_bit_for_bit(message):
    read = topics.decode(topics.encode(message), type(message))
    assert read == message
    assert topics.encode(read) == topics.encode(message)


@given(ANY_MESSAGE, st.data())
@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=200)
def test_a_missing_field_is_refused_and_an_unknown_one_ignored(message, data):
    fields = msgspec.json.decode(topics.encode(message))
    required = {f.name for f in msgspec.structs.fields(message) if f.required}
    extended = msgspec.json.encode(fields | {"added_in_v2": 1})
    assert topics.decode(extended, type(message)) == message
    name = data.draw(st.sampled_from(sorted(required)))
    del fields[name]
    with pytest.raises(topics.RefusedError, match=name):
        topics.decode(msgspec.json.encode(fields), type(message))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_numbers_are_refused_by_the_reader(bad):
    sent = m.TrackSample(time_s=0.0, position_enu=(0.0, bad, 0.0), velocity_enu=(0.0, 0.0, 0.0))
    with pytest.raises(topics.RefusedError, match="position_enu"):
        topics.decode(topics.encode(sent), m.TrackSample)


@pytest.mark.parametrize("payload", [b"", b"\xff\xfe", b"[1]", b'{"time_s": 1e999}', b'{"time_s": NaN}', b"{" * 2000])
def test_what_is_no_message_is_refused_not_a_crash(payload):
    with pytest.raises(topics.RefusedError):
        topics.decode(payload, m.MissionEvent)


@pytest.mark.parametrize("name", ["", "a/b", "*", "star 1", "x" * 33])
def test_vehicle_names_that_would_break_the_key_are_refused(name):
    with pytest.raises(ValueError, match="vehicle"):
        topics.key(name, "state")


def test_bad_payloads_are_counted_and_good_ones_still_delivered(hub):
    endpoint, session = hub
    got: queue.Queue[m.MissionEvent] = queue.Queue()
    refused: Counter[str] = Counter()
    keep = topics.subscribe(session, "t", topics.EVENT, got.put, refused)
    with open_session(connect=[endpoint]) as other:
        for payload in (b"nonsense", b"{}", topics.encode(EVENT)):
            other.put(topics.key("t", "event"), payload)
        assert got.get(timeout=PATIENCE_S) == EVENT
    assert refused == {"event": 2}
    assert got.empty()
    del keep


def test_order_is_kept_and_nothing_dropped(hub):
    endpoint, session = hub
    got: queue.Queue[m.MissionEvent] = queue.Queue()
    keep = topics.subscribe(session, "t", topics.EVENT, got.put, Counter())
    with open_session(connect=[endpoint]) as other:
        publisher = topics.Publisher(other, "t", topics.EVENT)
        for index in range(500):
            publisher.send(msgspec.structs.replace(EVENT, time_s=float(index), text="x" * 1000))
        assert [got.get(timeout=PATIENCE_S).time_s for _ in range(500)] == [float(index) for index in range(500)]
    del keep


CACHED = [topic for topic in topics.TOPICS if topic.cached]


@given(st.data())
@settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.parametrize("topic", CACHED, ids=[topic.name for topic in CACHED])
def test_a_late_joiner_gets_the_last_cached_message(hub, topic, data):
    endpoint, session = hub
    vehicle = uuid.uuid4().hex
    publisher = topics.Publisher(session, vehicle, topic)
    first, last = data.draw(MESSAGES[topic.message]), data.draw(MESSAGES[topic.message])
    publisher.send(first)
    publisher.send(last)
    got: queue.Queue[m.Message] = queue.Queue()
    with open_session(connect=[endpoint]) as late:
        keep = topics.subscribe(late, vehicle, topic, got.put, Counter())
        assert got.get(timeout=PATIENCE_S) == last
        assert got.empty()
        del keep


def test_liveliness_shows_nodes_already_there_and_nodes_that_die(hub):
    endpoint, session = hub
    seen: dict[str, bool] = {}
    child = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time; from bus.session import open_session; from bus.topics import declare_alive\n"
            "session = open_session(connect=[sys.argv[1]]); token = declare_alive(session, 't', 'agent')\n"
            "print('up', flush=True); time.sleep(600)",
            endpoint,
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "up\n"
        keep = topics.watch_alive(session, "t", seen.__setitem__)
        wait_for(lambda: seen.get("agent") is True)
        child.kill()
        wait_for(lambda: seen.get("agent") is False)
        del keep
    finally:
        child.kill()
        child.wait()
        child.stdout.close()


def test_the_end_is_told_by_the_bridge_or_by_its_death_or_by_a_mission_that_dies_first(hub):
    endpoint, session = hub
    with open_session(connect=[endpoint]) as other:

        def watched(vehicle):
            ends = []
            return ends, topics.watch_end(session, vehicle, lambda: ends.append(True))

        told, keep_told = watched("told")
        topics.Publisher(other, "told", topics.EVENT).send(
            m.MissionEvent(time_s=1.0, source="bridge", kind="ended", text="exit 0", exit_code=0)
        )
        wait_for(lambda: told)

        tokens = {name: topics.declare_alive(other, name, "mission") for name in ("early", "late")}
        tokens["bridge"] = topics.declare_alive(other, "late", "bridge")
        early, keep_early = watched("early")
        late, keep_late = watched("late")
        tokens["late"].undeclare()
        tokens["early"].undeclare()
        wait_for(lambda: early)
        assert not late  # a flight that has a bridge outlives its mission
        tokens["bridge"].undeclare()
        wait_for(lambda: late)
        del keep_told, keep_early, keep_late


def test_a_command_is_answered_and_a_bad_one_refused(hub):
    endpoint, session = hub
    refused: Counter[str] = Counter()

    def answer(command):
        return m.CommandReply(accepted=command.name == "land", reason="only land")

    keep = topics.answer_commands(session, "t", answer, refused)
    with open_session(connect=[endpoint]) as other:
        assert topics.send_command(other, "t", m.Command(name="land")).accepted
        assert not topics.send_command(other, "t", m.Command(name="start")).accepted
        for reply in other.get(topics.key("t", "command"), payload=b'{"name": "loop"}', timeout=PATIENCE_S):
            assert reply.ok is not None
            said = topics.decode(reply.ok.payload.to_bytes(), m.CommandReply)
            assert not said.accepted
            assert "name" in said.reason
    assert refused == {"command": 1}
    del keep


def test_a_command_that_nobody_serves_times_out(hub):
    _, session = hub
    with pytest.raises(TimeoutError, match="no answer on star/t/command"):
        topics.send_command(session, "t", m.Command(name="land"), timeout_s=0.2)


def test_two_peers_keep_talking_when_the_hub_is_gone():
    endpoint = free_endpoint()
    hub = open_session(listen=endpoint)
    got: queue.Queue[m.MissionEvent] = queue.Queue()
    with open_session(connect=[endpoint]) as one, open_session(connect=[endpoint]) as two:
        keep = topics.subscribe(one, "t", topics.EVENT, got.put, Counter())
        publisher = topics.Publisher(two, "t", topics.EVENT)
        other = str(one.info.zid())
        wait_for(lambda: other in [str(peer) for peer in two.info.peers_zid()])
        hub.close()
        publisher.send(EVENT)
        assert got.get(timeout=PATIENCE_S) == EVENT
        del keep


def test_an_endpoint_where_nobody_listens_is_an_error_that_names_it():
    endpoint = free_endpoint()
    with pytest.raises(BusError, match=endpoint):
        open_session(connect=[endpoint])


def test_an_endpoint_already_taken_is_an_error_that_names_it():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(BusError, match=endpoint):
            open_session(listen=endpoint)


def test_an_endpoint_that_is_none_is_an_error_that_names_it():
    for arguments in ({"listen": "foo"}, {"connect": ["foo"]}):
        with pytest.raises(BusError, match="foo") as caught:
            open_session(**arguments)
        assert "\n" not in str(caught.value)
        assert ".rs" not in str(caught.value), "a place in zenoh's source helps nobody"


def test_a_config_file_that_is_none_is_an_error_that_names_it(tmp_path):
    broken = tmp_path / "zenoh.json5"
    broken.write_text("{mode: 'sideways'}")
    for path in (broken, tmp_path / "absent.json5"):
        with pytest.raises(BusError, match=path.name):
            open_session(config_file=path)


def test_a_config_file_decides_and_connect_is_added(hub, tmp_path):
    endpoint, session = hub
    config = tmp_path / "zenoh.json5"
    config.write_text("{mode: 'client', scouting: {multicast: {enabled: false}}}")
    got: queue.Queue[m.MissionEvent] = queue.Queue()
    keep = topics.subscribe(session, "t", topics.EVENT, got.put, Counter())
    with open_session(config_file=config, connect=[endpoint]) as client:
        topics.Publisher(client, "t", topics.EVENT).send(EVENT)
        assert got.get(timeout=PATIENCE_S) == EVENT
    del keep


def listening_addresses(pid):
    """Local addresses of the process's TCP listeners and UDP sockets, as /proc/net shows them (hex)."""
    inodes = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = str(fd.readlink())
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if rest[5] in inodes and (table.startswith("udp") or state == "0A"):
                found.append((table, local.split(":")[0]))
    return found


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux's /proc")
def test_nothing_listens_outside_loopback_by_default():
    code = (
        "import sys; from bus.session import open_session\n"
        "hub = open_session(listen=sys.argv[1]); peer = open_session(connect=[sys.argv[1]])\n"
        "print('up', flush=True); sys.stdin.read()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code, free_endpoint()], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "up\n"
        addresses = listening_addresses(child.pid)
    finally:
        child.kill()
        child.communicate()
    loopback = {"0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F"}
    assert len(addresses) >= 2, "both sessions listen"
    assert {address for _, address in addresses} <= loopback, addresses
