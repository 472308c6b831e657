import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.bell import Bell
from autopilot_bridge.link import ControlLine, Link, LinkError
from autopilot_bridge.wire import MOST_AT_ONCE


class Autopilot:
    """The other end of the link, on pymavlink alone."""

    def __init__(self, link, system=1, component=1):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5)
        self.target = ("127.0.0.1", link.port)
        self.codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def frame(self, boot_ms=1000):
        return mavlink.MAVLink_attitude_message(boot_ms, 0.1, 0.2, 0.3, 0, 0, 0).pack(self.codec)

    def send(self, data):
        self.socket.sendto(data, self.target)

    def receive(self):
        return self.codec.parse_buffer(self.socket.recv(4096))


@pytest.fixture
def link(tmp_path):
    link = Link("udpin://127.0.0.1:0", system_id=1, tlog=tmp_path / "flight.tlog")
    yield link
    link.close()


def read_log(path):
    log = mavutil.mavlink_connection(str(path), notimestamps=False)
    messages = []
    while (message := log.recv_match()) is not None:
        messages.append(message)
    return messages


def heard(link, count):
    """So many datagrams' messages: those of one sender come in order, others in between."""
    messages, before = [], link.datagrams
    while link.datagrams < before + count:
        messages += link.receive(5.0)
    return messages


def hello(boot_ms=0):
    return mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


def test_frames_travel_both_ways_and_are_logged(link, tmp_path):
    autopilot = Autopilot(link)
    link.send(hello())
    assert link.counters["sent_to_nobody"] == 1
    autopilot.send(autopilot.frame() + autopilot.frame())
    assert [m.get_type() for m in link.receive(1.0)] == ["ATTITUDE", "ATTITUDE"]
    link.send(hello())
    (answer,) = autopilot.receive()
    assert (answer.get_type(), answer.get_srcSystem(), answer.get_srcComponent()) == ("HEARTBEAT", 245, 191)
    assert [m.get_type() for m in read_log(tmp_path / "flight.tlog")] == ["ATTITUDE", "ATTITUDE", "HEARTBEAT"]


def test_foreign_systems_and_components_are_logged_but_not_heard(link, tmp_path):
    for system, component in ((255, 190), (2, 1), (1, 154)):
        other = Autopilot(link, system, component)
        other.send(other.frame())
    time.sleep(0.05)
    assert link.receive(1.0) == []
    assert link.counters["foreign"] == 3
    link.send(hello())
    assert link.counters["sent_to_nobody"] == 1  # and nobody but the vehicle is answered
    assert len(read_log(tmp_path / "flight.tlog")) == 3


@pytest.mark.parametrize(
    "spoil",
    [
        lambda frame: b"",
        lambda frame: b"hello",
        lambda frame: frame[:-1],
        lambda frame: frame[:-1] + bytes([frame[-1] ^ 1]),
        lambda frame: frame[:20] + bytes([frame[20] ^ 0x40]) + frame[21:],
        lambda frame: frame + b"\xfd\x09",
    ],
    ids=["empty", "text", "short", "checksum", "payload", "tail"],
)
def test_bad_data_is_counted_and_the_next_frame_is_fine(link, spoil):
    autopilot = Autopilot(link)
    spoilt = spoil(autopilot.frame())
    autopilot.send(spoilt)
    autopilot.send(autopilot.frame())
    time.sleep(0.05)
    assert link.receive(1.0)[-1].get_type() == "ATTITUDE"
    assert link.counters["bad_data"] == (1 if spoilt else 0)


def test_a_stranger_with_the_vehicles_name_is_neither_heard_nor_answered(link):
    autopilot, stranger = Autopilot(link), Autopilot(link)
    for boot_ms in range(20):
        autopilot.send(autopilot.frame(boot_ms))
        stranger.send(stranger.frame(99))
        assert [m.time_boot_ms for m in heard(link, 2)] == [boot_ms]
        link.send(hello())
        assert autopilot.receive()
    assert link.counters["rival"] == 20
    assert "both speak as system 1" in link.roll_call.objection()
    stranger.socket.setblocking(False)
    with pytest.raises(BlockingIOError):
        stranger.socket.recv(4096)


def test_a_vehicle_that_moves_to_another_port_is_followed_once_only_it_speaks(link, monkeypatch):
    monkeypatch.setattr("autopilot_bridge.roll_call.HANDOVER_WALL_S", 0.1)
    before, after = Autopilot(link), Autopilot(link)
    before.send(before.frame(1))
    assert [m.time_boot_ms for m in heard(link, 1)] == [1]
    after.send(after.frame(2))
    assert heard(link, 1) == []
    time.sleep(0.1)
    after.send(after.frame(3))
    assert [m.time_boot_ms for m in heard(link, 1)] == [3]
    assert link.roll_call.objection() == ""
    link.send(hello())
    assert after.receive()
    before.send(before.frame(4))  # and now the old place is the stranger's
    assert heard(link, 1) == []


def test_only_what_is_wanted_is_decoded_and_all_is_heard_and_logged(link, tmp_path):
    link.wanted, passed = {mavlink.MAVLINK_MSG_ID_SYSTEM_TIME}, []
    link.listener = passed.append
    autopilot = Autopilot(link)
    sent = [autopilot.frame(), mavlink.MAVLink_system_time_message(0, 7).pack(autopilot.codec)]
    foreign = Autopilot(link, system=2)
    autopilot.send(sent[0] + foreign.frame() + sent[1])
    assert [m.get_type() for m in heard(link, 1)] == ["SYSTEM_TIME"]
    assert (link.heard, link.counters["foreign"], passed) == (2, 1, sent)
    assert len(read_log(tmp_path / "flight.tlog")) == 3


def test_old_frames_of_mavlink_1_are_understood_and_those_of_a_mavlink_to_come_are_not(link):
    autopilot = Autopilot(link)
    message = mavlink.MAVLink_attitude_message(5, 0.1, 0.2, 0.3, 0, 0, 0)
    autopilot.send(message.pack(autopilot.codec, force_mavlink1=True))
    assert [m.time_boot_ms for m in heard(link, 1)] == [5]
    to_come = bytearray(autopilot.frame())
    to_come[2] = 0x02
    autopilot.send(bytes(to_come))
    assert heard(link, 1) == []
    assert link.counters["bad_data"] == 1


def test_the_bell_ends_the_waiting():
    bell = Bell()
    link = Link("udpin://127.0.0.1:0", 1, bell=bell)
    threading.Timer(0.05, bell.ring).start()
    start = time.monotonic()
    assert link.receive(60.0) == []
    assert time.monotonic() - start < 30
    start = time.monotonic()
    assert link.receive(0.05) == []  # it was heard, once
    assert time.monotonic() - start >= 0.05
    link.close()
    bell.close()


def test_a_flood_does_not_keep_us_from_flying(link):
    flood = Autopilot(link, system=9)
    for _ in range(MOST_AT_ONCE + 10):
        flood.send(flood.frame())
    time.sleep(0.05)
    link.receive(1.0)
    assert link.datagrams == MOST_AT_ONCE
    link.receive(1.0)
    assert link.datagrams == MOST_AT_ONCE + 10


def test_a_full_disk_leaves_whole_records_and_the_log_goes_on_when_there_is_room(tmp_path):
    program = """
import resource, signal, socket, sys
from pathlib import Path
from autopilot_bridge.link import Link
from pymavlink.dialects.v20 import common as mavlink
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
link = Link("udpin://127.0.0.1:0", 1, Path(sys.argv[1]))
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
short, long = mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 1), mavlink.MAVLink_statustext_message(4, b"a" * 50)
whole = 0
for message, room in [(short, 1000), (long, 110), (long, 110), (short, 1000)]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, 1000))
    frame = message.pack(codec)
    whole += 8 + len(frame) if message is short else 0
    out.sendto(frame, ("127.0.0.1", link.port))
    assert len(link.receive(5.0)) == 1
print(link.counters["log_failed"], whole)
"""
    path = tmp_path / "flight.tlog"
    result = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, timeout=60)
    assert result.stdout == f"2 {path.stat().st_size}\n", result.stderr
    assert [m.get_type() for m in read_log(path)] == ["ATTITUDE", "ATTITUDE"]


def test_the_log_runs_on_vehicle_time(link, tmp_path):
    autopilot, clock = Autopilot(link), [100.0]
    autopilot.send(autopilot.frame())
    link.receive(1.0)
    link.stamp_by(lambda: clock[0])
    for clock[0] in (100.0, 150.0):
        autopilot.send(autopilot.frame())
        link.receive(1.0)
    stamps = [m._timestamp for m in read_log(tmp_path / "flight.tlog")]
    assert stamps[0] == pytest.approx(time.time(), abs=60)
    assert stamps == sorted(stamps)
    assert stamps[2] - stamps[1] == pytest.approx(50.0, abs=0.001)


def test_mavlogdump_reads_the_log(link, tmp_path):
    autopilot = Autopilot(link)
    autopilot.send(autopilot.frame())
    link.receive(1.0)
    dump = Path(sys.executable).with_name("mavlogdump.py")
    result = subprocess.run(
        [sys.executable, str(dump), str(tmp_path / "flight.tlog")], capture_output=True, text=True, timeout=60
    )
    assert "ATTITUDE {time_boot_ms : 1000, roll : 0.1" in result.stdout


def test_the_log_is_whole_after_a_kill(tmp_path):
    program = """
import socket, sys, time
from pathlib import Path
from autopilot_bridge.link import Link
from pymavlink.dialects.v20 import common as mavlink
link = Link("udpin://127.0.0.1:0", 1, Path(sys.argv[1]))
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
for i in range(1000000):
    out.sendto(mavlink.MAVLink_attitude_message(i, 0, 0, 0, 0, 0, 0).pack(codec), ("127.0.0.1", link.port))
    link.receive(1.0)
    if i % 10 == 0:
        print(i, flush=True)
        time.sleep(0.001)
"""
    path = tmp_path / "flight.tlog"
    process = subprocess.Popen([sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True)
    while (last := int(process.stdout.readline())) < 100:
        pass
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    data, count = path.read_bytes(), 0
    while data:
        assert data[8] == 0xFD
        size = 12 + data[9]
        assert len(data) >= 8 + size, "a torn record"
        data, count = data[8 + size :], count + 1
    assert count > last


def test_faults_can_be_injected(tmp_path):
    lost = iter([True, False, True, False])
    link = Link(
        "udpin://127.0.0.1:0",
        1,
        tamper_in=lambda datagram: () if next(lost) else (datagram, datagram),
    )
    autopilot = Autopilot(link)
    for boot_ms in range(4):
        autopilot.send(autopilot.frame(boot_ms))
    time.sleep(0.05)
    assert [m.time_boot_ms for m in link.receive(1.0)] == [1, 1, 3, 3]
    assert link.datagrams == 4
    link.close()


def test_a_port_in_use_is_told(link):
    with pytest.raises(LinkError, match=rf"udpin://127.0.0.1:{link.port}: cannot listen there"):
        Link(f"udpin://127.0.0.1:{link.port}", 1)


def test_an_unwritable_log_is_told(tmp_path):
    with pytest.raises(LinkError, match=r"missing/flight.tlog: cannot be written"):
        Link("udpin://127.0.0.1:0", 1, tlog=tmp_path / "missing" / "flight.tlog")


def test_nothing_is_waited_for_beyond_the_timeout(link):
    start = time.monotonic()
    assert link.receive(0.05) == []
    assert time.monotonic() - start < 5


class Control:
    """A control socket that says what it is told to."""

    def __init__(self, *answers):
        self.server = socket.create_server(("127.0.0.1", 0))
        self.name = f"127.0.0.1:{self.server.getsockname()[1]}"
        self.answers = answers

    def __call__(self):
        connection, _ = self.server.accept()
        lines = connection.makefile("rw", encoding="utf-8", newline="\n")
        self.asked = []
        for answer in self.answers:
            self.asked.append(lines.readline().strip())
            lines.write(answer + "\n")
            lines.flush()
        connection.close()


@pytest.fixture
def serve():
    threads = []

    def start(*answers):
        control = Control(*answers)
        thread = threading.Thread(target=control)
        thread.start()
        threads.append((thread, control))
        return control

    yield start
    for thread, control in threads:
        thread.join(5)
        control.server.close()


def test_control_line_speaks_the_protocol(serve):
    control = serve("aerialstar-sitl 1 1500", "advanced 1550 12", "bye")
    line = ControlLine(control.name)
    assert line.hello() == 1.5
    assert line.advance(50) == (1.55, 12)
    line.quit()
    line.close()
    assert control.asked == ["hello", "advance 50", "quit"]


@pytest.mark.parametrize("answer", ["aerialstar-sitl 2 0", "error what?", ""])
def test_a_wrong_answer_is_told(serve, answer):
    control = serve(answer)
    line = ControlLine(control.name)
    with pytest.raises(LinkError, match=r"control 127\.0\.0\.1"):
        line.hello()
    line.close()


def test_nobody_at_the_control_port_is_told():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    with pytest.raises(LinkError, match=f"127.0.0.1:{port}: nobody listens"):
        ControlLine(f"127.0.0.1:{port}", timeout_s=0.2)


def test_a_log_record_is_a_stamp_and_a_frame(link, tmp_path):
    autopilot = Autopilot(link)
    frame = autopilot.frame()
    autopilot.send(frame)
    link.receive(1.0)
    record = (tmp_path / "flight.tlog").read_bytes()
    assert struct.unpack(">Q", record[:8])[0] == pytest.approx(time.time() * 1e6, abs=60e6)
    assert record[8:] == frame
