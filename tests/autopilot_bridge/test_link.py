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

from autopilot_bridge.link import ControlLine, Link, LinkError


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
