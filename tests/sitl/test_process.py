"""The SITL as a process: control socket, determinism, pacing, what happens when its master goes, bad input."""

import itertools
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from pymavlink.dialects.v20 import development as mavlink
from typer.testing import CliRunner

from sitl.cli import sitl as sitl_command
from sitl.px4.streams import COMPANION_RATES_HZ
from tests.sitl.client import Lockstep, direct, lockstep
from tests.sitl.process import free_udp_port, sitl_process


def test_lockstep_repeats_to_the_bit():
    """Same seed, same inputs: the same telemetry bytes at PX4's companion rates."""
    flights = []
    for _ in range(2):
        with sitl_process("--seed", "5") as sitl, lockstep(sitl) as client:
            client.take_off()
            client.offboard(2.0, -1.0, -0.5)
            client.fly(3, lambda client=client: client.setpoint(2.0, -1.0, -0.5, yaw=0.3))
            flights.append(client.raw)
    assert len(flights[0]) > 4000
    assert flights[0] == flights[1]


def test_seed_changes_the_sensors_not_the_flight():
    shown = []
    for seed in (1, 2):
        with direct(COMPANION_RATES_HZ, seed=seed) as client:
            client.take_off()
            shown.append((client.latest["HIGHRES_IMU"].xacc, client.position, client.latest["ATTITUDE"].yaw))
    assert shown[0][0] != shown[1][0]
    assert shown[0][1:] == shown[1][1:]


def test_control_socket():
    """docs/architecture.md, "The SITL's control socket"."""
    with sitl_process() as sitl, lockstep(sitl) as client:
        assert client.ask("hello") == "aerialstar-sitl 1 0"
        assert client.ask("advance 1") == "advanced 1 0"
        assert client.ask("advance 999").startswith("advanced 1000 ")
        client.receive()
        for bad in ("advance", "advance 0", "advance -5", "advance 1.5", "advance 9999999", "jump 3", "", "hello you"):
            assert client.ask(bad).startswith("error "), bad
        with socket.create_connection(("127.0.0.1", sitl.control)) as second, second.makefile() as replies:
            second.sendall(b"advance 50\nhello\n")
            assert replies.readline() == "error advance: the clock belongs to another control client\n"
            assert replies.readline() == "aerialstar-sitl 1 1000\n"
        before = len(client.messages)
        for _ in range(100):
            frames = client.advance(50)
            assert len(client.messages) - before == frames  # every frame counted has arrived
            before = len(client.messages)
        assert client.time_ms == 6000
        assert client.ask("quit") == "bye"
        assert sitl.process.wait(5) == 0


def test_a_second_control_client_that_resets_its_connection_does_no_harm():
    """SO_LINGER of 0 s: the other end sees ECONNRESET, before it accepts the client or while it answers it."""
    with sitl_process() as sitl, lockstep(sitl) as client:
        assert client.ask("hello").startswith("aerialstar-sitl")
        for paused in (False, True):
            for _ in range(10):
                if paused:
                    sitl.process.send_signal(signal.SIGSTOP)
                with socket.create_connection(("127.0.0.1", sitl.control)) as second:
                    second.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                if paused:
                    sitl.process.send_signal(signal.SIGCONT)
                assert client.ask("advance 20").startswith("advanced ")
        assert sitl.process.poll() is None


def test_stands_still_while_the_client_is_silent_and_ends_by_sigterm():
    with sitl_process(speed=100) as sitl, lockstep(sitl) as client:
        client.advance(50)
        time.sleep(0.2)
        assert client.ask("hello") == "aerialstar-sitl 1 50"
        sitl.process.terminate()
        assert sitl.process.wait(10) == 0


def test_flies_on_and_ends_when_the_client_goes():
    """Paced again without its client: the autopilot's own failsafe acts; then it ends (`--exit-when-landed`)."""
    with sitl_process("--exit-when-landed", speed=50, parameters={"COM_OBL_RC_ACT": 4}) as sitl:
        client = Lockstep(sitl)
        client.take_off()
        client.offboard(3.0, 0.0, 0.0)
        client.fly(3, lambda: client.setpoint(3.0, 0.0, 0.0))
        client.replies.close()
        client.tcp.close()
        assert sitl.process.wait(20) == 0
        client.receive()
        assert "Failsafe activated" in client.texts()
        assert client.texts()[-1] == "Disarmed by landing"
        assert client.position[2] == pytest.approx(0, abs=1e-6)
        client.udp.close()


def test_ends_at_once_when_it_never_flew():
    with sitl_process("--exit-when-landed") as sitl:
        Lockstep(sitl).close()
        assert sitl.process.wait(10) == 0


def test_paced_clock_follows_the_wall_at_any_speed_without_jumps():
    """Vehicle time is at most speed x wall time, grows steadily and never jumps."""
    with (
        sitl_process(lockstep=False, speed=20) as sitl,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
    ):
        udp.bind(("127.0.0.1", sitl.companion))
        udp.settimeout(5)
        mav = mavlink.MAVLink(None)
        stamps: list[int] = []
        started = time.monotonic()
        while not stamps or stamps[-1] < stamps[0] + 5_000:
            message = mav.decode(bytearray(udp.recv(65535)))
            if message.get_type() == "ATTITUDE":
                stamps.append(message.time_boot_ms)
        wall = time.monotonic() - started
        assert wall > 5 / 20 * 0.8
        assert {b - a for a, b in itertools.pairwise(stamps)} == {10}


def test_listens_on_loopback_only_and_ends_by_sigint():
    with sitl_process(lockstep=False) as sitl:
        process = Path(f"/proc/{sitl.process.pid}")
        targets = [str(descriptor.readlink()) for descriptor in (process / "fd").iterdir()]
        inodes = {target[8:-1] for target in targets if target.startswith("socket:[")}
        rows = [
            line.split()
            for table in ("tcp", "udp", "tcp6", "udp6")
            for line in (process / "net" / table).read_text().splitlines()[1:]
        ]
        addresses = [row[1].split(":")[0] for row in rows if row[9] in inodes]
        assert len(addresses) == 5, "a control socket, and for each link one for everybody and one for its peer"
        assert set(addresses) == {"0100007F"}
        sitl.process.send_signal(signal.SIGINT)
        assert sitl.process.wait(10) == 0


def test_a_signal_that_came_at_a_bad_moment_is_not_lost():
    """One inside `except Exception` passes through, one that a destructor swallows ends the run all the same."""
    code = """if True:
        import os, signal, sys
        from sitl import server
        from sitl.cli import sitl
        import typer
        compile_now, moment = server.compile_now, sys.argv.pop(1)
        class Dies:
            def __del__(self):
                os.kill(os.getpid(), signal.SIGTERM)
        def interrupted(*arguments):
            compile_now(*arguments)
            if moment == "destructor":
                Dies()
            else:
                try:
                    os.kill(os.getpid(), signal.SIGTERM)
                except Exception:
                    pass
        server.compile_now = interrupted
        typer.run(sitl)
    """
    ports = ["--gcs-bind", "0", "--companion-bind", "0", "--companion-port", str(free_udp_port())]
    for moment in ("destructor", "handler"):
        command = [sys.executable, "-c", code, moment, *ports, "--gcs-port", str(free_udp_port())]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--param", "NO_SUCH=1"], ["NO_SUCH", "unknown"]),
        (["--param", "SIH_MASS=-1"], ["SIH_MASS", "-1", "0.1 to 100"]),
        (["--speed", "0"], ["--speed", "0"]),
        (["--home", "47,8"], ["--home", "47,8", "LAT,LON,ALT"]),
        (["--home", "99,8,0"], ["--home", "-85 to 85"]),
        (["--system-id", "0"], ["--system-id"]),
        (["--system-id", "249", "--vehicles", "3"], ["--vehicles", "3 vehicles", "249", "250"]),
        (["--vehicles", "0"], ["--vehicles"]),
        (["--companion-port", "65535", "--vehicles", "2"], ["companion", "65536", "65535"]),
        (["--signing-key", "/nowhere/key"], ["--signing-key", "/nowhere/key", "cannot be read"]),
    ],
)
def test_bad_options_are_refused(arguments, words):
    app = typer.Typer()
    app.command()(sitl_command)
    done = CliRunner().invoke(app, [*arguments, "--gcs-bind", "0", "--companion-bind", "0"])
    assert done.exit_code == 2
    assert done.stderr.startswith(("error: ", "Usage: "))
    assert all(word in done.stderr for word in words), done.stderr


def test_port_in_use_is_one_clear_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = str(taken.getsockname()[1])
        command = [sys.executable, "-m", "sitl", "--companion-bind", port, "--gcs-bind", "0"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert port in done.stderr
    assert "companion" in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: ")


def test_help_needs_no_heavy_imports():
    code = "import sys, sitl.cli; print(*{'numba', 'numpy', 'pymavlink'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout == b"\n"


def test_another_client_may_come_beside_the_first(vehicle):
    """Everybody who speaks on a link is served, and forgotten after 10 s of silence; the configured peer never is."""
    vehicle.fly(2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", free_udp_port()))
        other.setblocking(False)
        other.sendto(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(vehicle.mav), vehicle.to)
        seen = len(vehicle.messages)
        vehicle.fly(11)
        assert len(vehicle.messages) > seen + 500
        while True:
            try:
                assert other.recv(65535)
            except BlockingIOError:
                break
        seen = len(vehicle.messages)
        vehicle.fly(2)
        assert len(vehicle.messages) > seen + 100
        with pytest.raises(BlockingIOError):
            other.recv(65535)
