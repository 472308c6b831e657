"""`aerialstar fly`: start the nodes, watch the flight, bring everything home, report.

One vehicle is a fleet of one. Each has a bridge, a recording and an end of its own (`vehicle_flight`); radio and agent
node serve all, and simulator processes play as many as they can (`embedded`).
"""

import queue
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console

from autopilot_bridge.endings import AS_PLANNED, ERROR, FAILSAFE
from bus.messages import CommandName
from bus.session import free_endpoint, open_session
from mission import run_folder
from mission.embedded import Simulator, command, free_udp_ports, simulators
from mission.fleet import Fleet, missions
from mission.flight_log import FlightLogError
from mission.mission_file import Mission
from mission.progress import FlightView
from mission.report import Report, prepare, table, write
from mission.summary import summary
from mission.supervisor import Node, describe_exit, end_all, python
from mission.vehicle_flight import Item, VehicleFlight, reason, told

START_S = 180.0
"""Wall clock for the nodes to come up; the first time the flight model and numba compile."""
GATHER_S = 15.0
"""Wall clock for the nodes to end by themselves after the flight."""
WORST_FIRST = (ERROR, FAILSAFE, AS_PLANNED)


class FlightError(RuntimeError):
    """The flight could not start, or ended in an error; one line says why."""


def fly(mission: Mission | Fleet, console: Console) -> int:
    """Fly a checked mission and return the exit code, of several vehicles the worst: 1, 3, 0; shows progress, tables
    and run folder on `console`.

    No process is left behind, except for an embedded autopilot that a second Ctrl-C left in the air: it lands by its
    failsafe and ends. Raises MissionError when the run folder cannot be made, BusError when the bus cannot be opened,
    FlightError when a node does not come up, a bridge ends in an error or the run folder is full (exit code 1).
    """
    run = run_folder.make(mission)
    flight = _Flight(mission, run, console)
    with _interrupts(flight):
        try:
            code = flight.run()
        except FlightError as error:
            raise FlightError(f"{error}; logs are in {run / 'logs'}") from error
        except OSError as error:
            raise FlightError(f"{run}: {reason(error)}") from error
        if mission.record.mcap and not flight.abandoned:
            flight.report()
    if flight.errors:
        raise FlightError(f"{'; '.join(flight.errors)}; logs are in {run / 'logs'}")
    flight.view.note(f"run folder: {run}")
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
    def __init__(self, mission: Mission | Fleet, run: Path, console: Console) -> None:
        self._mission, self._missions, self._run = mission, missions(mission), run
        self.view = FlightView(console)
        self._inbox: queue.SimpleQueue[tuple[VehicleFlight, Item]] = queue.SimpleQueue()
        self._vehicles: list[VehicleFlight] = []
        self._shared: dict[str, Node] = {}
        """Nodes that serve all vehicles: radio, agent, simulators."""
        self._gone: set[str] = set()
        """Those whose death was dealt with."""
        self._preparing: threading.Thread | None = None
        """Imports what the report needs while the vehicles come down."""
        self._interrupts = 0
        self._obeyed = 0
        self.abandoned = False

    def interrupt(self) -> None:
        """Ctrl-C."""
        self._interrupts += 1

    @property
    def errors(self) -> list[str]:
        """Of each vehicle that ended in one."""
        return [f"{self._label(vehicle.mission)}{vehicle.error}" for vehicle in self._vehicles if vehicle.error]

    def run(self) -> int:
        """Fly; the exit code. Raises FlightError when there was no flight, OSError."""
        endpoint = free_endpoint()
        with ExitStack() as stack:
            session = stack.enter_context(open_session(listen=endpoint))
            for mission in self._missions:
                view = self.view.vehicle(mission.vehicle.name, self._label(mission))
                folder = run_folder.vehicle_folder(self._run, self._mission, mission)
                vehicle = VehicleFlight(mission, folder, session, view, lambda *said: self._inbox.put(said))
                stack.callback(vehicle.close)
                self._vehicles.append(vehicle)
            for vehicle in self._vehicles:
                stack.callback(vehicle.leave)
            stack.callback(self._gather)
            stack.enter_context(self.view)
            self._start_nodes(endpoint)
            return self._watch()

    def report(self) -> None:
        """Write and show what each flight came to that did not end in an error. Raises FlightError."""
        reports: dict[str, Report] = {}
        for vehicle in self._vehicles:
            if vehicle.error:
                continue
            try:
                reports[vehicle.name] = report = write(vehicle.folder)
            except (OSError, FlightLogError) as error:
                raise FlightError(f"{vehicle.folder}: no report: {reason(error)}") from error
            if report.slots and not self._several:
                self.view.result(table(report))
        if self._several:
            codes = {vehicle.name: vehicle.code for vehicle in self._vehicles}
            self.view.result(summary(codes, reports))

    @property
    def _several(self) -> bool:
        return isinstance(self._mission, Fleet)

    def _label(self, mission: Mission) -> str:
        return f"{mission.vehicle.name}: " if self._several else ""

    # Processes.

    def _start_nodes(self, endpoint: str) -> None:
        file, logs = str(self._run / run_folder.MISSION_NAME), self._run / "logs"
        common = ["--mission", file, "--connect", endpoint, "--until-ended"]
        spacing_m = self._mission.vehicles_spacing_m if isinstance(self._mission, Fleet) else 0.0
        ports: dict[str, int] = {}
        played: dict[str, tuple[Simulator, Node]] = {}
        first_port = free_udp_ports(sum(mission.embedded for mission in self._missions))
        for simulator in simulators(self._missions):
            first = first_port + simulator.place
            node = Node(simulator.name, command(simulator, first, self._mission.seed, spacing_m), logs)
            self._shared[simulator.name] = node
            for port, mission in enumerate(simulator.missions, start=first):
                ports[mission.vehicle.name], played[mission.vehicle.name] = port, (simulator, node)
        for name in ("rf", "agent"):
            self._shared[name] = Node(name, python("mission", name, *common), logs)
        for vehicle in self._vehicles:
            options = ["--vehicle", vehicle.name] if self._several else []
            if vehicle.name in played:
                simulator, vehicle.sitl = played[vehicle.name]
                options += ["--autopilot", f"udpin://127.0.0.1:{ports[vehicle.name]}", "--no-put-back"]
                address = self._await_printed(simulator, vehicle.sitl)
                if self._mission.clock == "lockstep":
                    options += ["--control", address]
            if self._mission.record.tlog:
                options += ["--tlog", str(vehicle.folder / "flight.tlog")]
            name = f"bridge_{vehicle.name}" if self._several else "bridge"
            vehicle.bridge = Node(name, python("mission", "bridge", *common, *options), logs)

    def _await_printed(self, simulator: Simulator, node: Node) -> str:
        """The line about a socket, which the SITL prints when it is ready: its flight model may have to compile."""
        deadline = time.monotonic() + START_S
        compiling = False
        while (line := node.printed(simulator.ready)) is None:
            if not node.running:
                raise FlightError(told(node))
            if self._interrupts:
                raise FlightError("interrupted before the start")
            if time.monotonic() > deadline:
                raise FlightError(f"{node.name}: not up after {START_S:g} s ({node.last_words})")
            if not compiling and (what := node.printed("compiling ")) is not None:
                compiling = True
                self.view.note(f"{node.name}: compiling {what}")
            self._hear(0.02)
        return line

    def _gather(self) -> None:
        """End every process; embedded autopilots that still fly get the time to land."""
        all_ended = all(vehicle.ended for vehicle in self._vehicles)
        sitls = {id(vehicle.sitl) for vehicle in self._vehicles}
        loop = [vehicle.bridge for vehicle in self._vehicles if vehicle.bridge is not None]
        loop += [node for node in self._shared.values() if id(node) not in sitls]
        if not self._any_started:
            self._call_off()
        # Who never saw them fly, waits on.
        end_all(loop, patience_s=GATHER_S if all_ended and self._any_started else 0.0)
        if not self.abandoned:
            down = all_ended and not any(vehicle.armed for vehicle in self._vehicles)
            end_all(list(self._shared.values()), patience_s=GATHER_S if down else 0.0)

    def _call_off(self) -> None:
        """Before the start: a bridge that sees the mission gone ends, after it has put back what preflight has set."""
        for vehicle in self._vehicles:
            vehicle.leave()
        foreign = [one.bridge for one in self._vehicles if one.bridge is not None and not one.mission.embedded]
        end_all(foreign, patience_s=GATHER_S)

    # The flight.

    @property
    def _any_started(self) -> bool:
        return any(vehicle.started for vehicle in self._vehicles)

    def _watch(self) -> int:
        """Until all flights are over; the exit code."""
        deadline = time.monotonic() + START_S
        while True:
            self._hear(0.05)
            if self._interrupts > self._obeyed:
                self._obeyed += 1
                if self._interrupted():
                    return ERROR
            for vehicle in self._vehicles:
                was_over = vehicle.over
                vehicle.watch()
                if vehicle.error and not was_over:
                    self._failed(vehicle)
            if all(vehicle.over for vehicle in self._vehicles):
                codes = {vehicle.code for vehicle in self._vehicles}
                return next(code for code in WORST_FIRST if code in codes)
            self._check_shared()
            self._start_flights()
            if time.monotonic() > deadline:
                self._check_started()

    def _failed(self, vehicle: VehicleFlight) -> None:
        """One vehicle ended in an error: the others fly on, but without it none starts."""
        if not self._any_started:
            raise FlightError(f"{self._label(vehicle.mission)}{vehicle.error}")
        if self._several:
            vehicle.view.note(f"error: {vehicle.error}")

    def _start_flights(self) -> None:
        """When all are there; once one has started, each other one as soon as it is taken; none after Ctrl-C."""
        if self._obeyed:
            return
        waiting = [vehicle for vehicle in self._vehicles if vehicle.flying and not vehicle.started]
        there = all(vehicle.ready if self._several else not vehicle.missing for vehicle in waiting)
        if there or self._any_started:
            due = [vehicle for vehicle in waiting if time.monotonic() >= vehicle.start_at]
            for vehicle, why_not in self._command_all(due, "start").items():
                vehicle.asked_to_start(why_not)

    def _check_started(self) -> None:
        """Too long after the launch, who has not started will not. Raises FlightError when none has."""
        for vehicle in self._vehicles:
            if vehicle.started or vehicle.over:
                continue
            missing = ", ".join(vehicle.missing)
            vehicle.fail(
                f"not on the bus after {START_S:g} s: {missing}"
                if missing
                else f"not started after {START_S:g} s: {vehicle.unstarted or 'not ready'}"
            )
            self._failed(vehicle)

    def _interrupted(self) -> bool:
        """Act on Ctrl-C; whether that is the end."""
        if not self._any_started:
            self.view.note("interrupted before the start")
            return True
        if self._obeyed > 1:
            self.abandoned = True
            self.view.note("Ctrl-C again: the nodes end, the vehicle is left to its autopilot's failsafe")
            return True
        self.view.note("Ctrl-C: landing (once more: end now and leave the vehicle to its failsafe)")
        flying = [vehicle for vehicle in self._vehicles if vehicle.flying]
        if not flying:
            for vehicle in self._vehicles:
                vehicle.give_up()
        for vehicle, why_not in self._command_all(flying, "land").items():
            if why_not is not None:
                vehicle.view.note(why_not)
        return False

    def _command_all(self, vehicles: Sequence[VehicleFlight], name: CommandName) -> dict[VehicleFlight, str | None]:
        """Why each will not do it, if so. All are asked at once: one that does not answer must not keep the others."""
        with ThreadPoolExecutor(max_workers=len(self._vehicles)) as pool:
            return dict(zip(vehicles, pool.map(lambda vehicle: vehicle.command(name), vehicles), strict=True))

    def _check_shared(self) -> None:
        """Radio, agent and autopilots: one that is gone is started again once, if the mission says so."""
        if self._any_started and not any(vehicle.served for vehicle in self._vehicles):
            return  # they end with the last flight
        for name, node in self._shared.items():
            if name in self._gone or node.running:
                continue
            if not self._any_started:
                raise FlightError(told(node))
            how = describe_exit(node.exit_code or 0)
            again = name in ("rf", "agent") and self._mission.restart == "once" and node.starts == 1
            self.view.note(f"{name}: {how}{', starting it again' if again else ''}")
            if again:
                node.restart()
            else:
                self._gone.add(name)

    def _hear(self, timeout_s: float) -> None:
        """Take in what the bus says, for `timeout_s` at least."""
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0:
            try:
                vehicle, item = self._inbox.get(timeout=left)
            except queue.Empty:
                break
            vehicle.take(item)
        if self._preparing is None and self._mission.record.mcap and all(map(_coming_down, self._vehicles)):
            self._preparing = threading.Thread(target=prepare, daemon=True)
            self._preparing.start()
        self.view.show()


def _coming_down(vehicle: VehicleFlight) -> bool:
    return vehicle.over or vehicle.phase in ("returning", "landing")
