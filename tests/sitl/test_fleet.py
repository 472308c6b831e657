"""Many vehicles in one process: numbered as PX4 numbers its instances, stepped together, told apart by system id."""

import math
import socket
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from pymavlink.dialects.v20 import development as mavlink

from sitl.parameters import Parameters
from sitl.px4.personality import PX4
from sitl.server import Options, Server
from tests.sitl.client import Client
from tests.sitl.process import free_udp_port


def free_ports(count: int, step: int = 1) -> int:
    """The first of so many UDP ports in a row that are free, and of TCP ports `step` apart."""
    while True:
        with ExitStack() as stack:
            probe = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            probe.bind(("127.0.0.1", 0))
            first = int(probe.getsockname()[1])
            try:
                for k in range(1, count):
                    one = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    one.bind(("127.0.0.1", first + k))
                for k in range(count):
                    one = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
                    one.bind(("127.0.0.1", first + k * step))
            except (OSError, OverflowError):
                continue
            return first


class Fleet:
    """A server in this process that is stepped by hand, and a client on every companion port."""

    def __init__(self, vehicles: int, **options: object) -> None:
        self.companion_port = free_ports(vehicles)
        self.server = Server(
            Options(
                PX4,
                Parameters(PX4.table),
                companion_port=self.companion_port,
                gcs_port=free_udp_port(),
                companion_bind=0,
                gcs_bind=0,
                lockstep=True,
                vehicles=vehicles,
                **options,  # type: ignore[arg-type] # the options of one test
            )
        )
        bound = [int(line.split()[3].split(":")[1]) for line in self.server.describe() if " companion " in line]
        self.clients = [Client(self.companion_port + k, bound[k]) for k in range(vehicles)]
        for system, client in enumerate(self.clients, 1):
            client.vehicle_system = system

    def advance(self, ms: int) -> list[int]:
        """Frames that each vehicle says it sent."""
        time_ms, *frames = map(int, self.server._step(ms).split())
        for client in self.clients:
            client.time_ms = time_ms
            client.receive()
        return frames

    def close(self) -> None:
        for client in self.clients:
            client.close()
        self.server.close()


@pytest.fixture
def three() -> Iterator[Fleet]:
    fleet = Fleet(3)
    yield fleet
    fleet.close()


def test_every_vehicle_speaks_with_its_own_system_id_on_its_own_port(three):
    for _ in range(60):
        before = [len(client.raw) for client in three.clients]
        frames = three.advance(50)
        assert [len(client.raw) - n for client, n in zip(three.clients, before, strict=True)] == frames
    for system, client in enumerate(three.clients, 1):
        assert {m.get_srcSystem() for m in client.messages} == {system}
        assert client.latest["SYSTEM_TIME"].time_boot_ms == three.clients[0].latest["SYSTEM_TIME"].time_boot_ms


def test_they_start_side_by_side(three):
    three.advance(3000)
    positions = [(m.lat, m.lon) for m in (client.latest["GLOBAL_POSITION_INT"] for client in three.clients)]
    assert len({lat for lat, _ in positions}) == 1
    metre = 1e7 * math.degrees(1 / 6371000.0) / math.cos(math.radians(47.397743))
    for k, (_, lon) in enumerate(positions):
        assert lon - positions[0][1] == pytest.approx(5.0 * k * metre, abs=2)
    assert [client.position for client in three.clients] == [(0.0, 0.0, 0.0)] * 3, "each from its own origin"


def test_a_command_moves_the_vehicle_it_is_for_and_no_other(three):
    three.advance(5000)
    second = three.clients[1]
    for number, *p in ((400, 1), (22, 0, 0, 0, math.nan, math.nan, math.nan, math.nan)):
        second.send(mavlink.MAVLink_command_long_message(2, 1, number, 0, *p, *[0.0] * (7 - len(p))))
        second.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *p, *[0.0] * (7 - len(p))))
    three.advance(100)
    three.advance(9000)
    assert [client.armed for client in three.clients] == [False, True, False]
    assert second.position[2] < -1.0


def test_their_sensors_differ_and_repeat_to_the_bit():
    flights = []
    for _ in range(2):
        fleet = Fleet(2, seed=7)
        try:
            for _ in range(80):
                fleet.advance(50)
            flights.append([client.raw for client in fleet.clients])
            imu = [client.latest["HIGHRES_IMU"].xacc for client in fleet.clients]
            assert imu[0] != imu[1]
        finally:
            fleet.close()
    assert flights[0] == flights[1]
    assert len(flights[0][1]) > 1000


def test_ports_and_system_ids_are_numbered_as_px4_numbers_its_instances():
    """rcS: 14540 + i but never beyond 14549, 14580 + i, 18570 + i, all to 14550; ArduPilot: TCP 5760 + 10 i."""
    first = free_ports(12, 10)
    bind, ground = free_ports(12), free_ports(12)
    options = Options(
        PX4,
        Parameters(PX4.table),
        companion_bind=bind,
        gcs_bind=ground,
        tcp_port=first,
        vehicles=12,
    )
    server = Server(options)
    try:
        lines = server.describe()
    finally:
        server.close()
    expected = []
    for i in range(12):
        expected.append(f"vehicle {i + 1} companion 127.0.0.1:{bind + i} -> 127.0.0.1:{14540 + min(i, 9)}")
        expected.append(f"vehicle {i + 1} gcs 127.0.0.1:{ground + i} -> 127.0.0.1:14550")
        expected.append(f"vehicle {i + 1} tcp 127.0.0.1:{first + 10 * i}")
    assert lines == expected


def test_a_port_taken_closes_those_already_open():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        first = free_ports(3)
        taken.bind(("127.0.0.1", first + 2))
        options = Options(PX4, Parameters(PX4.table), companion_bind=first, gcs_bind=0, vehicles=3)
        with pytest.raises(OSError, match=f"UDP port 127.0.0.1:{first + 2} cannot be bound"):
            Server(options)
    Server(options).close()
