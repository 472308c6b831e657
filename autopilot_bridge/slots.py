"""The slot clock and its books: what each slot was asked to do, what was planned, what was flown.

Pure: vehicle time, position and velocity come in, messages and references go out. One slot at a time is open, from
t_k = t_0 + k * slot_s to t_{k+1}.
"""

from dataclasses import dataclass

import numpy as np

from airframe.slot_profile import Reference, Vector, brake
from autopilot_bridge.config import BridgeConfig, Limits
from autopilot_bridge.plan import plan_slot
from bus.messages import Action, FlownSlot, SlotOpened, SlotOutcome, TrackSample, Vec3

SAMPLE_S = 0.1
"""The track's sampling."""
LENGTH_TOLERANCE = 1e-5
"""Relative; an action computed in float32 may be this much longer than it should."""
REACH = "acceleration"
"""The one reason that is no clipping: how far a multicopter gets in a slot, told by planned against commanded."""
LEFT_BEHIND_M = 2.0
"""A vehicle that the envelope holds back so far from its plan does not chase it: the next plan begins where it is."""


@dataclass(frozen=True)
class Order:
    """The action that is being flown: whose, for which slot, and since when [s of vehicle time]."""

    source: str
    slot: int
    taken_s: float


class Slots:
    """All slots of a flight. `start_s` is t_0; the reference starts at rest in `position`."""

    def __init__(self, config: BridgeConfig, limits: Limits, start_s: float, position: Vector) -> None:
        self.number = -1
        """The open slot; -1 before the first, `config.slots` after the last."""
        self.outcome: SlotOutcome | None = None
        """What became of the open slot's action; None while it is awaited."""
        self.order: Order | None = None
        """The action whose profile is flown, up to the next one's coming; None in a hold."""
        self._config, self._limits, self._start_s = config, limits, start_s
        self._profile, self._since_s = brake(position, np.zeros(3), limits.agility), start_s
        self._opening: Reference = self._profile.at(0.0)
        self._opened_at: Vector = position
        self._reasons: list[str] = []
        self._held_back = False
        """Whether the envelope has changed setpoints of the open slot."""
        self._commanded: Vector = np.zeros(3)
        self._track: list[TrackSample] = []
        self._plan: list[TrackSample] = []

    @property
    def closed(self) -> bool:
        """Whether all slots are over."""
        return self.number >= self._config.slots

    @property
    def awaiting(self) -> bool:
        """Whether the open slot's action has yet to come."""
        return self.number >= 0 and not self.closed and self.outcome is None

    @property
    def decided(self) -> bool:
        """Whether it is known what the open slot flies."""
        return not self.closed and self.outcome is not None

    @property
    def acting(self) -> bool:
        """Whether the open slot's action is being flown."""
        return self.outcome in ("flown", "clipped")

    @property
    def opening_s(self) -> float:
        """Vehicle time of the open slot's opening."""
        return self._start_s + self.number * self._config.slot_s

    def due(self, time_s: float) -> bool:
        """Whether it is time to `open` the next slot."""
        return not self.closed and time_s >= self.opening_s + self._config.slot_s - 1e-6

    def open(self, position: Vector, velocity: Vector, attitude_rad: Vec3) -> SlotOpened:
        """Close the open slot and open the next one (after the last: a closing one).

        The plan goes on from its own end, so that tracking errors never leak into it, unless the envelope has held the
        vehicle back: then it would run away, and the vehicle, once free, after it.
        """
        closing_s = self.opening_s + self._config.slot_s
        flown = self._close(position, closing_s) if self.number >= 0 else None
        if self._held_back and np.linalg.norm(self.reference(closing_s).position - position) > LEFT_BEHIND_M:
            self.restart(closing_s, position, velocity)
        self.number, self._held_back = self.number + 1, False
        self._opening, self._opened_at = self.reference(closing_s), position
        self.outcome, self._reasons, self._commanded = None, [], np.zeros(3)
        self._track, self._plan = [], []
        return SlotOpened(
            slot=self.number,
            slots=self._config.slots,
            time_s=closing_s,
            position_enu=vec3(position),
            velocity_enu=vec3(velocity),
            attitude_rad=attitude_rad,
            closing=self.closed,
            flown=flown,
        )

    def act(self, action: Action, time_s: float, held_because: str | None = None) -> bool:
        """Take the agent's decision at vehicle time `time_s`; whether it is a good one that came in time.

        One that is not for the open slot, or a second one, changes nothing; one that comes after the hold began is
        `late`. `held_because`: it is good, but is not to be flown, for this reason.
        """
        if action.slot != self.number or self.closed:
            return False
        if self.outcome == "missing":
            self.outcome = "late"
        if not self.awaiting:
            return False
        wanted = np.array(action.displacement_enu)
        length, longest = float(np.linalg.norm(wanted)), self._config.v_max_mps * self._config.slot_s
        if length > longest * (1 + LENGTH_TOLERANCE):
            self.hold(time_s, "rejected", f"displacement: {length:.3f} m, at most {longest:g} m is allowed")
            return False
        if held_because is not None:
            self.hold(time_s, "rejected", held_because)
            return True
        planned = plan_slot(
            self._opening.position,
            self._opening.velocity,
            wanted,
            self._config.slot_s,
            self._limits,
            self._config.box,
            self._config.deadline_s,
            self._opening.acceleration,
        )
        self._profile, self._since_s = planned.profile, self.opening_s
        self._commanded, self._reasons = wanted, list(planned.reasons)
        self.order = Order(action.source, action.slot, time_s)
        self.outcome = "flown" if set(planned.reasons) <= {REACH} else "clipped"
        return True

    def hold(self, time_s: float, outcome: SlotOutcome, reason: str) -> None:
        """Begin the planned hold at `time_s`: the open slot has no action to fly."""
        self.outcome, self._reasons, self.order = outcome, [reason], None
        now = self.reference(time_s)
        self._profile, self._since_s = brake(now.position, now.velocity, self._limits.agility, now.acceleration), time_s

    def restart(self, time_s: float, position: Vector, velocity: Vector) -> None:
        """The vehicle was not ours to fly: the reference goes on, braking, from where it really is."""
        self._profile, self._since_s = brake(position, velocity, self._limits.agility), time_s
        self.order = None

    def clipped(self, reason: str) -> None:
        """The envelope changed a setpoint of the open slot."""
        self._held_back = True
        if self.outcome == "flown":
            self.outcome = "clipped"
        if reason not in self._reasons:
            self._reasons.append(reason)

    def sample(self, time_s: float, position: Vector, velocity: Vector) -> None:
        """Offer a point of the flown track; one per 0.1 s since the opening is kept."""
        if self.number >= 0 and not self.closed and time_s >= self.opening_s + len(self._track) * SAMPLE_S - 1e-6:
            self._track.append(track_sample(time_s, position, velocity))
            reference = self.reference(time_s)
            self._plan.append(track_sample(time_s, reference.position, reference.velocity))

    def reference(self, time_s: float) -> Reference:
        """What the vehicle should be doing at vehicle time `time_s`."""
        return self._profile.at(time_s - self._since_s)

    def _close(self, position: Vector, time_s: float) -> FlownSlot:
        return FlownSlot(
            slot=self.number,
            outcome=self.outcome or "missing",
            reasons=self._reasons,
            commanded_enu=vec3(self._commanded),
            planned_enu=vec3(self.reference(time_s).position - self._opening.position),
            flown_enu=vec3(position - self._opened_at),
            track=self._track,
            plan=self._plan,
        )


def vec3(vector: Vector) -> Vec3:
    """For a message."""
    x, y, z = vector.tolist()
    return x, y, z


def track_sample(time_s: float, position: Vector, velocity: Vector) -> TrackSample:
    """One point of a track."""
    return TrackSample(time_s=time_s, position_enu=vec3(position), velocity_enu=vec3(velocity))
