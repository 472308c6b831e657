"""The control socket with several clients: one owns the clock, none disturbs another (docs/architecture.md)."""

import json
import socket
import time
from typing import TextIO

import pytest

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
