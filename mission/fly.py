"""`aerialstar fly`: start the nodes, watch the flight, bring everything home, report."""

import os
import queue
import signal
import socket
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import zenoh
from rich.console import Console

from bus import topics
from bus.messages import Command, CommandName, LinkReport, MissionEvent, SlotOpened, VehicleState
from bus.session import free_endpoint, open_session
from mission import run_folder
from mission.flight_log import FILE_NAME as LOG_NAME
from mission.flight_log import FlightLogError
from mission.mission_file import Mission
from mission.progress import FlightView
from mission.recorder import Recorder
from mission.report import table, write
from mission.supervisor import Node, describe_exit, end_all, python

AS_PLANNED, ERROR, FAILSAFE = 0, 1, 3
"""Exit codes; 2 is bad input."""
START_S = 180.0
"""Wall clock for the nodes to come up; the first time the flight model and numba compile."""
GATHER_S = 15.0
"""Wall clock for the nodes to end by themselves after the flight."""
COME_DOWN_S = 600.0
"""Wall clock for the vehicle to come down by its failsafe."""
FAILSAFE_SPEED = 10.0
"""How fast the embedded autopilot flies its failsafe after a lockstep flight lost its bridge: nobody's clock runs."""
START_RETRY_S = 0.2
"""Wall clock between two `start` commands, when the first was refused or not answered."""
WITH_FAILSAFES = {"px4": {"COM_LOW_BAT_ACT": 3.0}, "arducopter": {"BATT_FS_LOW_ACT": 2.0}}
"""What the embedded autopilot starts with besides its defaults, which leave a low battery to the pilot: it returns."""
LOOP_NODES = ("bridge", "rf", "agent")
BEFORE_START = ("connecting", "preflight", "ready", "ended")
"""The bridge's phases in which no `start` need have been obeyed."""

_Item = VehicleState | SlotOpened | LinkReport | MissionEvent | tuple[str, bool]


class FlightError(RuntimeError):
    """The flight could not start, or ended in an error; one line says why."""


def fly(mission: Mission, console: Console) -> int:
    """Fly a checked mission and return the exit code; shows progress, table and run folder on `console`.

    No process is left behind, except for an embedded autopilot that a second Ctrl-C left in the air: it lands by its
    failsafe and ends. Raises MissionError when the run folder cannot be made, BusError when the bus cannot be opened,
    FlightError when a node does not come up, the bridge ends in an error or the run folder is full (exit code 1).
    """
    run = run_folder.make(mission)
    flight = _Flight(mission, run, console)
    with _interrupts(flight):
        try:
            code = flight.run()
        except FlightError as error:
            raise FlightError(f"{error}; logs are in {run / 'logs'}") from error
        except OSError as error:
            raise FlightError(f"{run}: {_reason(error)}") from error
        if mission.record.mcap and not flight.abandoned:
            try:
                report = write(run)
            except (OSError, FlightLogError) as error:
                raise FlightError(f"{run}: no report: {_reason(error)}") from error
            if report.slots:
                console.print(table(report))
    console.print(f"run folder: {run}", highlight=False, soft_wrap=True)
    return code


@contextmanager
def _interrupts(flight: "_Flight") -> Iterator[None]:
    """Ctrl-C and SIGTERM are counted, and acted on by the flight's loop."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, lambda _number, _frame: flight.interrupt())
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Flight:
    def __init__(self, mission: Mission, run: Path, console: Console) -> None:
        self._mission, self._run, self._console = mission, run, console
        self._view = FlightView(console)
        self._inbox: queue.SimpleQueue[_Item] = queue.SimpleQueue()
        self._refused: Counter[str] = Counter()
        self._nodes: dict[str, Node] = {}
        self._gone: set[str] = set()
        """Nodes whose death was dealt with."""
        self._alive: set[str] = set()
        self._armed = False
        self._started = False
        self._start_at = 0.0
        """When to ask for the start again (monotonic clock)."""
        self._unstarted = ""
        """Why the last `start` was not taken."""
        self._ended: MissionEvent | None = None
        self._why = ""
        """The last error or failsafe told."""
        self._recorder: Recorder | None = None
        self._recording_stopped = False
        self._interrupts = 0
        self._obeyed = 0
        self.abandoned = False

    def interrupt(self) -> None:
        """Ctrl-C."""
        self._interrupts += 1

    def run(self) -> int:
        endpoint = free_endpoint()
        with ExitStack() as stack:
            session = stack.enter_context(open_session(listen=endpoint))
            if self._mission.record.mcap:
                recorder = Recorder(session, self._mission.vehicle.name, self._run / LOG_NAME)
                self._recorder = stack.enter_context(recorder)
            declared = self._declare(session)
            stack.callback(declared.clear)
            stack.callback(self._gather)
            stack.enter_context(self._view)
            self._session = session
            self._start_nodes(endpoint)
            return self._watch()

    def _declare(self, session: zenoh.Session) -> list[object]:
        name, put = self._mission.vehicle.name, self._inbox.put
        return [
            topics.declare_alive(session, name, "mission"),
            topics.watch_alive(session, name, lambda node, alive: put((node, alive))),
            topics.subscribe(session, name, topics.STATE, put, self._refused),
            topics.subscribe(session, name, topics.SLOT, put, self._refused),
            topics.subscribe(session, name, topics.LINK, put, self._refused),
            topics.subscribe(session, name, topics.EVENT, put, self._refused),
        ]

    # Processes.

    def _start_nodes(self, endpoint: str) -> None:
        mission, logs = self._mission, self._run / "logs"
        common = ["--mission", str(self._run / run_folder.MISSION_NAME), "--connect", endpoint, "--until-ended"]
        bridge_options: list[str] = []
        if mission.embedded:
            port = _free_udp_port()
            bridge_options += ["--autopilot", f"udpin://127.0.0.1:{port}", "--no-put-back"]
            self._nodes["sitl"] = Node("sitl", self._sitl_command(port), logs)
        for name in ("rf", "agent"):
            self._nodes[name] = Node(name, python("mission", name, *common), logs)
        if mission.clock == "lockstep":
            bridge_options += ["--control", self._await_printed(self._nodes["sitl"], "control ")]
        elif mission.embedded:
            self._await_printed(self._nodes["sitl"], "companion ")
        if mission.record.tlog:
            bridge_options += ["--tlog", str(self._run / "flight.tlog")]
        self._nodes["bridge"] = Node("bridge", python("mission", "bridge", *common, *bridge_options), logs)

    def _sitl_command(self, companion_port: int) -> list[str]:
        mission = self._mission
        lockstep = mission.clock == "lockstep"
        key, played = mission.vehicle.signing_key, mission.vehicle.sitl
        return python(
            "sitl",
            *("--personality", played.personality),
            *(("--signing-key", str(key)) if key is not None else ()),
            *("--companion-port", str(companion_port), "--companion-bind", "0", "--gcs-bind", "0"),
            *(("--lockstep", "--control-port", "0") if lockstep else ()),
            *("--speed", str(FAILSAFE_SPEED if lockstep else mission.speed), "--exit-when-landed"),
            *("--launcher", str(os.getpid())),
            *("--seed", str(mission.seed), "--system-id", str(mission.vehicle.system_id)),
            *(
                part
                for name, value in (WITH_FAILSAFES[played.personality] | played.parameters).items()
                for part in ("--param", f"{name}={value:g}")
            ),
        )

    def _await_printed(self, sitl: Node, start: str) -> str:
        """The line about a socket, which the SITL prints when it is ready: its flight model may have to compile."""
        deadline = time.monotonic() + START_S
        compiling = False
        while (line := sitl.printed(start)) is None:
            if not sitl.running:
                raise FlightError(_told(sitl))
            if self._interrupts:
                raise FlightError("interrupted before the start")
            if time.monotonic() > deadline:
                raise FlightError(f"sitl: not up after {START_S:g} s ({sitl.last_words})")
            if not compiling and (what := sitl.printed("compiling ")) is not None:
                compiling = True
                self._view.note(f"sitl: compiling {what}")
            self._hear(0.02)
        return line

    def _gather(self) -> None:
        """End every process; an embedded autopilot that still flies gets the time to land."""
        loop = [node for name, node in self._nodes.items() if name != "sitl"]
        end_all(loop, patience_s=GATHER_S if self._ended and self._started else 0.0)  # who never saw it fly, waits on
        sitl = self._nodes.get("sitl")
        if sitl is not None and not self.abandoned:
            end_all([sitl], patience_s=GATHER_S if self._ended and not self._armed else 0.0)

    # The flight.

    def _watch(self) -> int:
        """Until the flight is over; the exit code."""
        deadline = time.monotonic() + START_S
        bridge = self._nodes["bridge"]
        while True:
            self._hear(0.05)
            if self._interrupts > self._obeyed:
                self._obeyed += 1
                code = self._interrupted()
                if code is not None:
                    return code
            if not bridge.running:
                return self._bridge_over(bridge)
            self._check_others()
            if not self._started and self._alive.issuperset(LOOP_NODES) and time.monotonic() >= self._start_at:
                self._start_flight()
            if not self._started and time.monotonic() > deadline:
                missing = ", ".join(name for name in LOOP_NODES if name not in self._alive)
                raise FlightError(
                    f"not on the bus after {START_S:g} s: {missing}"
                    if missing
                    else f"not started after {START_S:g} s: {self._unstarted}"
                )

    def _start_flight(self) -> None:
        """Ask for the start; a bridge that says no, or nothing, is asked again later."""
        why_not = self._command("start")
        if why_not is None:
            self._started = True
            return
        if why_not != self._unstarted:
            self._view.note(why_not)
        self._unstarted, self._start_at = why_not, time.monotonic() + START_RETRY_S

    def _interrupted(self) -> int | None:
        if not self._started:
            self._view.note("interrupted before the start")
            return ERROR
        if self._obeyed > 1:
            self.abandoned = True
            self._view.note("Ctrl-C again: the nodes end, the vehicle is left to its autopilot's failsafe")
            return ERROR
        self._view.note("Ctrl-C: landing (once more: end now and leave the vehicle to its failsafe)")
        why_not = self._command("land")
        if why_not is not None:
            self._view.note(why_not)
        return None

    def _command(self, name: CommandName) -> str | None:
        """Ask the bridge for something; why it will not do it, or None when it will."""
        command = Command(name=name)
        try:
            reply = topics.send_command(self._session, self._mission.vehicle.name, command)
        except (TimeoutError, topics.RefusedError) as error:
            return str(error)
        if self._recorder is not None:
            self._recorder.command(command)
            self._recorder.command(reply)
        return None if reply.accepted else f"{name} was refused: {reply.reason}"

    def _bridge_over(self, bridge: Node) -> int:
        deadline = time.monotonic() + 1.0
        while self._ended is None and time.monotonic() < deadline:
            self._hear(0.05)  # its last words may still be on their way
        if self._ended is None:
            return self._bridge_lost(bridge)
        code = self._ended.exit_code
        if code == ERROR and self._armed and self._await_landing():
            code = FAILSAFE
        if code is None:
            code = bridge.exit_code or ERROR
        if code == ERROR:
            raise FlightError(self._why or self._ended.text)
        if code == FAILSAFE:
            self._view.note(f"ended safely, not as planned: {self._why}")
        return code

    def _bridge_lost(self, bridge: Node) -> int:
        how = describe_exit(bridge.exit_code or 0)
        if not self._armed:
            raise FlightError(_told(bridge))
        self._view.note(f"bridge: {how}; the autopilot's failsafe brings the vehicle down")
        if self._mission.embedded and not self._await_landing():
            raise FlightError(f"bridge: {how}; the vehicle was not down after {COME_DOWN_S:g} s")
        return FAILSAFE

    def _await_landing(self) -> bool:
        """Whether the embedded autopilot landed and ended by itself."""
        sitl = self._nodes.get("sitl")
        if sitl is None:
            return False
        deadline = time.monotonic() + COME_DOWN_S
        while sitl.running:
            self._hear(0.05)
            if time.monotonic() > deadline or self._interrupts > self._obeyed:
                return False
        self._armed = False
        return sitl.exit_code == 0

    def _check_others(self) -> None:
        """Radio, agent and autopilot: one that is gone is started again once, if the mission says so."""
        for name, node in self._nodes.items():
            if name == "bridge" or name in self._gone or node.running or self._ended is not None:
                continue
            if not self._started:
                raise FlightError(_told(node))
            how = describe_exit(node.exit_code or 0)
            again = name != "sitl" and self._mission.restart == "once" and node.starts == 1
            self._view.note(f"{name}: {how}{', starting it again' if again else ''}")
            if again:
                node.restart()
            else:
                self._gone.add(name)

    def _hear(self, timeout_s: float) -> None:
        """Take in what the bus says, for `timeout_s` at least."""
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0:
            try:
                item = self._inbox.get(timeout=left)
            except queue.Empty:
                break
            self._take(item)
        if self._recorder is not None and self._recorder.error is not None and not self._recording_stopped:
            self._recording_stopped = True
            self._view.note(f"recording stopped: {_reason(self._recorder.error)}")
        self._view.show()

    def _take(self, item: _Item) -> None:
        match item:
            case VehicleState():
                self._armed = item.armed
                self._started |= item.phase not in BEFORE_START  # also when the answer to `start` was lost
                self._view.state(item)
            case SlotOpened():
                self._view.slot(item)
            case LinkReport():
                self._view.link(item)
            case MissionEvent():
                self._view.event(item)
                if item.kind in ("error", "failsafe"):
                    self._why = item.text
                if item.kind == "ended":
                    self._ended = item
            case (node, True):
                self._alive.add(node)
            case (node, False):
                self._alive.discard(node)


def _told(node: Node) -> str:
    """Why a node did not come up, in its own last words."""
    words = node.last_words.removeprefix("error: ").removeprefix(f"{node.name}: ")
    return f"{node.name}: {words} ({describe_exit(node.exit_code or 0)})"


def _reason(error: Exception) -> str:
    """Without the error's number."""
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
