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
from bus.messages import Action, ChannelState, LinkReport, RisConfiguration, SlotOpened
from bus.session import free_endpoint, open_session
from mission.flight_log import FlightLog, read
from mission.mission_file import load
from mission.run_folder import MISSION_NAME
from mission.supervisor import Node, python

START_S = 120.0
ANSWER_S = 10.0

_Sent = SlotOpened | Action
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

    A node that was restarted in flight, or that an action never reached, may differ: what it knew then is not in the
    messages. Raises FlightLogError, MissionError, BusError, ReplayError.
    """
    mission = load(run / MISSION_NAME)
    log = read(run)
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
        slot = topics.Publisher(session, name, topics.SLOT)
        action = topics.Publisher(session, name, topics.ACTION)
        answers = _Answers(heard)
        for message, expected in script(log):
            match message:
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


def script(log: FlightLog) -> Iterator[tuple[_Sent, list[tuple[str, int]]]]:
    """Messages to send, each with the answers to wait for before the next.

    An action follows its slot's opening at once when the bridge or the node got it in time: either may have had it
    sooner than the other, and it came to the recorder over another link than the opening, so their order there is not
    that of the flight. Any other action follows the next opening, when it changes nothing any more.
    """
    opened, actions = log.by_slot(topics.SLOT), log.by_slot(topics.ACTION)
    applied = {slot for slot, set_by in log.by_slot(topics.CONFIGURATION).items() if set_by.source == "action"}
    in_time = applied | {slot for slot in opened if slot + 1 in opened and _came_in_time(opened[slot + 1])}
    before: SlotOpened | None = None
    for slot in sorted(opened):
        expected: list[tuple[str, int]] = []
        if before is not None:
            expected += [(topics.CONFIGURATION.name, before.slot), (topics.LINK.name, before.slot)]
        if not opened[slot].closing:
            expected.append((topics.CSI.name, slot))
        yield opened[slot], expected
        if slot in actions.keys() & in_time:
            yield actions[slot], [(topics.CONFIGURATION.name, slot)]
        if before is not None and before.slot in actions.keys() - in_time:
            yield actions[before.slot], []
        before = opened[slot]


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
