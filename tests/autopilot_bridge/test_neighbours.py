"""Where the others are: the geodesy beside Vincenty's formulae, and what is made of what their bridges tell."""

import contextlib
import math
import queue
import threading
import time
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot_bridge.config import BridgeConfig, Limits, PacedClock
from autopilot_bridge.neighbours import LOST_WALL_S, Neighbours, between_homes, usual_age_s
from autopilot_bridge.node import run
from bus import messages as m
from bus import topics
from bus.session import free_endpoint, open_session

SEMI_MAJOR_M, INVERSE_FLATTENING = 6378137.0, 298.257223563
HOME = (47.397743, 8.545594, 489.4)


def vincenty(first, second, inverse_flattening=INVERSE_FLATTENING):
    """Length [m] and initial azimuth [rad] of the geodesic (T. Vincenty, Survey Review XXIII, 1975: the inverse)."""
    f = 1 / inverse_flattening
    b = SEMI_MAJOR_M * (1 - f)
    lat1, lon1, lat2, lon2 = (math.radians(degrees) for degrees in (*first[:2], *second[:2]))
    u1, u2 = math.atan((1 - f) * math.tan(lat1)), math.atan((1 - f) * math.tan(lat2))
    lam = difference = math.remainder(lon2 - lon1, 2 * math.pi)
    for _ in range(100):
        x = math.cos(u2) * math.sin(lam)
        y = math.cos(u1) * math.sin(u2) - math.sin(u1) * math.cos(u2) * math.cos(lam)
        sin_s = math.hypot(x, y)
        if sin_s == 0:
            return 0.0, 0.0
        cos_s = math.sin(u1) * math.sin(u2) + math.cos(u1) * math.cos(u2) * math.cos(lam)
        s = math.atan2(sin_s, cos_s)
        sin_a = math.cos(u1) * math.cos(u2) * math.sin(lam) / sin_s
        cos2_a = 1 - sin_a**2
        cos_2m = cos_s - 2 * math.sin(u1) * math.sin(u2) / cos2_a if cos2_a else 0.0
        c = f / 16 * cos2_a * (4 + f * (4 - 3 * cos2_a))
        before = lam
        lam = difference + (1 - c) * f * sin_a * (s + c * sin_s * (cos_2m + c * cos_s * (2 * cos_2m**2 - 1)))
        if abs(lam - before) < 1e-14:
            break
    uu = cos2_a * (SEMI_MAJOR_M**2 - b**2) / b**2
    big_a = 1 + uu / 16384 * (4096 + uu * (-768 + uu * (320 - 175 * uu)))
    big_b = uu / 1024 * (256 + uu * (-128 + uu * (74 - 47 * uu)))
    third = big_b / 6 * cos_2m * (4 * sin_s**2 - 3) * (4 * cos_2m**2 - 3)
    ds = big_b * sin_s * (cos_2m + big_b / 4 * (cos_s * (2 * cos_2m**2 - 1) - third))
    return b * big_a * (s - ds), math.atan2(x, y)


def geodesic_of(offset, mean_radius_m=6371008.8):
    """Length and azimuth of the geodesic whose chord is an ENU offset between two places of the same height."""
    chord = float(np.linalg.norm(offset))
    return 2 * mean_radius_m * math.asin(chord / (2 * mean_radius_m)), math.atan2(offset[0], offset[1])


def test_the_reference_is_vincentys_own_example_and_we_agree_with_it():
    """Flinders Peak to Buninyong on GRS 80, whose axis differs from WGS 84's by 0.1 mm."""
    flinders = (-(37 + 57 / 60 + 3.7203 / 3600), 144 + 25 / 60 + 29.5244 / 3600, 0.0)
    buninyong = (-(37 + 39 / 60 + 10.1561 / 3600), 143 + 55 / 60 + 35.3839 / 3600, 0.0)
    length, azimuth = vincenty(flinders, buninyong, 298.257222101)
    assert length == pytest.approx(54972.271, abs=5e-4)
    assert math.degrees(azimuth) % 360 == pytest.approx(306 + 52 / 60 + 5.37 / 3600, abs=1e-5)
    offset, _ = between_homes(flinders, buninyong)
    ours = geodesic_of(offset)
    assert ours[0] == pytest.approx(length, abs=0.01)
    assert math.remainder(ours[1] - azimuth, 2 * math.pi) == pytest.approx(0.0, abs=1e-4)


places = st.tuples(st.floats(-85, 85), st.floats(-180, 180))
steps = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))


@given(places, steps)
def test_homes_are_as_far_apart_as_on_the_ellipsoid(place, step):
    ours, theirs = (*place, 0.0), (place[0] + step[0], place[1] + step[1], 0.0)
    length, azimuth = vincenty(ours, theirs)
    offset, _ = between_homes(ours, theirs)
    found, bearing = geodesic_of(offset)
    assert found == pytest.approx(length, rel=1e-6, abs=1e-3)
    if length > 10:
        assert math.remainder(bearing - azimuth, 2 * math.pi) == pytest.approx(0.0, abs=1e-4)


@given(places, steps, st.floats(-400, 9000), st.floats(-400, 9000))
def test_there_and_back_again_is_no_motion(place, step, height, other_height):
    ours, theirs = (*place, height), (place[0] + step[0], place[1] + step[1], other_height)
    there, turn = between_homes(ours, theirs)
    back, turn_back = between_homes(theirs, ours)
    np.testing.assert_allclose(turn @ turn_back, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(there + turn @ back, 0.0, atol=1e-7)


def test_a_neighbours_axes_are_nearly_ours_and_its_height_counts():
    offset, turn = between_homes(HOME, (HOME[0], HOME[1], HOME[2] + 7.0))
    np.testing.assert_allclose(offset, (0, 0, 7), atol=1e-6)
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-12)
    _, turn = between_homes(HOME, (HOME[0] + 0.01, HOME[1] + 0.01, HOME[2]))
    np.testing.assert_allclose(turn, np.eye(3), atol=4e-4)


# What is heard.

NORTH_30M = (HOME[0] + 30 / 111190.0, HOME[1], HOME[2])
"""A degree of latitude there is 111.19 km."""


def state(
    time_s,
    *,
    home=NORTH_30M,
    armed=True,
    phase="slots",
    position=(1.0, 2.0, 20.0),
    velocity=(2.0, 0.0, 0.0),
    position_age_s=0.0,
    stop=None,
):
    return m.VehicleState(
        position_age_s=position_age_s,
        stop_enu=stop,
        time_s=time_s,
        position_enu=position,
        velocity_enu=velocity,
        attitude_rad=(0.0, 0.0, 0.0),
        mode="OFFBOARD",
        armed=armed,
        landed=not armed,
        battery_remaining=None,
        home_lat_lon_alt=home,
        phase=phase,
    )


class Heard:
    """Neighbours `a` and `b` on a real bus, under a wall clock of our own."""

    def __init__(self, session, others, speed):
        self.wall, self.told, self.known = 100.0, [], []
        self.home = HOME
        self.limits = Limits(horizontal_mps=5.0, acceleration_mps2=2.0)
        self.publishers = {name: topics.Publisher(others, name, topics.STATE) for name in ("a", "b")}
        self.speed = speed
        self.neighbours = Neighbours(
            session,
            ["a", "b"],
            self.limits,
            speed,
            home=lambda: self.home,
            tell=lambda *what: self.told.append(what),
            all_known=lambda: self.known.append(self.wall),
            clock=self._look,
        )
        self._looks = queue.SimpleQueue()
        seen = queue.SimpleQueue()
        self._greetings = [
            topics.watch_alive(others, "a", lambda *heard: seen.put(heard)),
            topics.declare_alive(session, "a", "hello"),
        ]
        seen.get(timeout=20)  # the other end knows this token, so it knows the subscribers declared before

    def _look(self):
        if threading.current_thread() is not threading.main_thread():
            self._looks.put("a state has come")
        return self.wall

    def say(self, name, message):
        """Say it twice: who hears the second time, which is no news, has taken in the first."""
        for _ in range(2):
            self.publishers[name].send(message)
        for _ in range(2):
            self._looks.get(timeout=20)

    def tracks(self, after_s=0.0):
        self.wall += after_s
        return self.neighbours.tracks()

    def close(self):
        self.neighbours.close()
        for declared in self._greetings:
            declared.undeclare()


@pytest.fixture
def hear():
    """Neighbours at a speed."""
    endpoint = free_endpoint()
    with contextlib.ExitStack() as stack:
        session = stack.enter_context(open_session(listen=endpoint))
        others = stack.enter_context(open_session(connect=[endpoint]))

        def make(speed=1.0):
            return stack.enter_context(contextlib.closing(Heard(session, others, speed)))

        yield make


@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_a_neighbour_is_where_its_bridge_says_and_as_old_as_its_news(hear, speed):
    heard = hear(speed)
    heard.say("a", state(5.0))
    (track,) = heard.tracks()
    np.testing.assert_allclose(track.position, (1.0, 32.0, 20.0), atol=0.01)
    np.testing.assert_allclose(track.velocity, (2.0, 0.0, 0.0), atol=1e-4)
    assert track.stop is None
    assert track.age_s == usual_age_s(speed) > 0.1, "it is never taken for younger than news usually are"
    (track,) = heard.tracks(after_s=0.02)
    np.testing.assert_allclose(track.position, (1.0 + 2.0 * 0.02 * speed, 32.0, 20.0), atol=0.01)
    (track,) = heard.tracks(after_s=0.58)
    assert track.age_s == pytest.approx(0.6 * speed)
    np.testing.assert_allclose(track.position, (1.0 + 2.0 * usual_age_s(speed), 32.0, 20.0), atol=0.01)


def test_a_neighbour_stops_where_its_own_bridge_says(hear):
    heard = hear()
    heard.say("a", state(5.0, stop=(9.0, 2.0, 20.0)))
    (track,) = heard.tracks(after_s=0.05)
    np.testing.assert_allclose(track.stop, (9.0 + 2.0 * 0.05, 32.0, 20.0), atol=0.01)
    (lost,) = heard.tracks(after_s=LOST_WALL_S)
    np.testing.assert_allclose(lost.position, (9.0 + 2.0 * LOST_WALL_S, 32.0, 20.0), atol=0.01)


def test_a_silent_neighbour_is_anywhere_on_its_way_home(hear):
    heard = hear()
    heard.say("a", state(5.0))
    (track,) = heard.tracks(after_s=LOST_WALL_S + 0.01)
    # 1 s on with 2 m/s, then braking from it at 2 m/s^2.
    np.testing.assert_allclose(track.position, (1.0 + 2.0 + 1.0, 32.0, 20.0), atol=0.01)
    np.testing.assert_allclose(track.stop, (0.0, 30.0, 0.0), atol=0.01)
    assert not track.velocity.any()
    (later,) = heard.tracks(after_s=1000.0)
    assert later.age_s == track.age_s == usual_age_s(1.0), "what it keeps others from does not grow for ever"
    assert [kind for kind, _ in heard.told] == ["neighbour_lost"]
    heard.say("a", state(7.0))
    (track,) = heard.tracks()
    assert track.stop is None
    assert [kind for kind, _ in heard.told] == ["neighbour_lost", "neighbour_back"]


def test_a_bridge_that_hears_nothing_of_its_vehicle_tells_no_news(hear):
    heard = hear()
    for _ in range(12):
        heard.say("a", state(5.0))
        heard.wall += 0.1
    (track,) = heard.tracks()
    assert track.stop is not None
    assert [kind for kind, _ in heard.told] == ["neighbour_lost"]


@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_a_neighbour_that_does_not_know_where_it_is_is_lost_too(hear, speed):
    """Its bridge goes on telling the last place while its autopilot holds, and then flies home."""
    heard = hear(speed)
    for tenth in range(12):
        heard.say("a", state(5.0 + 0.1 * tenth * speed, position_age_s=0.1 * tenth * speed))
        heard.wall += 0.1
    (track,) = heard.tracks()
    np.testing.assert_allclose(track.stop, (0.0, 30.0, 0.0), atol=0.01)
    assert [kind for kind, _ in heard.told] == ["neighbour_lost"]
    heard.say("a", state(7.0 + 1.2 * speed))
    (track,) = heard.tracks()
    assert track.stop is None


def test_a_state_that_comes_late_is_no_news_but_an_autopilot_that_starts_anew_is(hear):
    heard = hear()
    heard.say("a", state(50.0))
    heard.say("a", state(49.9, position=(9.0, 9.0, 9.0)))
    (track,) = heard.tracks()
    np.testing.assert_allclose(track.position, (1.0, 32.0, 20.0), atol=0.01)
    heard.say("a", state(0.5, position=(3.0, 2.0, 20.0)))
    (track,) = heard.tracks()
    np.testing.assert_allclose(track.position, (3.0, 32.0, 20.0), atol=0.01)


def test_who_is_down_for_good_is_no_obstacle_and_who_waits_for_takeoff_is(hear):
    heard = hear()
    heard.say("a", state(1.0, armed=False, phase="ready", position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)))
    (track,) = heard.tracks()
    np.testing.assert_allclose(track.position, (0.0, 30.0, 0.0), atol=0.01)
    for number, (armed, phase, obstacle) in enumerate(
        [(True, "landing", True), (False, "landing", False), (True, "yielded", True), (False, "ended", False)]
    ):
        heard.say("a", state(2.0 + number, armed=armed, phase=phase))
        assert bool(heard.tracks()) == obstacle, phase
    assert heard.tracks(after_s=60.0) == []
    assert heard.told == [], "nobody misses a vehicle whose flight is over"


def test_nobody_is_anywhere_before_homes_are_known(hear):
    heard = hear()
    assert heard.neighbours.unknown == ["a", "b"]
    heard.say("a", state(1.0, home=None))
    assert heard.tracks() == []
    assert heard.neighbours.unknown == ["a", "b"]
    heard.say("a", state(1.1))
    assert heard.neighbours.unknown == ["b"]
    assert heard.known == []
    heard.say("b", state(1.0, home=HOME))
    assert heard.neighbours.unknown == []
    assert len(heard.known) == 1
    heard.say("a", state(1.2, home=None))
    assert len(heard.tracks()) == 2, "a home once told is kept"
    assert len(heard.known) == 1, "told once"
    heard.home = None
    assert heard.tracks() == [], "our own is needed too"


def test_a_bad_name_is_refused(hear):
    with open_session() as session, pytest.raises(ValueError, match="vehicle: 'a/b'"):
        Neighbours(session, ["a/b"], Limits(), 1.0, lambda: HOME, lambda *_: None)


# In a bridge.


class Ghost:
    """Another vehicle that stands in the air; tells its state ten times a second, from `home` on."""

    def __init__(self, session, position):
        self.home = None
        self._position = position
        self._publisher = topics.Publisher(session, "ghost", topics.STATE)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._tell)
        self._thread.start()

    def _tell(self):
        while not self._stop.wait(0.02):
            self._publisher.send(
                state(time.monotonic(), home=self.home, position=self._position, velocity=(0.0, 0.0, 0.0))
            )

    def close(self):
        self._stop.set()
        self._thread.join()


@pytest.mark.parametrize("autostart", [False, True])
def test_a_bridge_waits_for_the_others_homes_and_then_keeps_apart(sitl, bridge_config, autostart):
    autopilot, endpoint = sitl("--speed", "3"), free_endpoint()
    config: BridgeConfig = bridge_config(
        autopilot,
        clock=PacedClock(speed=3.0),
        autostart=autostart,
        slots=8,
        separation_m=6.0,
        limits=Limits(horizontal_mps=4.0),
    )
    with contextlib.ExitStack() as stack:
        ours = stack.enter_context(open_session(listen=endpoint))
        ground = stack.enter_context(open_session(connect=[endpoint]))
        events, states, slots = [], [], queue.SimpleQueue()
        actions = topics.Publisher(ground, "test", topics.ACTION)

        def fly_east(opened):
            slots.put(opened)
            if not opened.closing:
                actions.send(eastward(opened.slot))

        kept = [
            topics.subscribe(ground, "test", topics.EVENT, events.append, Counter()),
            topics.subscribe(ground, "test", topics.STATE, states.append, Counter()),
            topics.subscribe(ground, "test", topics.SLOT, fly_east, Counter()),
        ]
        start = config.start_position_enu
        ghost = stack.enter_context(contextlib.closing(Ghost(ground, (start[0] + 16.0, start[1], start[2]))))
        codes = []
        bridge = threading.Thread(target=lambda: codes.append(run(config, "test", ours, None, ["ghost"])))
        bridge.start()
        until(lambda: any(event.text == "ready" for event in events))
        if not autostart:
            reply = topics.send_command(ground, "test", m.Command(name="start"))
            assert not reply.accepted
            assert "the home of ghost is not known" in reply.reason
        ghost.home = next(said.home_lat_lon_alt for said in reversed(states))
        if not autostart:
            until(lambda: topics.send_command(ground, "test", m.Command(name="start")).accepted)
        if autostart:
            until(lambda: any(event.text == "arming" for event in events))
            until(lambda: topics.send_command(ground, "test", m.Command(name="land")).accepted)
        bridge.join(90)
        assert not bridge.is_alive()
        del kept
    if autostart:
        assert codes == [3], "it had started, and landed at once"
        return
    assert codes == [0]
    gaps = [math.dist(said.position_enu[:2], (start[0] + 16.0, start[1])) for said in states if said.phase == "slots"]
    assert gaps[0] > 14.0
    assert 6.0 <= min(gaps) < 11.0, "it came as near as it may, and no nearer"
    flown = [opened.flown for opened in iter_queue(slots) if opened.flown is not None]
    assert "envelope: separation" in flown[-1].reasons


def eastward(slot):
    return m.Action(
        slot=slot,
        time_s=0.0,
        source="test",
        displacement_enu=(4.0, 0.0, 0.0),
        theta_reflection=[],
        split_angle=[],
        sign=[],
        beamforming=[],
        raw=[],
    )


def until(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def iter_queue(waiting):
    while not waiting.empty():
        yield waiting.get()
