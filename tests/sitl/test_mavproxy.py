"""MAVProxy 1.8, which nobody here wrote, driven by its command line through a pipe; a second client watches where
the vehicle goes."""

import importlib.util
import math
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sitl.conformance import parameters, plans
from sitl.conformance.run import meet
from sitl.conformance.vehicle import ON_GROUND, Vehicle
from sitl.conformance.wire import connect
from tests.sitl.plans import ORIGIN
from tests.sitl.process import SitlProcess, sitl_process, step

if importlib.util.find_spec("MAVProxy") is None:
    pytest.skip("MAVProxy is not installed: pip install --no-deps MAVProxy", allow_module_level=True)

SPEED = 3.0
LIMIT_S = 25.0


class Proxy:
    """A MAVProxy at work."""

    def __init__(self, master: str, folder: Path) -> None:
        self.folder = folder
        command = [sys.executable, "-u", str(Path(sys.executable).with_name("mavproxy.py")), f"--master={master}"]
        command += [f"--state-basedir={folder}", f"--logfile={folder / 'flight.tlog'}", "--streamrate=1"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder
        )
        self._lines: list[str] = []
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        for line in self._process.stdout:
            with self._news:
                self._lines.append(line.rstrip())
                self._news.notify_all()

    def say(self, line: str) -> int:
        """Type a line; from where on to look for what it answers."""
        with self._news:
            seen = len(self._lines)
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return seen

    def expect(self, pattern: str, since: int = 0) -> re.Match:
        """Wait for a line that holds the pattern."""

        def found() -> re.Match | None:
            return next((match for line in self._lines[since:] if (match := re.search(pattern, line))), None)

        with self._news:
            assert self._news.wait_for(found, LIMIT_S), f"no {pattern!r} in {self._lines[since:]}"
            return found()

    def ask(self, line: str, pattern: str) -> re.Match:
        return self.expect(pattern, self.say(line))

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        self._process.stdin.close()
        self._process.stdout.close()


class Flight:
    """A MAVProxy, and who watches."""

    def __init__(self, proxy: Proxy, watcher: Vehicle) -> None:
        self.proxy, self.watcher = proxy, watcher

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait; at most so long on the wall clock, which is MAVProxy's."""
        self.watcher.until(condition, LIMIT_S * SPEED, what)

    def repeat(self, line: str, condition: Callable[[], object], what: str) -> None:
        """Type a line again and again until the condition holds."""
        end = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < end, what
            self.proxy.say(line)
            self.watcher.go_on(0.5)

    @property
    def north(self) -> float:
        return self.watcher.now.position[0]

    @property
    def height(self) -> float:
        return -self.watcher.now.position[2]

    def take_off(self, height: float) -> None:
        self.proxy.ask("mode GUIDED", "Mode GUIDED")
        self.proxy.ask("arm throttle", "ARMED")
        self.proxy.ask(f"takeoff {height}", "NAV_TAKEOFF: ACCEPTED")
        self.until(lambda: abs(self.height - height) < 0.5, "height reached")

    def come_down(self) -> None:
        self.proxy.say("mode RTL")
        self.until(lambda: not self.watcher.armed, "landed and disarmed")


@contextmanager
def flight(sitl: SitlProcess, master: str, folder: Path) -> Iterator[Flight]:
    watcher = Vehicle(connect(f"udpout:127.0.0.1:{sitl.gcs_bind}"))
    proxy = Proxy(master, folder)
    try:
        meet(watcher)
        watcher.until(lambda: watcher.ready and "LOCAL_POSITION_NED" in watcher.latest, 60.0, "ready")
        proxy.expect(r"Received \d+ parameters")
        yield Flight(proxy, watcher)
    finally:
        proxy.close()
        watcher.wire.close()


@pytest.fixture(scope="module")
def copter(tmp_path_factory) -> Iterator[Flight]:
    """On an ArduCopter that has booted already, by TCP."""
    arguments = ["--personality", "arducopter", "--tcp-port", "0"]
    with sitl_process(*arguments, lockstep=False, speed=SPEED, parameters={"RTL_ALT": 800}) as sitl:
        step(sitl, 43_000)
        with flight(sitl, f"tcp:127.0.0.1:{sitl.tcp}", tmp_path_factory.mktemp("mavproxy")) as flown:
            yield flown


def written(path: Path, *rows: tuple) -> Path:
    """A plan as text, the way MAVProxy loads it: current, frame, command, p1 to p4, latitude, longitude, altitude."""
    lines = ["QGC WPL 110"]
    for seq, (frame, command, p1, north, east, up) in enumerate(rows):
        latitude, longitude = ORIGIN.globe(north, east)
        lines.append("\t".join(map(str, (seq, 0, frame, command, p1, 0, 0, 0, latitude, longitude, up, 1))))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_mode_arm_takeoff_velocity_and_return(copter):
    copter.take_off(6.0)
    copter.repeat("velocity 3 0 0", lambda: copter.north > 8.0, "north of 8 m")
    assert copter.watcher.now.velocity[0] == pytest.approx(3.0, abs=0.5)
    assert copter.height == pytest.approx(6.0, abs=0.7)
    copter.repeat("velocity 0 0 0", lambda: copter.watcher.now.speed < 0.2, "stopped")
    copter.come_down()
    assert copter.watcher.landed == ON_GROUND
    assert copter.watcher.now.position == pytest.approx((0.0, 0.0, 0.0), abs=0.6)


def test_param(copter):
    copter.proxy.ask("param show GUID_TIMEOUT", r"GUID_TIMEOUT\s+3\.0")
    copter.proxy.say("param set GUID_TIMEOUT 2.5")
    copter.until(lambda: parameters.read(copter.watcher, "GUID_TIMEOUT").value == 2.5, "set")
    copter.proxy.ask("param show GUID_TIMEOUT", r"GUID_TIMEOUT\s+2\.5")
    copter.proxy.say("param set GUID_TIMEOUT 3")
    copter.until(lambda: parameters.read(copter.watcher, "GUID_TIMEOUT").value == 3.0, "set back")


def test_wp_load_list_and_flown(copter, tmp_path):
    plan = written(
        tmp_path / "wp.txt",
        (0, 16, 0, 0.0, 0.0, ORIGIN.altitude),
        (3, 22, 0, 0.0, 0.0, 6.0),
        (3, 16, 0, 12.0, 0.0, 8.0),
        (3, 21, 0, 12.0, 7.0, 0.0),
    )
    copter.proxy.ask(f"wp load {plan}", "TYPE_MISSION: ACCEPTED")
    asked = copter.proxy.say("wp list")
    copter.proxy.expect("Requesting 4 waypoints", asked)
    copter.proxy.expect("Saved waypoints", asked)
    commands = [line.split("\t")[3] for line in (copter.proxy.folder / "way.txt").read_text().splitlines()[1:]]
    assert commands == ["16", "22", "16", "21"]
    copter.proxy.ask("mode GUIDED", "Mode GUIDED")
    with copter.watcher.track() as track:
        copter.proxy.ask("arm throttle", "ARMED")
        copter.proxy.ask("long MISSION_START 0 0 0 0 0 0 0", "Mode AUTO")
        copter.until(lambda: copter.watcher.landed != ON_GROUND, "taken off")
        copter.until(lambda: not copter.watcher.armed, "flown and landed")
    assert min(math.dist(sample.position, (12.0, 0.0, -8.0)) for sample in track) < 3.0
    assert copter.watcher.now.position == pytest.approx((12.0, 7.0, 0.0), abs=0.6)
    copter.proxy.ask("wp clear", "TYPE_MISSION: ACCEPTED")
    assert not plans.without_home(copter.watcher, plans.download(copter.watcher))


def test_fence_load_list_and_kept(copter, tmp_path):
    """MAVProxy's velocities are the body's: which way it flies depends on where it looks."""
    begin = copter.watcher.now.position
    plan = written(tmp_path / "fence.txt", (3, 5003, 10, *begin[:2], 0.0))  # a circle of 10 m
    copter.proxy.ask(f"fence load {plan}", "TYPE_FENCE: ACCEPTED")
    copter.proxy.ask("fence list", "Requesting 1 fence items")
    copter.proxy.ask("fence enable", "DO_FENCE_ENABLE: ACCEPTED")
    copter.take_off(6.0)

    def way(position: tuple[float, float, float]) -> float:
        return math.hypot(position[0] - begin[0], position[1] - begin[1])

    with copter.watcher.track() as track:
        copter.repeat("velocity 3 0 0", lambda: way(copter.watcher.now.position) > 6.0, "6 m away")
        end_s = copter.watcher.time_ms / 1000.0 + 6.0
        copter.repeat("velocity 3 0 0", lambda: copter.watcher.time_ms / 1000.0 > end_s, "for 6 s")
    assert max(way(sample.position) for sample in track) < 10.5
    copter.proxy.ask("fence disable", "DO_FENCE_ENABLE: ACCEPTED")
    copter.proxy.ask("fence clear", "TYPE_FENCE: ACCEPTED")
    copter.come_down()


def test_px4_flies_by_mavproxy_too(tmp_path):
    with sitl_process(lockstep=False, speed=SPEED, parameters={"MIS_TAKEOFF_ALT": 4.0}) as sitl:
        step(sitl, 5_000)
        with flight(sitl, f"udpin:127.0.0.1:{sitl.companion}", tmp_path) as flown:
            flown.proxy.say("param set COM_OBL_RC_ACT 5")  # an integer, which travels as its bytes
            flown.until(lambda: parameters.read(flown.watcher, "COM_OBL_RC_ACT").value == 5, "set")
            flown.proxy.ask("arm throttle", "ARMED")
            flown.proxy.say("long DO_SET_MODE 1 4 2 0 0 0 0")  # `mode` knows no PX4 modes: it wants a float there
            flown.until(lambda: abs(flown.height - 4.0) < 0.5, "height reached")
            flown.proxy.ask("long NAV_LAND 0 0 0 0 0 0 0", "NAV_LAND: ACCEPTED")
            flown.until(lambda: not flown.watcher.armed, "landed and disarmed")
            assert flown.watcher.now.position == pytest.approx((0.0, 0.0, 0.0), abs=0.3)
