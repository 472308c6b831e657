"""The paced clock against a simulated wall clock; lockstep is tested in every flight."""

from collections import Counter
from types import SimpleNamespace

import pytest

from autopilot_bridge import clock
from autopilot_bridge.vehicle import SilentError, Telemetry


class Autopilot:
    """Telemetry at 30 Hz of vehicle time, each message `delay_s` late."""

    def __init__(self, wall, speed, boot_s=100.0, delay_s=0.0, rate=1.0):
        self.wall, self.speed, self.boot_s, self.delay_s, self.rate = wall, speed * rate, boot_s, delay_s, rate
        self.telemetry = Telemetry()
        self.counters = Counter()
        self.alive = self.telling = True
        self.heard = 0
        self.frames_received = 0

    @property
    def time_s(self):
        return self.boot_s + self.wall.now * self.speed

    def poll(self, timeout_s):
        self.wall.now += min(timeout_s, 0.003)
        self.heard += self.alive
        if self.alive and self.telling:
            sent = int((self.time_s - self.delay_s * self.speed) * 30) / 30
            self.telemetry = Telemetry(time_s=sent)


@pytest.fixture
def wall(monkeypatch):
    wall = SimpleNamespace(now=0.0)
    monkeypatch.setattr(clock.time, "monotonic", lambda: wall.now)
    return wall


@pytest.mark.parametrize("speed", [1.0, 5.0])
@pytest.mark.parametrize("rate", [1.0, 0.97], ids=["nominal", "slow autopilot"])
def test_steps_do_not_drift_against_the_autopilot(wall, speed, rate):
    autopilot = Autopilot(wall, speed, delay_s=0.002, rate=rate)
    paced = clock.Paced(speed, 50)
    for _ in range(4):
        paced.step(autopilot)
    first, began = paced.now, wall.now
    for _ in range(1000):
        paced.step(autopilot)
    assert paced.now - first == pytest.approx(50.0, abs=0.11)
    assert paced.now == pytest.approx(autopilot.time_s, abs=0.06 + 0.01 * speed)
    assert wall.now - began == pytest.approx(50.0 / speed / rate, rel=0.01)


def test_times_are_multiples_of_the_step(wall):
    autopilot = Autopilot(wall, 1.0)
    paced = clock.Paced(1.0, 50)
    for _ in range(20):
        paced.step(autopilot)
        assert paced.now * 20 == pytest.approx(round(paced.now * 20), abs=1e-9)


def test_vehicle_time_stands_still_without_telemetry_but_steps_return(wall):
    autopilot = Autopilot(wall, 1.0)
    paced = clock.Paced(1.0, 50)
    for _ in range(20):
        paced.step(autopilot)
    autopilot.alive = False
    lost = paced.now
    for _ in range(50):
        paced.step(autopilot)
    assert paced.now <= lost + clock.UNHEARD_S + 0.06
    assert wall.now > 4.0


def test_an_autopilot_that_is_heard_but_does_not_tell_its_time_has_it_carried_on(wall):
    autopilot = Autopilot(wall, 1.0)
    paced = clock.Paced(1.0, 50)
    for _ in range(20):
        paced.step(autopilot)
    autopilot.telling = False
    lost = wall.now
    while wall.now < lost + 10.0:
        paced.step(autopilot)
        assert paced.now == pytest.approx(autopilot.time_s, abs=0.15)
    autopilot.telling = True
    before = paced.now
    for _ in range(20):
        paced.step(autopilot)
    assert paced.now == pytest.approx(before + 1.0, abs=0.15)
    assert paced.now == pytest.approx(autopilot.time_s, abs=0.15)


def test_both_clocks_are_told_in_seconds_of_vehicle_time(wall):
    autopilot = Autopilot(wall, 5.0)
    paced = clock.Paced(5.0, 50)
    for _ in range(20):
        paced.step(autopilot)
    began = paced.moment
    autopilot.alive = False
    wall.now += 2.0
    paced.step(autopilot)
    assert paced.moment.vehicle_s - began.vehicle_s < 0.2
    assert paced.moment.wall_s - began.wall_s >= 10.0
    autopilot.alive, wall.now = True, wall.now + 2.0
    paced.step(autopilot)
    assert paced.moment.vehicle_s - began.vehicle_s > 19.0


def test_an_autopilots_clock_that_leaps_is_followed(wall):
    autopilot = Autopilot(wall, 1.0)
    paced = clock.Paced(1.0, 50)
    for _ in range(20):
        paced.step(autopilot)
    autopilot.boot_s += 100.0
    paced.step(autopilot)
    assert paced.now == pytest.approx(autopilot.time_s, abs=0.12)


def test_a_stall_is_skipped_not_rushed_through(wall):
    autopilot = Autopilot(wall, 1.0)
    paced = clock.Paced(1.0, 50)
    for _ in range(20):
        paced.step(autopilot)
    before = paced.now
    wall.now += 2.0
    for _ in range(3):
        paced.step(autopilot)
    assert paced.now > before + 1.9
    assert autopilot.counters["steps_skipped"] >= 35


def test_a_clock_that_goes_back_is_told_once_and_then_followed(wall):
    autopilot = Autopilot(wall, 1.0)
    paced = clock.Paced(1.0, 50)
    for _ in range(20):
        paced.step(autopilot)
    autopilot.boot_s -= 60.0
    with pytest.raises(SilentError, match=r"clock went back from 10\d\.\d to 4\d\.\d s: it has restarted"):
        paced.step(autopilot)
    for _ in range(20):
        paced.step(autopilot)
    assert paced.now == pytest.approx(autopilot.time_s, abs=0.12)
