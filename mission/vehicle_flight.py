"""One vehicle's part of a mission: its bridge, what the bus says of it, its recording, and how its flight ended."""

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import zenoh

from autopilot_bridge.endings import ERROR, FAILSAFE
from bus import topics
from bus.messages import Command, CommandName, LinkReport, MissionEvent, NodeHealth, SlotOpened, VehicleState
from mission.flight_log import FILE_NAME as LOG_NAME
from mission.mission_file import Mission
from mission.progress import VehicleView
from mission.recorder import Recorder
from mission.supervisor import Node, describe_exit

LAST_WORDS_S = 1.0
"""Wall clock in which the last words of a bridge that is gone may still come."""
COME_DOWN_S = 600.0
"""Wall clock for the vehicle to come down by its failsafe."""
BRIDGE_SILENT_S = 90.0
"""Wall clock after which a bridge that says nothing is frozen for good; one that waits for a dead link takes 60 s."""
OUTLIVED_S = 10.0
"""The same for one whose embedded autopilot has landed and ended."""
START_RETRY_S = 0.2
"""Wall clock between two `start` commands, when the first was refused or not answered."""
LOOP_NODES = ("bridge", "rf", "agent")
BEFORE_START = ("connecting", "preflight", "ready", "ended")
"""The bridge's phases in which no `start` need have been obeyed."""

Item = VehicleState | SlotOpened | LinkReport | MissionEvent | NodeHealth | tuple[str, bool]


class VehicleFlight:
    """One vehicle; all calls from one thread, only `receive` is called from zenoh's."""

    def __init__(
        self,
        mission: Mission,
        folder: Path,
        session: zenoh.Session,
        view: VehicleView,
        receive: Callable[["VehicleFlight", Item], None],
    ) -> None:
        """`receive(vehicle, item)` gets what the bus says. Raises OSError when the recording cannot be made."""
        self.mission, self.folder, self.view = mission, folder, view
        self.name = mission.vehicle.name
        self.recorder = Recorder(session, self.name, folder / LOG_NAME) if mission.record.mcap else None
        self.bridge: Node | None = None
        self.sitl: Node | None = None
        """The process that plays it; None: a foreign autopilot, or nothing yet."""
        self.code: int | None = None
        """How it ended; None while it flies."""
        self.error = ""
        """Why it ended in an error."""
        self.armed = False
        self.started = False
        self._session = session
        self._alive: set[str] = set()
        self.phase = ""
        """The bridge's, as last heard."""
        self.start_at = 0.0
        """When to ask for the start again (monotonic clock)."""
        self.unstarted = ""
        """Why the last `start` was not taken."""
        self.ended: MissionEvent | None = None
        """The bridge's last words."""
        self._why = ""
        """The last error or failsafe told."""
        self._bridge_heard_at: float | None = None
        """When the bridge last said something (monotonic clock); None: not yet."""
        self._bridge_gone_at: float | None = None
        self._down_by: float | None = None
        """Until when its failsafe may take to bring it down, once nobody else does (monotonic clock)."""
        self._recording_stopped = False

        def put(item: Item) -> None:
            receive(self, item)

        refused: Counter[str] = Counter()
        self._declared = [
            topics.declare_alive(session, self.name, "mission"),
            topics.watch_alive(session, self.name, lambda node, alive: put((node, alive))),
            topics.subscribe(session, self.name, topics.STATE, put, refused),
            topics.subscribe(session, self.name, topics.SLOT, put, refused),
            topics.subscribe(session, self.name, topics.LINK, put, refused),
            topics.subscribe(session, self.name, topics.EVENT, put, refused),
            topics.subscribe(session, self.name, topics.HEALTH, put, refused),
        ]

    @property
    def missing(self) -> list[str]:
        """Nodes that are not on the bus."""
        return [node for node in LOOP_NODES if node not in self._alive]

    @property
    def ready(self) -> bool:
        """Whether its preflight is over and its nodes are there."""
        return self.phase == "ready" and not self.missing

    @property
    def over(self) -> bool:
        return self.code is not None

    @property
    def flying(self) -> bool:
        """Whether there is still a bridge to be commanded."""
        return not self.over and self.bridge is not None and self._bridge_gone_at is None

    @property
    def served(self) -> bool:
        """Whether radio and agent still have somebody to serve: they end by themselves with the last bridge."""
        return self.flying and self.ended is None and "bridge" in self._alive

    # What the fleet does with it.

    def take(self, item: Item) -> None:
        """What the bus said."""
        if _of_bridge(item):
            self._bridge_heard_at = time.monotonic()
        match item:
            case VehicleState():
                self.armed, self.phase = item.armed, item.phase
                self.started |= item.phase not in BEFORE_START  # also when the answer to `start` was lost
                self.view.state(item)
            case SlotOpened():
                self.view.slot(item)
            case LinkReport():
                self.view.link(item)
            case MissionEvent():
                self.view.event(item)
                if item.kind == "phase":
                    self.phase = item.text
                if item.kind in ("error", "failsafe"):
                    self._why = item.text
                if item.kind == "ended":
                    self.ended = item
            case (node, True):
                self._alive.add(node)
            case (node, False):
                self._alive.discard(node)

    def asked_to_start(self, why_not: str | None) -> None:
        """It was; None: it starts. A bridge that says no, or nothing, is to be asked again at `start_at`."""
        if why_not is None:
            self.started = True
            return
        if why_not != self.unstarted:
            self.view.note(why_not)
        self.unstarted, self.start_at = why_not, time.monotonic() + START_RETRY_S

    def command(self, name: CommandName) -> str | None:
        """Ask the bridge for something; why it will not do it, or None when it will."""
        command = Command(name=name)
        try:
            reply = topics.send_command(self._session, self.name, command)
        except (TimeoutError, topics.RefusedError) as error:
            return str(error)
        if self.recorder is not None:
            self.recorder.command(command)
            self.recorder.command(reply)
        return None if reply.accepted else f"{name} was refused: {reply.reason}"

    def watch(self) -> None:
        """See whether it is over, and how it ended then; never waits."""
        self._watch_recording()
        if self.over or self.bridge is None:
            return
        if self.bridge.running:
            self._watch_frozen(self.bridge)
            return
        if self._down_by is not None:
            self._watch_coming_down(self._down_by)
            return
        if self._bridge_gone_at is None:
            self._bridge_gone_at = time.monotonic()
        if self.ended is None and time.monotonic() < self._bridge_gone_at + LAST_WORDS_S:
            return
        if self.ended is None:
            self._bridge_lost(self.bridge)
        else:
            self._bridge_ended(self.bridge, self.ended)

    def fail(self, why: str) -> None:
        """It is over, with an error."""
        self.code, self.error = ERROR, why

    def give_up(self) -> None:
        """Wait no longer for a vehicle that comes down by itself."""
        if self._down_by is not None:
            self._down_by = 0.0

    def leave(self) -> None:
        """Off the bus; the recording goes on until `close`."""
        while self._declared:
            self._declared.pop().undeclare()

    def close(self) -> None:
        """End the recording."""
        if self.recorder is not None:
            self.recorder.close()

    # How it ended.

    def _bridge_ended(self, bridge: Node, ended: MissionEvent) -> None:
        code = ended.exit_code if ended.exit_code is not None else bridge.exit_code or ERROR
        if code == ERROR and self.armed and self.sitl is not None:
            self._down_by = time.monotonic() + COME_DOWN_S
        elif code == ERROR:
            self.fail(self._why or ended.text)
        else:
            self._end(code)

    def _bridge_lost(self, bridge: Node) -> None:
        if not self.armed:
            self.fail(told(bridge))
            return
        how = describe_exit(bridge.exit_code or 0)
        self._why = f"bridge: {how}"
        self.view.note(f"{self._why}; the autopilot's failsafe brings the vehicle down")
        if self.sitl is None:
            self.code = FAILSAFE
        else:
            self._down_by = time.monotonic() + COME_DOWN_S

    def _watch_frozen(self, bridge: Node) -> None:
        """A bridge that says nothing any more is ended, so that there is an end of the flight."""
        if self._bridge_heard_at is None:
            return
        outlived = self.sitl is not None and self.sitl.exit_code == 0
        if time.monotonic() > self._bridge_heard_at + (OUTLIVED_S if outlived else BRIDGE_SILENT_S):
            self.view.note("bridge: does not answer: it is ended")
            bridge.kill()

    def _watch_coming_down(self, until: float) -> None:
        """The embedded autopilot ends by itself once all that it plays have landed."""
        assert self.sitl is not None
        if not self.sitl.running and self.sitl.exit_code == 0:
            self.armed = False
            if self.ended is None:
                self.code = FAILSAFE
            else:
                self._end(FAILSAFE)
        elif not self.sitl.running or time.monotonic() > until:
            late = f"{self._why}; the vehicle was not down after {COME_DOWN_S:g} s"
            self.fail(late if self.ended is None else self._why or self.ended.text)

    def _end(self, code: int) -> None:
        self.code = code
        if code == FAILSAFE:
            self.view.note(f"ended safely, not as planned: {self._why}")

    def _watch_recording(self) -> None:
        if self.recorder is not None and self.recorder.error is not None and not self._recording_stopped:
            self._recording_stopped = True
            self.view.note(f"recording stopped: {reason(self.recorder.error)}")


def _of_bridge(item: Item) -> bool:
    match item:
        case VehicleState() | SlotOpened():
            return True
        case MissionEvent():
            return item.source == "bridge"
        case NodeHealth():
            return item.node == "bridge"
    return False


def told(node: Node) -> str:
    """Why a node did not come up, in its own last words."""
    words = node.last_words.removeprefix("error: ").removeprefix(f"{node.name}: ")
    return f"{node.name}: {words} ({describe_exit(node.exit_code or 0)})"


def reason(error: Exception) -> str:
    """Without the error's number."""
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)
