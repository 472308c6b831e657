import select
import threading

import pytest

from autopilot_bridge.bell import Bell


@pytest.fixture
def bell():
    bell = Bell()
    yield bell
    bell.close()


def rings(bell, timeout_s=0.0):
    return bool(select.select([bell], [], [], timeout_s)[0])


def test_is_heard_from_another_thread_until_it_is_silenced(bell):
    assert not rings(bell)
    threading.Thread(target=bell.ring).start()
    assert rings(bell, 10.0)
    assert rings(bell)
    bell.silence()
    assert not rings(bell)
    bell.ring()
    assert rings(bell)


def test_whoever_rings_never_waits_however_often_and_however_late(bell):
    for _ in range(100_000):  # far more than a socket holds
        bell.ring()
    bell.silence()
    assert not rings(bell)
    bell.close()
    bell.ring()
