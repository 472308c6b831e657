"""Streams: frames out of bytes, and every kind of wire with a real other end (TCP server, pty, UDP)."""

import os
import pty
import re
import socket
import time
import tty

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.link import Link, LinkError
from autopilot_bridge.url import Serial, Tcp, Udp, parse_url
from autopilot_bridge.wire import split

PORT_WAIT_S = 2.0


def frame(number, system=1):
    codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    return mavlink.MAVLink_attitude_message(number, 0.1, 0.2, 0.3, 0, 0, 0).pack(codec)


def boot_times(messages):
    return [message.time_boot_ms for message in messages]


@given(
    noise=st.lists(st.binary(max_size=40), min_size=6, max_size=6),
    cuts=st.lists(st.integers(0, 400), max_size=8),
)
def test_no_frame_is_lost_to_noise_or_to_where_reads_end(noise, cuts):
    """Noise may hold starts of frames, whose lengths reach over real ones."""
    wanted = [frame(number) for number in range(5)]
    stream = b"".join(n + f for n, f in zip(noise, [*wanted, b""], strict=True)) + bytes(600)
    found, rest = [], b""
    for low, high in zip([0, *sorted(cuts)], [*sorted(cuts), len(stream)], strict=True):
        frames, rest, _ = split(rest + stream[low:high])
        found += frames
    assert [f for f in found if f in wanted] == wanted


def test_a_run_of_noise_counts_once():
    _, _, skipped = split(b"hello" + frame(1) + b"\xfd\x00\x07" + frame(2))
    assert skipped == 2


@pytest.mark.parametrize(
    ("url", "meant"),
    [
        ("udpin://0.0.0.0:14540", Udp("udpin", "0.0.0.0", 14540)),
        ("udpout://10.1.1.1:14580", Udp("udpout", "10.1.1.1", 14580)),
        ("tcp://localhost:5760", Tcp("localhost", 5760)),
        ("serial:///dev/ttyACM0:57600", Serial("/dev/ttyACM0", 57600)),
        ("serial://COM3:921600", Serial("COM3", 921600)),
    ],
)
def test_urls(url, meant):
    assert parse_url(url) == meant


@pytest.mark.parametrize(
    "url",
    [
        "",
        "14540",
        "127.0.0.1:14540",
        "udp://127.0.0.1:14540",
        "UDPIN://127.0.0.1:14540",
        "http://127.0.0.1:80",
        "udpin://127.0.0.1",
        "udpin://:14540",
        "udpin://127.0.0.1:65536",
        "udpin://127.0.0.1:port",
        "udpout://127.0.0.1:0",
        "udpin://me@127.0.0.1:14540",
        "udpin://127.0.0.1:14540/path",
        "udpin://127.0.0.1:14540?a=1",
        "udpin://127.0.0.1:14540#a",
        "serial:///dev/ttyACM0",
        "serial:///dev/ttyACM0:0",
        "serial:///dev/ttyACM0:fast",
    ],
)
def test_what_is_no_url_is_told(url):
    with pytest.raises(ValueError, match=rf"^{re.escape(repr(url))}: "):
        parse_url(url)


def test_udpout_speaks_first():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.bind(("127.0.0.1", 0))
        autopilot.settimeout(5)
        link = Link(f"udpout://127.0.0.1:{autopilot.getsockname()[1]}", 1)
        link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        _, sender = autopilot.recvfrom(1000)
        autopilot.sendto(frame(7), sender)
        assert boot_times(link.receive(2.0)) == [7]
        link.close()


class Server:
    """A TCP autopilot."""

    def __init__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp://127.0.0.1:{self.listener.getsockname()[1]}"

    def accept(self):
        self.listener.settimeout(5)
        connection, _ = self.listener.accept()
        connection.settimeout(5)
        return connection


def hear(link, count, within_s=5.0):
    messages, deadline = [], time.monotonic() + within_s
    while len(messages) < count and time.monotonic() < deadline:
        messages += link.receive(0.1)
    return messages


def test_tcp_carries_frames_in_any_pieces_and_sorts_out_foreign_ones(tmp_path):
    server = Server()
    link = Link(server.url, 1, tmp_path / "flight.tlog")
    with server.accept() as autopilot:
        for byte in frame(1):
            autopilot.send(bytes([byte]))
        autopilot.send(b"noise" + frame(2, system=9) + frame(3) + frame(4))
        assert boot_times(hear(link, 3)) == [1, 3, 4]
        assert (link.counters["foreign"], link.counters["bad_data"]) == (1, 1)
        link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        (heard,) = mavlink.MAVLink(None).parse_buffer(autopilot.recv(1000))
        assert heard.get_type() == "HEARTBEAT"
    logged = (tmp_path / "flight.tlog").read_bytes()
    assert len(logged) == sum(8 + len(f) for f in (frame(1), frame(2), frame(3), frame(4))) + 8 + 21
    link.close()
    server.listener.close()


def test_tcp_that_breaks_is_silence_and_comes_back():
    server = Server()
    link = Link(server.url, 1)
    with server.accept() as autopilot:
        autopilot.send(frame(1))
        assert boot_times(hear(link, 1)) == [1]
    assert hear(link, 1, within_s=0.3) == []
    link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))  # to nobody, without a word
    assert hear(link, 1, within_s=1.2) == []
    with server.accept() as autopilot:
        autopilot.send(frame(2))
        assert boot_times(hear(link, 1)) == [2]
    link.close()
    server.listener.close()


def test_a_tcp_peer_that_does_not_read_costs_whole_frames_and_no_time():
    server = Server()
    link = Link(server.url, 1)
    with server.accept() as autopilot:
        started = time.monotonic()
        while not link.counters["send_failed"]:
            link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
            assert link.counters["frames_out"] < 1_000_000
        assert time.monotonic() - started < 60
        parser, whole = mavlink.MAVLink(None), 0
        autopilot.settimeout(0.5)
        while True:
            link.receive(0.0)  # writes what waited
            try:
                data = autopilot.recv(65536)
            except TimeoutError:
                break
            whole += len(parser.parse_buffer(data) or [])
    assert parser.total_receive_errors == 0
    assert whole == link.counters["frames_out"] - link.counters["send_failed"]
    link.close()
    server.listener.close()


def test_nobody_at_the_tcp_port_is_told(monkeypatch):
    monkeypatch.setattr("autopilot_bridge.wire.CONNECT_WALL_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(LinkError, match=rf"autopilot tcp://127.0.0.1:{port}: cannot be opened: Connection refused"):
        Link(f"tcp://127.0.0.1:{port}", 1)


def test_a_serial_line():
    autopilot, ours = pty.openpty()
    tty.setraw(ours)
    link = Link(f"serial://{os.ttyname(ours)}:57600", 1)
    os.write(autopilot, b"boot text\n" + frame(1) + frame(2))
    assert boot_times(hear(link, 2)) == [1, 2]
    link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    (heard,) = mavlink.MAVLink(None).parse_buffer(os.read(autopilot, 1000))
    assert heard.get_type() == "HEARTBEAT"
    link.close()
    os.close(autopilot)
    os.close(ours)


def test_a_missing_serial_line_is_told():
    with pytest.raises(LinkError, match=r"autopilot serial:///dev/nothing:57600: cannot be opened.*nothing"):
        Link("serial:///dev/nothing:57600", 1)
