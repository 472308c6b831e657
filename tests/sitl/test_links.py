"""Links: several clients at once on UDP and TCP, each with its own rates and counters; routing; budgets; a flood."""

import itertools
import math
import socket
import subprocess
import sys
import tracemalloc
from collections import Counter
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from sitl.autopilot import Autopilot
from sitl.links.budget import BURST, BYTES_PER_MS, Budget
from sitl.links.link import Link, PortError
from sitl.links.network import Network
from sitl.links.signing import Signing
from sitl.links.tcp import UNSENT_MAX, TcpPort
from sitl.links.udp import PEERS_MAX, UdpPort
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.px4.personality import PX4
from sitl.server import Options, Server
from tests.sitl.client import Direct, lockstep
from tests.sitl.process import free_udp_port, sitl_process

OFFBOARD = (6, 0)
HEARTBEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


class Other:
    """One more client, on a port of its own."""

    def __init__(self, to: tuple[str, int], system: int, component: int = 190) -> None:
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.udp.bind(("127.0.0.1", 0))
        self.udp.setblocking(False)
        self.to = to
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def send(self, message) -> None:
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        self.udp.sendto(message.pack(self.mav), self.to)

    def received(self) -> list:
        messages = []
        while True:
            try:
                messages.append(self.mav.decode(bytearray(self.udp.recv(65535))))
            except BlockingIOError:
                return messages

    def __enter__(self) -> "Other":
        return self

    def __exit__(self, *_: object) -> None:
        self.udp.close()


def names(messages: list, system: int | None = None) -> Counter[str]:
    return Counter(m.get_type() for m in messages if system in (None, m.get_srcSystem()))


# Several clients on one UDP port


def test_every_client_has_its_own_rates_answers_and_sequence_numbers(vehicle: Direct):
    vehicle.boot()
    with Other(vehicle.to, 241) as first, Other(vehicle.to, 242) as second:
        for client in (first, second):
            client.send(HEARTBEAT)
        vehicle.fly(0.1)
        first.send(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 30, 20_000, 0, 0, 0, 0, 0))
        vehicle.fly(0.1)
        answers = names(first.received()), names(second.received()), names(vehicle.messages)
        assert [count["COMMAND_ACK"] for count in answers] == [1, 0, 0]
        vehicle.fly(2)
        told = first.received(), second.received()
        assert names(told[0])["ATTITUDE"] == pytest.approx(100, abs=2)
        assert names(told[1])["ATTITUDE"] == pytest.approx(20, abs=2), "the other's rate is not changed"
        for messages in told:
            sequence = [m.get_seq() for m in messages if m.get_srcSystem() == 1]
            assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(sequence))


def test_a_flown_vehicle_can_be_handed_from_one_client_to_another(vehicle: Direct):
    """Setpoints of one, the landing commanded by another."""
    vehicle.take_off(499.4)
    vehicle.offboard(1.0, 0.0, 0.0)
    with Other(vehicle.to, 255) as pilot:
        pilot.send(mavlink.MAVLink_command_long_message(1, 1, 21, 0, 0, 0, 0, math.nan, 0, 0, 0))
        vehicle.fly(0.2, lambda: vehicle.setpoint(1.0, 0.0, 0.0))
        assert names(pilot.received())["COMMAND_ACK"] == 1
    assert vehicle.until(lambda: vehicle.mode == (4, 6), 2) <= 2


def test_a_client_of_mavlink_1_is_understood(vehicle: Direct):
    """And answered with MAVLink 2, as PX4 does."""
    vehicle.boot()
    with Other(vehicle.to, 255) as old:
        ping = mavlink.MAVLink_ping_message(4, 1, 0, 0)
        old.udp.sendto(ping.pack(old.mav, force_mavlink1=True), old.to)
        vehicle.fly(0.1)
        assert [m.time_usec for m in old.received() if m.get_type() == "PING"] == [4]


PARAMETERS = mavlink.MAVLink_param_request_list_message(1, 1).pack(mavlink.MAVLink(None, srcSystem=255))


def test_a_udp_client_that_vanishes_in_mid_transfer_is_forgotten(hovering: Direct):
    with Other(hovering.to, 255) as client:
        client.udp.sendto(PARAMETERS, hovering.to)
        hovering.fly(0.05)
        assert len(hovering.autopilot.network.links) == 3
    hovering.fly(11)
    assert len(hovering.autopilot.network.links) == 2
    assert hovering.position[2] == pytest.approx(-10, abs=0.5)


def test_a_tcp_client_that_vanishes_in_mid_transfer_is_forgotten(tcp: "TcpVehicle"):
    client = tcp.connect()
    client.tcp.sendall(PARAMETERS)
    tcp.advance()
    assert len(tcp.port.links) == 1
    client.tcp.close()
    tcp.advance(1000)
    tcp.advance(1000)
    assert tcp.port.links == []
    assert not tcp.autopilot.defects


def test_the_number_of_peers_is_bounded(vehicle: Direct):
    vehicle.fly(1)
    others = [Other(vehicle.to, 100 + k) for k in range(PEERS_MAX + 3)]
    try:
        for other in others:
            other.send(HEARTBEAT)
        vehicle.fly(1.5)
        served = [bool(other.received()) for other in others]
        assert sum(served) == PEERS_MAX - 1, "one place is the configured peer's"
        counters = vehicle.autopilot.network.counters()
        assert counters["companion strangers"]["over budget"] == len(others) - sum(served)
    finally:
        for other in others:
            other.udp.close()


def test_a_served_port_stays_taken(vehicle: Direct):
    """Its sockets share the port among themselves, not with a second process."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
        second.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            second.bind(vehicle.to)
    with pytest.raises(PortError, match=f"gcs link: UDP port 127.0.0.1:{vehicle.to[1]} cannot be bound"):
        UdpPort("gcs", vehicle.to[1], 1, lambda put, _: Link("gcs", {}, 1, Signing(), put))


# Routing: mavlink.io "Routing"; AUTOPILOT.md 2: "PX4 forwards each peer's frames to the other link"


@pytest.fixture
def party(vehicle: Direct) -> Iterator[tuple[Direct, Other, Other]]:
    """A vehicle, its companion (240, 191) and two more: (255, 190) on the ground link, (1, 100) on the companion's."""
    vehicle.fly(1)
    with Other(("127.0.0.1", vehicle.gcs.port), 255) as ground, Other(vehicle.to, 1, 100) as camera:
        for client in (vehicle, ground, camera):
            client.send(HEARTBEAT)
        vehicle.fly(0.1)
        ground.received()
        camera.received()
        vehicle.messages.clear()
        yield vehicle, ground, camera


def test_a_broadcast_reaches_everybody_else(party):
    vehicle, ground, camera = party
    ground.send(HEARTBEAT)
    vehicle.fly(0.1)
    assert names(vehicle.messages, 255)["HEARTBEAT"] == 1
    assert names(camera.received(), 255)["HEARTBEAT"] == 1
    assert not names(ground.received(), 255)


def test_an_addressed_frame_goes_only_where_its_addressee_was_heard(party):
    vehicle, ground, camera = party
    ground.send(mavlink.MAVLink_ping_message(1, 1, 240, 191))
    ground.send(mavlink.MAVLink_ping_message(2, 1, 77, 1))
    vehicle.fly(0.1)
    assert [m.time_usec for m in vehicle.messages if m.get_type() == "PING"] == [1]
    assert not names(camera.received())["PING"]


def test_another_component_of_the_vehicle_gets_its_own(party):
    """And the autopilot does not answer for it: AUTOPILOT.md 2, "No ACK: wrong system or component id"."""
    vehicle, ground, camera = party
    ground.send(mavlink.MAVLink_command_long_message(1, 100, 521, 0, 0, 0, 0, 0, 0, 0, 0))
    vehicle.fly(0.1)
    assert names(camera.received(), 255)["COMMAND_LONG"] == 1
    assert not names(vehicle.messages, 255)
    assert not names(ground.received())["COMMAND_ACK"]


def test_what_is_for_the_vehicle_or_about_the_link_is_not_forwarded(party):
    vehicle, ground, camera = party
    ground.send(mavlink.MAVLink_command_long_message(1, 1, 521, 0, 0, 0, 0, 0, 0, 0, 0))
    ground.send(mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1))
    ground.send(mavlink.MAVLink_setup_signing_message(9, 1, [1] * 32, 1))
    vehicle.fly(0.1)
    assert not names(vehicle.messages, 255)
    assert not names(camera.received(), 255)


def test_a_loop_of_links_does_not_send_a_frame_round_for_ever(party):
    """The same sender heard on two links: its broadcasts are not passed from one to the other."""
    vehicle, _ground, camera = party
    camera.mav.srcSystem, camera.mav.srcComponent = 255, 190
    camera.send(HEARTBEAT)
    vehicle.fly(0.1)
    vehicle.messages.clear()
    camera.send(HEARTBEAT)
    vehicle.fly(0.1)
    assert names(vehicle.messages, 255)["HEARTBEAT"] == 1, "to the companion, and not back by the ground's link"


# TCP


class TcpVehicle:
    """An autopilot with one TCP port and a client on it."""

    def __init__(self) -> None:
        signing = Signing()
        rates_hz = {"HEARTBEAT": 1.0, "ATTITUDE": 50.0}
        self.port = TcpPort("tcp", 0, lambda put, ms: Link("tcp", rates_hz, 1, signing, put, now_ms=ms))
        self.autopilot = Autopilot(PX4, Parameters(PX4.table), Origin(), Network((self.port,), 1, signing), 0, 0)

    def connect(self) -> "TcpClient":
        return TcpClient(self)

    def advance(self, ms: int = 50) -> None:
        self.autopilot.receive()
        self.autopilot.advance(ms)


class TcpClient:
    """A byte stream read with pymavlink."""

    def __init__(self, vehicle: TcpVehicle) -> None:
        self.tcp = socket.create_connection(("127.0.0.1", vehicle.port.port))
        self.tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.tcp.setblocking(False)
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)

    def received(self) -> list:
        messages: list = []
        while True:
            try:
                data = self.tcp.recv(65535)
            except BlockingIOError:
                return messages
            if not data:
                return messages
            messages.extend(self.mav.parse_buffer(data) or ())


@pytest.fixture
def tcp() -> Iterator[TcpVehicle]:
    vehicle = TcpVehicle()
    yield vehicle
    vehicle.port.close()


def test_a_tcp_client_is_served_and_two_do_not_mix(tcp):
    first, second = tcp.connect(), tcp.connect()
    ping = mavlink.MAVLink_ping_message(5, 1, 0, 0).pack(first.mav)
    tcp.advance(2000)
    for one in ping:  # a frame cut into bytes
        first.tcp.send(bytes((one,)))
        tcp.advance(10)
    told = names(first.received(), 1), names(second.received(), 1)
    assert told[0]["PING"] == 1
    assert told[1]["PING"] == 0
    assert told[0]["ATTITUDE"] == told[1]["ATTITUDE"] > 80
    assert told[0]["HEARTBEAT"] == told[1]["HEARTBEAT"] > 0
    first.tcp.close()
    second.tcp.close()
    tcp.advance(50)
    assert tcp.port.links == []


def test_a_tcp_stream_finds_its_frames_in_garbage(tcp):
    client = tcp.connect()
    tcp.advance(1500)
    ping = mavlink.MAVLink_ping_message(5, 1, 0, 0).pack(client.mav)
    corrupt = bytearray(ping)
    corrupt[12] ^= 1
    client.tcp.send(b"GET / HTTP/1.1\r\n" + ping + bytes(corrupt) + b"\x00\xff" * 40 + ping)
    tcp.advance()
    assert names(client.received(), 1)["PING"] == 2
    (link,) = tcp.port.links
    assert (link.counters["garbage"], link.counters["frame"]) == (2, 1)
    client.tcp.close()


def test_a_tcp_client_that_never_reads_costs_a_bounded_amount(tcp):
    client = tcp.connect()
    client.tcp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    tcp.advance(1000)
    (link,) = tcp.port.links
    frame = mavlink.MAVLink_ping_message(5, 1, 0, 0).pack(client.mav)
    for _ in range(2 * (UNSENT_MAX + (8 << 20)) // len(frame)):
        link.forward(frame)
        if link.counters["send failed"]:
            break
        tcp.port.flush()
    assert link.counters["send failed"] > 0
    tcp.advance(100)
    client.tcp.close()


def test_a_tcp_client_that_floods_is_held_back(tcp):
    """Nothing is lost and nothing is read beyond the budget: the kernel makes the sender wait."""
    client = tcp.connect()
    tcp.advance(1000)
    frame = mavlink.MAVLink_ping_message(5, 1, 9, 9).pack(client.mav)
    sent = 0
    for _ in range(200):
        try:
            sent += client.tcp.send(frame * 1000)
        except BlockingIOError:
            break
    before = tcp.autopilot.now_ms
    for _ in range(20):
        tcp.advance(50)
    (link,) = tcp.port.links
    read = link.counters["received"] * len(frame)
    assert 0 < read <= BURST + BYTES_PER_MS * (tcp.autopilot.now_ms - before)
    assert link.counters["frame"] == link.counters["garbage"] == 0
    client.tcp.close()


# Budgets


@given(st.lists(st.tuples(st.integers(0, 500), st.integers(0, 100_000)), max_size=60))
def test_a_budget_is_never_exceeded(steps):
    budget, now, spent = Budget(0), 0, 0
    for wait_ms, size in steps:
        now += wait_ms
        if budget.take(size, now):
            spent += size
        assert spent <= BURST + BYTES_PER_MS * now


def test_a_budget_refills():
    budget = Budget(0)
    assert budget.take(BURST, 0)
    assert not budget.take(1, 0)
    assert not budget.take(BYTES_PER_MS * 10 + 1, 10)
    assert budget.take(BYTES_PER_MS * 10, 10)


# A flood: 500 thousand frames from one foreign address while a pymavlink client flies OFFBOARD

FLOOD = 500_000


def flood_frames() -> dict[str, bytes]:
    mav = mavlink.MAVLink(None, srcSystem=66, srcComponent=6)
    return {
        "heartbeats": HEARTBEAT.pack(mav),
        "commands": mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0).pack(mav),
        "garbage": bytes(range(30)) * 3,
    }


@pytest.mark.parametrize(("kind", "count"), [("heartbeats", FLOOD), ("commands", FLOOD // 5), ("garbage", FLOOD // 5)])
def test_a_flood_does_not_end_offboard_in_lockstep(hovering: Direct, kind: str, count: int):
    """All that a flooder can send between two steps is in the socket before each of them."""
    flood = flood_frames()[kind]
    steps = count // 2000
    hovering.offboard(1.0, 0.0, 0.0)
    hovering.fly(1.2, lambda: hovering.setpoint(1.0, 0.0, 0.0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flooder:
        for _ in range(steps):
            for _ in range(count // steps):
                flooder.sendto(flood, hovering.to)
            hovering.setpoint(1.0, 0.0, 0.0)
            hovering.messages.clear()
            hovering.advance()
            assert hovering.mode == OFFBOARD
    counters = hovering.autopilot.network.counters()
    dropped = sum(count.get("over budget", 0) + count.get("lost", 0) for count in counters.values())
    believed = sum(count.get("received", 0) for count in counters.values())
    assert dropped > count / 2
    assert believed * len(flood) <= BURST + BYTES_PER_MS * steps * 50 + 100 * steps
    assert hovering.velocity[0] == pytest.approx(1.0, abs=0.2)


@pytest.mark.skipif(sys.platform != "linux", reason="needs connected UDP sockets on a shared port, as Linux has them")
@pytest.mark.parametrize("known", [False, True])
def test_a_full_receive_buffer_of_a_flooder_keeps_nobody_else_out(vehicle: Direct, known: bool):
    """More than the kernel has room for, then a client's frame: it gets through, be the flooder served or not."""
    vehicle.fly(1)
    flood = flood_frames()["heartbeats" if known else "garbage"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flooder:
        flooder.sendto(flood, vehicle.to)
        vehicle.fly(0.1)
        for _ in range(40_000):
            flooder.sendto(flood, vehicle.to)
        vehicle.send(mavlink.MAVLink_ping_message(9, 9, 0, 0))
        vehicle.advance()
    assert vehicle.latest["PING"].time_usec == 9
    lost = [count["lost"] for count in vehicle.autopilot.network.counters().values()]
    assert max(lost) > 1000


@pytest.mark.timeout(120)
def test_a_flood_does_not_end_offboard_when_paced():
    """The same with the server's own pacing, on a wall clock of the test's; a tick every 10 ms."""
    now = itertools.count()
    wall = 0.0

    def clock() -> float:
        next(now)
        return wall

    port = free_udp_port()
    options = Options(
        PX4, Parameters(PX4.table), companion_port=port, companion_bind=0, gcs_bind=0, gcs_port=free_udp_port()
    )
    server = Server(options, clock)
    bound = int(server.describe()[0].split()[1].split(":")[1])

    class Paced(Direct):
        def __init__(self) -> None:
            super(Direct, self).__init__(port, bound)
            self.autopilot = server.instances[0].autopilot

        def step(self, ms: int) -> int:
            nonlocal wall
            for _ in range(ms // 10):
                wall += 0.010001
                server.turn()
                for _ in range(flood_per_tick):
                    flooder.sendto(flood, self.to)
            self.time_ms = server.now_ms
            return 0

    flood, flood_per_tick = flood_frames()["heartbeats"], 0
    client = Paced()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flooder:
        try:
            client.take_off(499.4)
            client.offboard(1.0, 0.0, 0.0)
            client.fly(1.2, lambda: client.setpoint(1.0, 0.0, 0.0))
            flood_per_tick = 500
            for _ in range(200_000 // (5 * flood_per_tick)):
                client.setpoint(1.0, 0.0, 0.0)
                client.messages.clear()
                client.advance()
                assert client.mode == OFFBOARD
        finally:
            client.udp.close()
            server.close()


@pytest.mark.timeout(120)
def test_a_real_flood_does_not_end_offboard():
    """As fast as another process can send, without pause; the client's setpoints are on time in vehicle time."""
    code = (
        "import socket, sys\n"
        "s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "frame, to = bytes.fromhex(sys.argv[1]), ('127.0.0.1', int(sys.argv[2]))\n"
        f"for _ in range({FLOOD}): s.sendto(frame, to)\n"
    )
    with sitl_process() as sitl, lockstep(sitl) as client:
        client.take_off(499.4)
        client.offboard(1.0, 0.0, 0.0)
        client.fly(1.2, lambda: client.setpoint(1.0, 0.0, 0.0))
        flood = flood_frames()["heartbeats"].hex()
        command = [sys.executable, "-c", code, flood, str(sitl.companion_bind)]
        with subprocess.Popen(command) as flooder:
            try:
                while flooder.poll() is None:
                    client.setpoint(1.0, 0.0, 0.0)
                    client.messages.clear()
                    client.advance()
                    assert client.mode == OFFBOARD
            finally:
                flooder.kill()
        assert client.ask("counters").count("over budget") >= 1


def test_an_interval_set_without_end_fills_no_memory():
    """A stream of half an hour that is replaced must not be kept for half an hour."""
    link = Link("wire", {"HEARTBEAT": 1.0}, 1, Signing(), lambda raw: True)
    tracemalloc.start()
    for _ in range(20_000):
        link.set_interval("ATTITUDE", 1.8e9, 0)
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert size < 200_000
    assert link.interval_us("ATTITUDE") == 1_800_000_000
    assert list(link.due(1000)) == ["HEARTBEAT"]
    assert list(link.due(1_800_000)) == ["HEARTBEAT", "ATTITUDE"]
