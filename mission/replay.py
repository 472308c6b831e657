"""Feeds the recorded slots and actions of a run to a fresh rf node over a real bus, and compares what it says."""

import queue
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from bus import topics
from bus.messages import Action, ChannelState, LinkReport, RisConfiguration, SlotOpened, VehicleState
from bus.session import free_endpoint, open_session
from mission.flight_log import FlightLog, read
from mission.mission_file import action_deadline_s, load
from mission.run_folder import MISSION_NAME
from mission.supervisor import Node, python

START_S = 120.0
ANSWER_S = 10.0

_Sent = VehicleState | SlotOpened | Action
_Heard = ChannelState | RisConfiguration | LinkReport


class ReplayError(RuntimeError):
    """The replay could not be made; one line says why."""


@dataclass(frozen=True)
class Replay:
    """What came of it."""

    compared: int
    """Messages that are in the recording."""
    differences: tuple[str, ...]
    """One line for each message that is not the same, or did not come."""

    @property
    def same(self) -> bool:
        return self.compared > 0 and not self.differences

    def __str__(self) -> str:
        if self.same:
            return f"replay: {self.compared} channel states, configurations and link reports, all the same bit for bit"
        if not self.compared:
            return "replay: the recording holds nothing to compare"
        return f"replay: {len(self.differences)} of {self.compared} messages differ; the first is {self.differences[0]}"


def replay(run: Path) -> Replay:
    """Replay a run folder.

    A node that was restarted in flight, or that took an action which this recording shows as late, may differ: what
    it knew then is not in the messages. Raises FlightLogError, MissionError, BusError, ReplayError.
    """
    mission = load(run / MISSION_NAME)
    log = read(run)
    deadline_s = action_deadline_s(mission)
    heard: queue.SimpleQueue[_Heard] = queue.SimpleQueue()
    refused: Counter[str] = Counter()
    endpoint = free_endpoint()
    name = mission.vehicle.name
    with ExitStack() as stack:
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="aerialstar-replay-")))
        session = stack.enter_context(open_session(listen=endpoint))
        alive: queue.SimpleQueue[str] = queue.SimpleQueue()
        keep = [
            topics.watch_alive(session, name, lambda node, _: alive.put(node)),
            topics.subscribe(session, name, topics.CSI, heard.put, refused),
            topics.subscribe(session, name, topics.CONFIGURATION, heard.put, refused),
            topics.subscribe(session, name, topics.LINK, heard.put, refused),
        ]
        stack.callback(keep.clear)
        node = Node("rf", python("mission", "rf", "--mission", str(run / MISSION_NAME), "--connect", endpoint), logs)
        stack.callback(node.end)
        _await_node(node, alive)
        state = topics.Publisher(session, name, topics.STATE)
        slot = topics.Publisher(session, name, topics.SLOT)
        action = topics.Publisher(session, name, topics.ACTION)
        answers = _Answers(heard)
        for message, expected in script(log, deadline_s):
            match message:
                case VehicleState():
                    state.send(message)
                case SlotOpened():
                    slot.send(message)
                case Action():
                    action.send(message)
            answers.await_(expected)
    return _compare(log, answers.got)


class _Answers:
    """What the node has said, by topic and slot."""

    def __init__(self, heard: queue.SimpleQueue[_Heard]) -> None:
        self._heard = heard
        self.got: dict[tuple[str, int], _Heard] = {}

    def await_(self, expected: list[tuple[str, int]]) -> None:
        """Take in answers until the expected ones are there, or for `ANSWER_S`."""
        deadline = time.monotonic() + ANSWER_S
        while any(key not in self.got for key in expected):
            try:
                message = self._heard.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                return
            self.got[_topic(message), message.slot] = message


def script(log: FlightLog, deadline_s: float) -> Iterator[tuple[_Sent, list[tuple[str, int]]]]:
    """Messages to send, each with the answers to wait for before the next.

    They go out in the order recorded, but for the actions that the bridge says it got in time: those follow their
    slot's opening at once. Action and opening came to the recorder over different links, so their order there is not
    that of the flight.
    """
    opened = log.by_slot(topics.SLOT)
    in_time = {
        slot: action
        for slot, action in log.by_slot(topics.ACTION).items()
        if slot in opened and slot + 1 in opened and _came_in_time(opened[slot + 1])
    }
    current: SlotOpened | None = None
    now_s = float("-inf")
    for message in _recorded(log):
        match message:
            case VehicleState():
                now_s = message.time_s
                yield message, []
            case SlotOpened():
                expected: list[tuple[str, int]] = []
                if current is not None:
                    expected += [(topics.CONFIGURATION.name, current.slot), (topics.LINK.name, current.slot)]
                if not message.closing:
                    expected.append((topics.CSI.name, message.slot))
                current = message
                yield message, expected
                if message.slot in in_time:
                    yield in_time[message.slot], [(topics.CONFIGURATION.name, message.slot)]
            case Action() if message.slot not in in_time:
                answered = current is not None and message.slot == current.slot and now_s <= current.time_s + deadline_s
                yield message, [(topics.CONFIGURATION.name, message.slot)] if answered else []
            case _:
                pass


def _recorded(log: FlightLog) -> Iterator[_Sent]:
    kinds: dict[str, type[VehicleState] | type[SlotOpened] | type[Action]] = {
        topics.STATE.name: VehicleState,
        topics.SLOT.name: SlotOpened,
        topics.ACTION.name: Action,
    }
    for entry in log.entries:
        if entry.topic in kinds:
            try:
                yield topics.decode(entry.payload, kinds[entry.topic])
            except topics.RefusedError:
                continue


def _came_in_time(next_opened: SlotOpened) -> bool:
    return next_opened.flown is not None and next_opened.flown.outcome not in ("missing", "late")


def _await_node(node: Node, alive: queue.SimpleQueue[str]) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        try:
            if alive.get(timeout=0.1) == "rf":
                return
        except queue.Empty:
            if not node.running:
                raise ReplayError(f"rf node: {node.last_words}") from None
    raise ReplayError(f"rf node: not on the bus after {START_S:g} s")


def _compare(log: FlightLog, got: dict[tuple[str, int], _Heard]) -> Replay:
    recorded: list[_Heard] = [
        *log.by_slot(topics.CSI).values(),
        *log.by_slot(topics.CONFIGURATION).values(),
        *log.by_slot(topics.LINK).values(),
    ]
    differences = []
    for message in recorded:
        name = _topic(message)
        again = got.get((name, message.slot))
        if again is None:
            differences.append(f"{name} of slot {message.slot}: it did not come")
        elif topics.encode(again) != topics.encode(message):
            differences.append(f"{name} of slot {message.slot}")
    return Replay(len(recorded), tuple(differences))


def _topic(message: _Heard) -> str:
    match message:
        case ChannelState():
            return topics.CSI.name
        case RisConfiguration():
            return topics.CONFIGURATION.name
        case LinkReport():
            return topics.LINK.name
