"""How punctual and how frugal the bridge is: jitter of its stream, its latencies, its processor time.

    python benchmarks/bridge.py [--slots 200] [--only px4-50hz ...]

Each row of the tables is a flight of real parts at the vehicle's own pace: the simulated autopilot and the bridge in
processes of their own, zenoh and UDP on loopback. This process stands between the two on the wire. What comes on its
sockets it dates by the kernel's clock (SO_TIMESTAMPNS), which is the same for all; what it hands on and publishes by
that clock just before.

    jitter   two setpoints of the stream after one another, less the step (extra ones that an action gave do not count)
    action   from just before an Action is published to the first setpoint on the wire that flies it: JSON, plan,
             envelope, send. Actions come any time up to 0.8 of the deadline after a slot's opening
    state    from just before LOCAL_POSITION_NED is handed to the bridge until the VehicleState made of it has arrived
    loop     from SlotOpened's arrival here to the first setpoint that flies its action; `aerialstar rf` and
             `aerialstar agent` are in between, with an untrained DA-DDPG policy for N = 256, M = 4, J = 4
    CPU      user and system time of the bridge's process, all threads, while slots are flown

The goals are those of issue 5. On a machine with other work, who has the right to may run it by `chrt -f 10`.
"""

import argparse
import json
import math
import os
import queue
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import yaml
import zenoh
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.wire import frames
from bus import messages as m
from bus import topics
from bus.session import free_endpoint, open_session

VEHICLE = "bench"
SO_TIMESTAMPNS = 35
"""Linux, <asm-generic/socket.h>; Python does not name it."""
N, M, J = 256, 4, 4
PATIENCE_S = 150.0
"""For a flight to reach its first slot: ArduCopter can be armed 42 s after its start."""
BRIDGE = """
import sys
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.node import run
from bus.session import open_session
with open_session(connect=[sys.argv[2]]) as session:
    sys.exit(run(BridgeConfig.model_validate_json(sys.argv[1]), sys.argv[3], session, None))
"""


@dataclass(frozen=True)
class Flight:
    """One row."""

    name: str
    says: str
    personality: str = "px4"
    backend: str = "pymavlink"
    setpoint_hz: int = 20
    telemetry: str = "asked for"
    """`10 Hz`: every other position and attitude goes no further; `full`: PX4's companion rates stay as they are."""
    nodes: bool = False
    """The real rf and agent nodes instead of prepared actions."""
    half_m: float = 60.0
    """Half the width of the box; in a small one every plan ends at a wall."""
    goals: dict[str, float] = field(default_factory=dict)


FLIGHTS = (
    Flight("px4-50hz", "PX4, pymavlink, 50 Hz", setpoint_hz=50, goals={"jitter": 2.0, "action": 3.0, "state": 3.0}),
    Flight("px4-mavsdk", "PX4, MAVSDK, 20 Hz", backend="mavsdk", goals={"jitter": 2.0, "action": 3.0, "state": 3.0}),
    Flight("walls", "ArduCopter (jerk), at walls", "arducopter", half_m=8.0, goals={"action": 3.0, "state": 3.0}),
    Flight("px4-10hz", "PX4, 10 Hz telemetry", telemetry="10 Hz", goals={"CPU": 3.0}),
    Flight("px4-20hz", "PX4, telemetry as asked for"),
    Flight("px4-full", "PX4, full companion rates", telemetry="full", goals={"CPU": 8.0}),
    Flight("loop", "PX4, rf and DA-DDPG nodes", nodes=True, goals={"loop": 25.0}),
)


class Relay:
    """Both ends of the wire: hands on what comes, and notes when."""

    def __init__(self, bridge_port: int, telemetry: str) -> None:
        self._to_bridge, self._to_sitl = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for end in (self._to_bridge, self._to_sitl):
            end.bind(("127.0.0.1", 0))
            end.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._bridge, self._telemetry = ("127.0.0.1", bridge_port), telemetry
        self._sitl: Any = None
        self.setpoints: deque[tuple[int, tuple[float, float, float]]] = deque()
        """When each came on the wire [ns], and its velocity (north, east, down) in single precision."""
        self.positions: dict[int, int] = {}
        """time_boot_ms of LOCAL_POSITION_NED -> when it went to the bridge [ns]."""
        self._open = True
        self._threads = [threading.Thread(target=self._down), threading.Thread(target=self._up)]
        for thread in self._threads:
            thread.start()

    @property
    def port(self) -> int:
        """Where the autopilot sends to."""
        return int(self._to_sitl.getsockname()[1])

    def close(self) -> None:
        self._open = False
        for thread in self._threads:
            thread.join()
        self._to_bridge.close()
        self._to_sitl.close()

    def _down(self) -> None:
        """From the autopilot to the bridge."""
        for _, datagram, sender in self._receive(self._to_sitl):
            self._sitl = sender
            kept = b"".join(frame for frame in frames(datagram) if self._passes(frame))
            for frame in frames(kept):
                if _message_id(frame) == mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                    self.positions[_boot_ms(frame)] = time.time_ns()
            if kept:
                self._to_bridge.sendto(kept, self._bridge)

    def _up(self) -> None:
        """From the bridge to the autopilot."""
        for came_ns, datagram, _ in self._receive(self._to_bridge):
            for frame in frames(datagram):
                if _message_id(frame) == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                    self.setpoints.append((came_ns, struct.unpack_from("<3f", frame, 10 + 16)))
            if self._sitl is not None and not (self._telemetry == "full" and _asks_for_a_rate(datagram)):
                self._to_sitl.sendto(datagram, self._sitl)

    def _receive(self, end: socket.socket) -> Iterator[tuple[int, bytes, Any]]:
        end.settimeout(0.5)
        while self._open:
            try:
                datagram, ancillary, _, sender = end.recvmsg(65536, 128)
            except TimeoutError:
                continue
            stamps = [struct.unpack("<qq", data) for _, kind, data in ancillary if kind == SO_TIMESTAMPNS]
            seconds, nanoseconds = stamps[0]
            yield seconds * 10**9 + nanoseconds, datagram, sender

    def _passes(self, frame: bytes) -> bool:
        thinned = (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAVLINK_MSG_ID_ATTITUDE)
        return self._telemetry != "10 Hz" or _message_id(frame) not in thinned or _boot_ms(frame) // 50 % 2 == 0


def _message_id(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little") if frame[0] == mavlink.PROTOCOL_MARKER_V2 else -1


def _boot_ms(frame: bytes) -> int:
    return int.from_bytes(frame[10:14], "little")


def _asks_for_a_rate(datagram: bytes) -> bool:
    is_command = _message_id(datagram) == mavlink.MAVLINK_MSG_ID_COMMAND_LONG
    return is_command and bool(struct.unpack_from("<H", datagram, 10 + 28)[0] == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)


class Bus:
    """What the bridge says, undecoded, and when it came [ns]; answers slots with prepared actions."""

    def __init__(self, session: zenoh.Session, answers: bool) -> None:
        self.states: list[tuple[int, bytes]] = []
        self.setpoints: list[tuple[int, bytes]] = []
        self.slots: list[tuple[int, bytes]] = []
        self.opened: queue.SimpleQueue[m.SlotOpened] = queue.SimpleQueue()
        self.ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.published: dict[int, int] = {}
        """Slot -> when its action was published [ns]."""
        self._actions = topics.Publisher(session, VEHICLE, topics.ACTION) if answers else None
        self._held: list[topics.Declared] = [
            session.declare_subscriber(topics.key(VEHICLE, topic.name), partial(_note, sink))
            for topic, sink in ((topics.STATE, self.states), (topics.SETPOINT, self.setpoints))
        ]
        self._held.append(topics.subscribe(session, VEHICLE, topics.SLOT, self._open, Counter()))
        self._held.append(topics.subscribe(session, VEHICLE, topics.EVENT, self._hear, Counter()))

    def answer(self, opened: m.SlotOpened, deadline_s: float, rng: np.random.Generator, speed_mps: float) -> None:
        """Outward, at some moment before the deadline."""
        if self._actions is None:
            return
        move = rng.normal(size=3) * (1, 1, 0.2)
        move *= rng.uniform(0, speed_mps) / np.linalg.norm(move)
        action = prepared(opened.slot, (float(move[0]), float(move[1]), float(move[2])), rng)
        time.sleep(rng.uniform(0.0, 0.8 * deadline_s))
        self.published[opened.slot] = time.time_ns()
        self._actions.send(action)

    def _open(self, opened: m.SlotOpened) -> None:
        self.slots.append((time.time_ns(), str(opened.slot).encode()))
        self.opened.put(opened)

    def _hear(self, event: m.MissionEvent) -> None:
        if event.kind in ("error", "failsafe", "ended"):
            self.ended.put(f"{event.kind}: {event.text}")


def _note(sink: list[tuple[int, bytes]], sample: zenoh.Sample) -> None:
    sink.append((time.time_ns(), sample.payload.to_bytes()))


def prepared(slot: int, move: tuple[float, float, float], rng: np.random.Generator) -> m.Action:
    """An action as large as those of N = 256."""
    return m.Action(
        slot=slot,
        time_s=0.0,
        source="benchmark",
        displacement_enu=move,
        theta_reflection=rng.uniform(-math.pi, math.pi, N).tolist(),
        split_angle=rng.uniform(0, math.pi / 2, N).tolist(),
        sign=rng.choice([-1, 1], N).tolist(),
        beamforming=rng.normal(size=(M, J, 2)).tolist(),
        raw=rng.uniform(-1, 1, 3 + 3 * N + 2 * M * J).tolist(),
    )


def processor_s(pid: int) -> float:
    """User and system time of a process [s] (proc(5), stat)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(flight: Flight, slots: int, slot_s: float) -> dict[str, list[float]]:
    """Samples of each figure [ms], of `CPU` one [% of a core]."""
    rng = np.random.default_rng(0)
    half, deadline_s = flight.half_m, 0.25 * slot_s
    with ExitStack() as stack:
        endpoint = free_endpoint()
        session = stack.enter_context(open_session(listen=endpoint))
        bus = Bus(session, answers=not flight.nodes)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            bridge_port = probe.getsockname()[1]
        relay = Relay(bridge_port, flight.telemetry)
        stack.callback(relay.close)
        ports = ["--companion-port", str(relay.port), "--companion-bind", "0", "--gcs-bind", "0", "--tcp-port", "0"]
        stack.enter_context(process("sitl", "--personality", flight.personality, *ports))
        if flight.nodes:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            mission = write_mission(folder, slots, slot_s, half)
            for node in ("rf", "agent"):
                given = ("--mission", str(mission), "--vehicle", VEHICLE, "--connect", endpoint)
                stack.enter_context(process("mission", node, *given))
        config = {
            "autopilot": f"udpin://127.0.0.1:{bridge_port}",
            "backend": flight.backend,
            "clock": {"kind": "paced"},
            "slots": slots,
            "slot_s": slot_s,
            "start_position_enu": (0, 0, 15),
            "box": {"x": (-half, half), "y": (-half, half), "z": (8, 25)},
            "setpoint_hz": flight.setpoint_hz,
            "allow_without": ["battery_failsafe"],
            "put_back": False,
            "autostart": True,
            "at_end": "land",
        }
        bridge = stack.enter_context(process(BRIDGE, json.dumps(config), endpoint, VEHICLE))
        await_node(session, "bridge", "rf" if flight.nodes else None, "agent" if flight.nodes else None)
        used, began = fly(bus, slots, deadline_s, rng, 5.0 * slot_s, bridge.pid)
        cpu = 100 * (processor_s(bridge.pid) - used) / (time.monotonic() - began)
        time.sleep(0.2)
    return {"CPU": [cpu], **figures(flight, bus, relay)}


def fly(
    bus: Bus, slots: int, deadline_s: float, rng: np.random.Generator, longest_m: float, pid: int
) -> tuple[float, float]:
    """Through all slots; the processor time and the wall clock at the third slot."""
    used, began = 0.0, 0.0
    while True:
        opened = next_slot(bus)
        if opened.closing:
            return used, began
        bus.answer(opened, deadline_s, rng, longest_m)
        if opened.slot == 3:
            used, began = processor_s(pid), time.monotonic()


def next_slot(bus: Bus) -> m.SlotOpened:
    """Raises SystemExit when there will be none."""
    patience = time.monotonic() + PATIENCE_S
    while time.monotonic() < patience and bus.ended.empty():
        with suppress(queue.Empty):
            return bus.opened.get(timeout=1.0)
    raise SystemExit(f"no slot opened: {'the bridge says nothing' if bus.ended.empty() else bus.ended.get()}")


def figures(flight: Flight, bus: Bus, relay: Relay) -> dict[str, list[float]]:
    """From what was noted [ms]."""
    step_ms = 1000 // flight.setpoint_hz
    sent = on_the_wire([topics.decode(payload, m.Setpoint) for _, payload in bus.setpoints], list(relay.setpoints))
    stream = [(came_ns, round(one.time_s * 1000)) for came_ns, one in sent if round(one.time_s * 1000) % step_ms == 0]
    jitter = [
        abs((after - before) / 1e6 - step_ms)
        for (before, first_ms), (after, then_ms) in pairwise(stream)
        if then_ms - first_ms == step_ms
    ]
    first: dict[int, int] = {}
    for came_ns, one in sent:
        if one.action_slot is not None:
            first.setdefault(one.action_slot, came_ns)
    openings = {int(number): came_ns for came_ns, number in bus.slots}
    return {
        "jitter": jitter,
        "action": [(first[slot] - ns) / 1e6 for slot, ns in bus.published.items() if slot in first and slot > 2],
        "state": states(bus, relay),
        "loop": [(ns - openings[slot]) / 1e6 for slot, ns in first.items() if flight.nodes and slot > 2],
    }


def on_the_wire(
    told: list[m.Setpoint], came: list[tuple[int, tuple[float, float, float]]]
) -> list[tuple[int, m.Setpoint]]:
    """When each setpoint that the bridge tells of came on the wire [ns]: they are told in the order of sending."""
    found, at = [], 0
    for one in told:
        east, north, up = one.velocity_enu
        same = struct.unpack("<3f", struct.pack("<3f", north, east, -up))
        here = next((i for i in range(at, min(at + 50, len(came))) if came[i][1] == same), None)
        if here is not None:
            found.append((came[here][0], one))
            at = here + 1
    return found


def states(bus: Bus, relay: Relay) -> list[float]:
    """From the newest position that a VehicleState can have been made of to its arrival [ms]."""
    boots = np.array(sorted(relay.positions))
    latencies = []
    for came_ns, payload in bus.states:
        state = topics.decode(payload, m.VehicleState)
        if state.phase in ("slots", "holding"):
            boot = int(boots[np.searchsorted(boots, state.time_s * 1000 + 0.5) - 1])
            latencies.append((came_ns - relay.positions[boot]) / 1e6)
    return latencies


def write_mission(folder: Path, slots: int, slot_s: float, half_m: float) -> Path:
    """For the rf and the agent node, with an untrained policy of agent's own making."""
    from agent.daddpg import DualActorDdpg
    from agent.policies import sizes
    from agent.training import save_policy
    from agent.training_config import TrainingConfig
    from rf_model.scenario import preset

    fields = {
        "users": J,
        "slot_s": slot_s,
        "start_enu": (0.0, 0.0, 15.0),
        "box_enu": ((-half_m, half_m), (-half_m, half_m), (8.0, 25.0)),
    }
    scenario, config = preset("physical_1km", **fields), TrainingConfig()
    assert scenario.elements == N
    checkpoint = folder / "untrained.safetensors"
    save_policy(checkpoint, DualActorDdpg(sizes(scenario), config), scenario, config, {})
    mission = folder / "mission.yaml"
    lists = json.loads(json.dumps(fields))
    mission.write_text(
        yaml.safe_dump(
            {
                "scenario": {"preset": "physical_1km", **lists},
                "slots": slots,
                "clock": "paced",
                "policy": {"kind": "da_ddpg", "checkpoint": str(checkpoint)},
            }
        )
    )
    return mission


@contextmanager
def process(what: str, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A module, or a script, in a process of its own until it is no longer needed."""
    how = ("-c", what) if "\n" in what else ("-m", what)
    started = subprocess.Popen([sys.executable, *how, *options], stdout=subprocess.DEVNULL)
    try:
        yield started
    finally:
        started.terminate()
        started.wait()


def await_node(session: zenoh.Session, *names: str | None) -> None:
    """Until these nodes are on the bus."""
    missing, came = {name for name in names if name}, queue.SimpleQueue[str]()
    watch = topics.watch_alive(session, VEHICLE, lambda node, alive: came.put(node))
    while missing:
        missing.discard(came.get(timeout=PATIENCE_S))
    watch.undeclare()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slots", type=int, default=200, help="of each flight")
    parser.add_argument("--slot-s", type=float, default=0.4)
    parser.add_argument("--only", nargs="+", choices=[flight.name for flight in FLIGHTS], help="only these")
    given = parser.parse_args()
    load = "{:.2f} {:.2f} {:.2f}".format(*os.getloadavg())
    print(f"bridge, {given.slots} slots of {given.slot_s:g} s each; {os.cpu_count()} cores, load {load} at the start")
    print("times in ms as p50 / p99, CPU in % of a core; (goal)")
    shown = ("jitter", "action", "state", "loop", "CPU")
    print(f"  {'':28}" + "".join(f"{name:>20}" for name in shown))
    for flight in FLIGHTS:
        if given.only and flight.name not in given.only:
            continue
        samples = measure(flight, given.slots, given.slot_s)
        cells = []
        for name in shown:
            values = samples[name]
            goal = f" ({flight.goals[name]:g})" if name in flight.goals else ""
            if not values:
                cells.append("-")
            elif name == "CPU":
                cells.append(f"{values[0]:.1f}{goal}")
            else:
                middle, high = np.percentile(values, [50, 99])
                cells.append(f"{middle:.2f} / {high:.2f}{goal}")
        print(f"  {flight.says:28}" + "".join(f"{cell:>20}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
