"""Pacing: vehicle time follows the wall clock, and no clock can make it jump or stop."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from sitl.pacing import BEHIND_MAX_S, Pacer
from sitl.parameters import Parameters
from sitl.px4.personality import PX4
from sitl.server import Options, Server
from tests.sitl.client import Client
from tests.sitl.process import free_udp_port

TICK_S = 0.01
speeds = st.sampled_from([0.01, 0.5, 1.0, 7.0, 1000.0])
steps = st.lists(st.one_of(st.floats(0, 0.05), st.floats(-1e6, 1e6)), max_size=80)


class Wall:
    """A wall clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@given(speeds, steps)
def test_a_wait_is_never_longer_than_a_tick(speed, jumps):
    """Whatever the clock says next: a clock set back does not stop the vehicle."""
    wall = Wall()
    pacer = Pacer(TICK_S, speed, wall)
    for jump in jumps:
        wall.now += jump
        assert 0.0 <= pacer.wait_s() <= TICK_S / speed
        if pacer.wait_s() == 0.0:
            pacer.ticked()


@given(speeds, steps)
def test_no_leap_of_the_clock_is_caught_up_with(speed, jumps):
    """After any jump at most BEHIND_MAX_S are made good: the vehicle never rushes through what it missed."""
    wall = Wall()
    pacer = Pacer(TICK_S, speed, wall)
    allowed = BEHIND_MAX_S * speed / TICK_S + 2
    for jump in jumps:
        wall.now += jump
        ticks = 0
        while pacer.wait_s() == 0.0:
            pacer.ticked()
            ticks += 1
            assert ticks <= allowed


@given(speeds)
def test_an_even_clock_is_followed_exactly(speed):
    wall = Wall()
    pacer = Pacer(TICK_S, speed, wall)
    ticks = 0
    for _ in range(2000):
        wall.now += TICK_S / speed / 2
        if pacer.wait_s() <= 1e-6 * TICK_S / speed:
            wall.now += pacer.wait_s()
            pacer.ticked()
            ticks += 1
    assert abs(ticks - 1000) <= 1


def test_clients_never_see_a_clock_that_jumps():
    """AUTOPILOT.md 6, "time jumps under speed-up": time_boot_ms and SYSTEM_TIME grow evenly all the same."""
    wall, port = Wall(), free_udp_port()
    options = Options(
        PX4, Parameters(PX4.table), companion_port=port, companion_bind=0, gcs_bind=0, gcs_port=free_udp_port()
    )
    server = Server(options, wall)
    client = Client(port, 1)
    try:
        jumps = itertools.cycle([0.01, 0.011, -3600.0, 0.02, 86400.0, 0.0, 0.01, -1e9, 0.03])
        while server.now_ms < 4000:
            wall.now += next(jumps)
            server.turn()
        client.receive()
    finally:
        client.close()
        server.close()
    stamps = [m.time_boot_ms for m in client.messages if m.get_type() == "ATTITUDE"]
    assert len(stamps) > 300
    assert {b - a for a, b in itertools.pairwise(stamps)} == {10}
    times = [(m.time_boot_ms, m.time_unix_usec) for m in client.messages if m.get_type() == "SYSTEM_TIME"]
    assert len(times) >= 3
    assert len({unix - 1000 * boot for boot, unix in times}) == 1
