from hypothesis import given
from hypothesis import strategies as st

from autopilot_bridge.deadman import SILENCE_WALL_S, Deadman, Rung, Silence


def test_ladder():
    deadman = Deadman(deadline_s=0.25, grace_s=3.0, started_s=10.0)
    deadman.opened(10.0)
    assert deadman.rung(10.2) is Rung.FLY
    assert deadman.rung(10.3) is Rung.HOLD
    deadman.opened(11.0)
    deadman.acted(11.1)
    assert deadman.rung(11.9) is Rung.FLY
    deadman.opened(12.0)
    assert deadman.rung(12.3) is Rung.HOLD
    assert deadman.rung(14.1) is Rung.HOLD
    assert deadman.rung(14.2) is Rung.RETURN


def test_return_is_final():
    deadman = Deadman(0.25, 3.0, 0.0)
    deadman.opened(0.0)
    assert deadman.rung(3.1) is Rung.RETURN
    deadman.acted(3.2)
    assert deadman.rung(3.2) is Rung.RETURN


@given(st.lists(st.booleans(), min_size=1, max_size=40), st.floats(1.5, 10))
def test_returns_exactly_when_the_gap_exceeds_the_grace(answered, grace_s):
    deadman, last_good, expired = Deadman(0.25, grace_s, 0.0), 0.0, False
    for slot, good in enumerate(answered):
        deadman.opened(float(slot))
        if good:
            deadman.acted(slot + 0.1)
            last_good = slot + 0.1
        for time_s in (slot + 0.2, slot + 0.6, slot + 0.9):
            expired = expired or time_s - last_good > grace_s
            expected = Rung.RETURN if expired else Rung.HOLD if not good and time_s > slot + 0.25 else Rung.FLY
            assert deadman.rung(time_s) is expected


def test_silence_runs_on_the_wall_and_can_be_excused():
    silence = Silence(wall_s=100.0)
    assert not silence.over(heard=5, wall_s=101.0)
    assert not silence.over(heard=5, wall_s=101.0 + SILENCE_WALL_S)
    assert silence.over(heard=5, wall_s=101.1 + SILENCE_WALL_S)
    silence.excuse(110.0)
    assert not silence.over(heard=5, wall_s=112.0)
    assert not silence.over(heard=6, wall_s=114.0)
