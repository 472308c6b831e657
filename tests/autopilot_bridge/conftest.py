"""A flight's other parts: a real SITL process, a real zenoh session and a small agent that answers each slot."""

import contextlib
import socket
import subprocess
import sys
import threading
import time
from collections import Counter

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.node import run
from bus import messages as m
from bus import topics
from bus.session import free_endpoint, open_session


def free_udp_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def upload_fence(own_port, gcs, items):
    """Over the ground station's link at `gcs` (host:port), whose telemetry goes to `own_port`."""
    codec, fence = mavlink.MAVLink(None, srcSystem=255, srcComponent=190), mavlink.MAV_MISSION_TYPE_FENCE
    host, port = gcs.split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", own_port))
        station.settimeout(10)

        def say(message):
            station.sendto(message.pack(codec), (host, int(port)))

        say(mavlink.MAVLink_mission_count_message(1, 1, len(items), fence))
        while True:
            for message in mavlink.MAVLink(None).parse_buffer(station.recv(4096)) or ():
                if message.get_type() == "MISSION_ACK":
                    assert message.type == mavlink.MAV_MISSION_ACCEPTED
                    return
                if message.get_type() == "MISSION_REQUEST_INT":
                    command, value, *place = items[message.seq]
                    x, y = (round(degrees * 1e7) for degrees in place)
                    say(
                        mavlink.MAVLink_mission_item_int_message(
                            1, 1, message.seq, 0, command, 0, 1, value, 0, 0, 0, x, y, 0, fence
                        )
                    )


class Sitl:
    """`python -m sitl` on free ports; ends with the test."""

    def __init__(self, *options, port=None):
        self.port = port or free_udp_port()
        command = [sys.executable, "-m", "sitl", "--companion-port", str(self.port), "--companion-bind", "0"]
        self.gcs_port = free_udp_port()
        if "arducopter" in options and "--tcp-port" not in options:
            command += ["--tcp-port", "0"]
        command += ["--gcs-port", str(self.gcs_port), "--gcs-bind", "0", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        printed = {}
        while not {"gcs", "control"} <= printed.keys() and ("--lockstep" in options or "gcs" not in printed):
            name, address, *_ = self.process.stdout.readline().split()
            printed[name] = address
        self.gcs, self.control = printed["gcs"], printed.get("control")

    def pilot(self, command, *params):
        """A COMMAND_LONG of a ground station."""
        self.say(mavlink.MAVLink_command_long_message(1, 1, command, 0, *params, *[0.0] * (7 - len(params))))

    def say(self, message):
        """A message of a ground station, on the SITL's other link."""
        codec = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        host, port = self.gcs.split(":")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            out.sendto(message.pack(codec), (host, int(port)))

    def upload_fence(self, items):
        """As a ground station does, (MAV_CMD, param1, degrees, degrees) each; the vehicle's time must go on."""
        upload_fence(self.gcs_port, self.gcs, items)

    def close(self):
        self.process.terminate()
        self.process.wait(10)
        self.process.stdout.close()


class Agent:
    """Answers slot k with `decide(k)`: a displacement, None for silence, or a whole Action."""

    def __init__(self, session, vehicle, decide):
        self.decide = decide
        self.publisher = topics.Publisher(session, vehicle, topics.ACTION)
        self.subscriber = topics.subscribe(session, vehicle, topics.SLOT, self.answer, Counter())

    def answer(self, opened):
        if opened.closing or (decision := self.decide(opened)) is None:
            return
        self.publisher.send(decision if isinstance(decision, m.Action) else action(opened.slot, decision))


def action(slot, displacement):
    return m.Action(
        slot=slot,
        time_s=0.0,
        source="test",
        displacement_enu=tuple(displacement),
        theta_reflection=[],
        split_angle=[],
        sign=[],
        beamforming=[],
        raw=[],
    )


class Flight:
    """One bridge on a thread, and everything it said; `through` makes the endpoint by which others reach it."""

    def __init__(self, config, decide, tlog=None, through=lambda endpoint: endpoint):
        self.endpoint = free_endpoint()
        self.session = open_session(listen=self.endpoint)
        self.ground = open_session(connect=[through(self.endpoint)])
        self.vehicle = "test"
        self.states, self.slots, self.events, self.healths = [], [], [], []
        refused = Counter()
        self.subscribers = [
            topics.subscribe(self.ground, self.vehicle, topic, sink.append, refused)
            for topic, sink in (
                (topics.STATE, self.states),
                (topics.SLOT, self.slots),
                (topics.EVENT, self.events),
                (topics.HEALTH, self.healths),
            )
        ]
        self.agent = Agent(self.ground, self.vehicle, decide)
        time.sleep(0.2)  # for the two sessions to know of each other's subscribers
        self.code = None
        self.thread = threading.Thread(target=self._fly, args=(config, tlog))
        self.thread.start()

    def _fly(self, config, tlog):
        self.code = run(config, self.vehicle, self.session, tlog)

    def command(self, name):
        return topics.send_command(self.ground, self.vehicle, m.Command(name=name))

    def wait(self, timeout_s=120):
        """The exit code."""
        self.thread.join(timeout_s)
        assert not self.thread.is_alive(), "still flying"
        self.until(lambda: any(event.kind == "ended" for event in self.events), "the ended event")
        return self.code

    def until(self, condition, what, timeout_s=60):
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}"
            time.sleep(0.005)

    def until_slot(self, number):
        self.until(lambda: self.slots and self.slots[-1].slot >= number, f"slot {number}")

    def until_phase(self, phase):
        self.until(lambda: phase in self.phases, f"phase {phase}")

    @property
    def phases(self):
        return [event.text for event in self.events if event.kind == "phase"]

    def told(self, kind):
        return [event.text for event in self.events if event.kind == kind]

    @property
    def flown(self):
        return [opened.flown for opened in self.slots if opened.flown is not None]

    def close(self):
        self.session.close()
        self.ground.close()


@pytest.fixture(autouse=True)
def own_state(monkeypatch, tmp_path):
    """What bridges keep over their deaths stays in the test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def upload():
    """`upload(own_port, gcs, items)`: a fence, as a ground station does."""
    return upload_fence


@pytest.fixture
def sitl():
    """Start SITLs: `sitl("--lockstep")`."""
    with contextlib.ExitStack() as stack:

        def start(*options, port=None):
            started = Sitl(*options, port=port)
            stack.callback(started.close)
            return started

        yield start


@pytest.fixture(scope="module")
def standing():
    """One autopilot of each kind for all flights that end before they begin: each puts back what it has set."""
    kinds = {"px4": (), "arducopter": ("--personality", "arducopter")}
    with contextlib.ExitStack() as stack:
        started = {}

        def start(kind):
            if kind not in started:
                started[kind] = Sitl("--speed", "10", *kinds[kind])
                stack.callback(started[kind].close)
            return started[kind]

        yield start


@pytest.fixture
def fly():
    """Start flights: `fly(config, decide)`."""
    with contextlib.ExitStack() as stack:

        def start(config, decide=lambda opened: (0.0, 0.0, 0.0), tlog=None, **options):
            flight = Flight(config, decide, tlog, **options)
            stack.callback(flight.close)
            return flight

        yield start


def short_flight(sitl, **changes):
    """To 12 m, four slots, and down."""
    clock = {"kind": "lockstep", "control": sitl.control} if sitl.control else {"kind": "paced"}
    config = {
        "autopilot": f"udpin://127.0.0.1:{sitl.port}",
        "clock": clock,
        "slots": 4,
        "start_position_enu": (0.0, 0.0, 12.0),
        "box": {"x": (-50, 50), "y": (-50, 50), "z": (8, 40)},
        "at_end": "land",
        "allow_without": ["battery_failsafe"],  # both autopilots come without
        "autostart": True,
    }
    return BridgeConfig(**(config | changes))


@pytest.fixture
def bridge_config():
    """`bridge_config(sitl, **changes)`: a short flight's BridgeConfig."""
    return short_flight


@pytest.fixture
def make_action():
    """`make_action(slot, displacement)`: an Action of which only the bridge's part is filled."""
    return action
