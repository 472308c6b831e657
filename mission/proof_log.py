"""The setpoints of a flight: from what, how old, how clipped, and whether what each says of itself was so."""

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

import msgspec

from bus import topics
from bus.messages import MissionEvent, Setpoint
from mission.flight_log import FlightLog

ROUNDING_S = 1e-6
"""Of times that were computed in different ways."""
NOT_STREAMING = ("yielded", "returning", "landing", "ended")
"""Phases in which no setpoints are meant to come."""
STREAMING_RUNGS = ("FLY", "HOLD")


class Setpoints(msgspec.Struct, frozen=True):
    """All of a flight."""

    number: int
    by_source: dict[str, int]
    clipped: dict[str, int]
    """Setpoints by what changed them; one may have several reasons."""
    longest_interval_s: float
    """Vehicle time between two of them while they were meant to come."""
    max_action_age_s: float | None
    """The longest that an action was flown; None when none was."""
    max_state_age_s: float
    contradictions: list[str]
    """What does not hold together, one line each."""


def setpoints(log: FlightLog) -> Setpoints | None:
    """None when none was recorded, as before there were any."""
    sent = log.messages(topics.SETPOINT)
    recorded = sum(entry.topic == topics.SETPOINT.name for entry in log.entries)
    if not recorded:
        return None
    stops_s = [event.time_s for event in log.messages(topics.EVENT) if _stops(event)]
    intervals_s = [
        after.time_s - before.time_s
        for before, after in pairwise(sent)
        if not any(before.time_s <= stop_s <= after.time_s for stop_s in stops_s)
    ]
    return Setpoints(
        number=recorded,
        by_source=dict(Counter(setpoint.source for setpoint in sent)),
        clipped=dict(Counter(reason for setpoint in sent for reason in setpoint.reasons)),
        longest_interval_s=max(intervals_s, default=0.0),
        max_action_age_s=max((s.action_age_s for s in sent if s.action_age_s is not None), default=None),
        max_state_age_s=max((s.state_age_s for s in sent), default=0.0),
        contradictions=[*_unread(recorded - len(sent)), *_told(_Witness(log), sent)],
    )


class _Witness:
    """What else was recorded, which setpoints must agree with."""

    def __init__(self, log: FlightLog) -> None:
        self._whole = log.complete
        """Only then is something that was not recorded something that was not."""
        self._opened_s = {slot: opened.time_s for slot, opened in log.by_slot(topics.SLOT).items()}
        self._outcomes = {
            opened.flown.slot: opened.flown.outcome for opened in log.messages(topics.SLOT) if opened.flown is not None
        }
        self._sources: dict[int, set[str]] = {}
        for action in log.messages(topics.ACTION):
            self._sources.setdefault(action.slot, set()).add(action.source)
        self._taken_s: dict[int, float] = {}
        self._before_s = float("-inf")

    def against(self, setpoint: Setpoint) -> Iterator[str]:
        """What is wrong with the next one."""
        if setpoint.time_s < self._before_s:
            yield "it was sent before the one before it"
        self._before_s = setpoint.time_s
        if bool(setpoint.reasons) == (setpoint.velocity_enu == setpoint.wanted_enu):
            yield (
                "it is not what was wanted, without a reason"
                if not setpoint.reasons
                else ("it is just what was wanted, and clipped")
            )
        if setpoint.slot is not None:
            yield from self._against_slot(setpoint.slot, setpoint.time_s, "it")
        if (setpoint.action_slot is None) != (setpoint.action_age_s is None):
            yield "it has an action without an age, or an age without an action"
        elif setpoint.action_slot is not None and setpoint.action_age_s is not None:
            yield from self._against_action(setpoint, setpoint.action_slot, setpoint.time_s - setpoint.action_age_s)

    def _against_slot(self, slot: int, time_s: float, what: str) -> Iterator[str]:
        if slot in self._opened_s:
            if time_s < self._opened_s[slot] - ROUNDING_S:
                yield f"{what} came before slot {slot} opened"
        elif self._whole:
            yield f"slot {slot} never opened"

    def _against_action(self, setpoint: Setpoint, slot: int, taken_s: float) -> Iterator[str]:
        if setpoint.slot is not None and setpoint.slot not in (slot, slot + 1):
            yield f"the action of slot {slot} is flown in slot {setpoint.slot}"
        if slot in self._sources:
            if setpoint.source not in self._sources[slot]:
                yield f"the action of slot {slot} came from {', '.join(self._sources[slot])}, not {setpoint.source}"
        elif self._whole:
            yield f"there was no action of slot {slot}"
        yield from self._against_slot(slot, taken_s, "its action")
        if abs(self._taken_s.setdefault(slot, taken_s) - taken_s) > ROUNDING_S:
            yield f"the action of slot {slot} came at {self._taken_s[slot]:.3f} s and at {taken_s:.3f} s"
        outcome = self._outcomes.get(slot)
        if outcome is not None and outcome not in ("flown", "clipped"):
            yield f"the action of slot {slot} is flown, and {outcome}"


def _told(witness: _Witness, sent: list[Setpoint]) -> Iterator[str]:
    """Each kind of contradiction once, with the first setpoint and how many there are."""
    first: dict[str, float] = {}
    count: Counter[str] = Counter()
    for setpoint in sent:
        for wrong in witness.against(setpoint):
            first.setdefault(wrong, setpoint.time_s)
            count[wrong] += 1
    for wrong, number in count.items():
        more = "" if number == 1 else f" (so are {number - 1} more)"
        yield f"setpoint at {first[wrong]:.2f} s: {wrong}{more}"


def _unread(number: int) -> list[str]:
    return [f"setpoints that cannot be read: {number}"] if number else []


def _stops(event: MissionEvent) -> bool:
    """Whether no setpoints are meant to come after it."""
    if event.kind == "ladder":
        _, _, rung = event.text.partition(":")[0].rpartition("-> ")
        return rung.strip() not in STREAMING_RUNGS
    return event.kind in ("mode", "failsafe") or (event.kind == "phase" and event.text in NOT_STREAMING)
