"""The control socket with several clients: one owns the clock, none disturbs another (docs/architecture.md)."""

import contextlib
import json
import socket
import time
from collections.abc import Iterator
from typing import TextIO

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.injection import INJECTIONS
from sitl.parameters import Parameters
from sitl.px4.personality import PX4
from sitl.server import Options, Server
from tests.sitl.client import lockstep
from tests.sitl.process import sitl_process


def frames_sent(client: socket.socket, replies: TextIO) -> int:
    """As the vehicle counts them."""
    client.sendall(b"counters\n")
    return int(json.loads(replies.readline().removeprefix("counters "))["companion 0"]["sent"])


def ask_for_ever(client: socket.socket) -> None:
    """Raises OSError once the connection is gone."""
    while True:
        client.sendall(b"counters\n" * 100)


def test_several_clients_do_not_mix_their_lines():
    """Requests in pieces and in heaps, from several at once: every client gets its own answers, in order."""
    with sitl_process() as sitl, lockstep(sitl) as owner:
        others = [socket.create_connection(("127.0.0.1", sitl.control)) for _ in range(3)]
        for number, other in enumerate(others):
            other.sendall(b"hel" if number else b"nonsense\nhello\n\n")
        assert owner.ask("advance 1100").startswith("advanced 1100 ")
        for other in others[1:]:
            other.sendall(b"lo\nadvance 10\nvehicle 1 counters\nvehicle 9 counters\ncounters all\n")
        assert owner.ask("advance 100").startswith("advanced 1200 ")
        with others[0], others[0].makefile() as replies:
            assert [replies.readline().split()[0] for _ in range(3)] == ["error", "aerialstar-sitl", "error"]
        for other in others[1:]:
            with other, other.makefile() as replies:
                assert replies.readline().startswith("aerialstar-sitl 1 ")
                assert replies.readline() == "error advance: the clock belongs to another control client\n"
                assert json.loads(replies.readline().removeprefix("counters "))["companion 0"]["sent"] > 0
                assert replies.readline() == "error vehicle: '9' is no system id, 1 are\n"
                assert replies.readline().startswith("error counters: takes no argument")
        assert owner.ask("hello") == "aerialstar-sitl 1 1200"


def test_who_only_asks_does_not_stop_the_clock_and_owners_may_follow_each_other():
    with (
        sitl_process(lockstep=False, speed=50) as sitl,
        socket.create_connection(("127.0.0.1", sitl.control)) as watcher,
        watcher.makefile() as replies,
    ):
        for _ in range(2):
            before = frames_sent(watcher, replies)
            while frames_sent(watcher, replies) <= before + 100:
                pass  # it moves, though a client is connected
            with lockstep(sitl) as owner:
                time_ms = owner.time_ms
                owner.advance(50)
                before = frames_sent(watcher, replies)
                time.sleep(0.1)
                assert frames_sent(watcher, replies) == before
                assert owner.ask("hello") == f"aerialstar-sitl 1 {time_ms + 50}"


def test_a_client_that_does_not_read_holds_up_nobody():
    """It is dropped; whether it hears of that depends on where its kernel stands."""
    with sitl_process() as sitl, lockstep(sitl) as owner:
        with socket.create_connection(("127.0.0.1", sitl.control)) as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.settimeout(5)
            with pytest.raises((ConnectionResetError, BrokenPipeError, TimeoutError)):
                ask_for_ever(deaf)
        assert owner.ask("advance 50").startswith("advanced 50 ")


numbers = st.one_of(
    st.integers(-5, 10**12).map(str), st.floats().map(repr), st.sampled_from(["", "nan", "-1", "1e400"])
)
words = st.one_of(
    st.sampled_from([*INJECTIONS, "hello", "vehicle", "counters", "inject", "1", "2"]), numbers, st.text()
)
lines = st.one_of(
    st.text(max_size=80),
    st.lists(words, max_size=5).map(" ".join),
    st.tuples(st.sampled_from(sorted(INJECTIONS)), st.lists(numbers, max_size=4)).map(
        lambda made: " ".join(("inject", made[0], *made[1]))
    ),
)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """In this process, its clock owned by nobody."""
    options = Options(
        PX4, Parameters(PX4.table), companion_bind=0, gcs_bind=0, gcs_port=1, companion_port=2, lockstep=True
    )
    one = Server(options)
    yield one
    one.close()


@settings(max_examples=300, deadline=None)
@given(st.lists(lines, max_size=6))
def test_any_lines_get_an_answer_each_and_leave_a_vehicle_that_moves(server: Server, asked: list[str]):
    """One line of answer per line, whatever it says."""
    asked = [line.replace("\n", " ") for line in asked if line.strip() != "quit"]
    assert server._control is not None
    with socket.create_connection(("127.0.0.1", server._control.port)) as client:
        pending = b""
        client.sendall("".join(f"{line}\n" for line in [*asked, "advance 10"]).encode("utf-8", "replace"))
        server.turn()  # accepts
        answers = []
        while len(answers) <= len(asked):
            server.turn()
            client.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                pending += client.recv(1 << 20)
            *answers, _ = pending.split(b"\n")
        assert answers[-1].startswith(b"advanced ")
        assert all(answers)
    while server._control.owner is not None:
        server.turn()
    assert not server.instances[0].autopilot.defects
