"""Vehicles that react and brake differently keep apart too, since each tells its own stop; ideal ones, head on."""

import itertools

import numpy as np
import pytest

from autopilot_bridge.config import Limits
from autopilot_bridge.envelope import Envelope
from autopilot_bridge.fence import Box
from autopilot_bridge.separation import Track

SEPARATION_M, STEP_S, AGE_S, SPEED_MPS = 5.0, 0.05, 0.17, 10.0
EVERYWHERE = Box(x=(-300, 300), y=(-300, 300), z=(-10, 100))


class Flyer:
    """Brakes at `acceleration_mps2` at most, and does what it is told `reaction_s` later."""

    def __init__(self, east_m, reaction_s, acceleration_mps2):
        limits = Limits(horizontal_mps=SPEED_MPS, acceleration_mps2=acceleration_mps2)
        self.envelope = Envelope(limits, EVERYWHERE, reaction_s, STEP_S, lambda *_: None, separation_m=SEPARATION_M)
        self.change_mps = acceleration_mps2 * STEP_S
        self.position, self.velocity = np.array([east_m, 0.0, 50.0]), np.zeros(3)
        self.told = [np.zeros(3)] * round((reaction_s - 0.1) / STEP_S)
        self.seen = []

    def look(self):
        self.seen.append((self.position, self.velocity))

    def as_seen(self):
        """By the other: old news, carried on."""
        position, velocity = self.seen[-min(round(AGE_S / STEP_S) + 1, len(self.seen))]
        carried = position + velocity * AGE_S
        return Track(carried, velocity, AGE_S, self.envelope.stop(carried, velocity))

    def fly(self, wanted_mps, other):
        wanted = np.array([wanted_mps, 0.0, 0.0])
        self.told.append(self.envelope.clip(wanted, self.position, self.velocity, [other]).velocity)
        change = self.told.pop(0) - self.velocity
        after = self.velocity + change * min(1.0, self.change_mps / max(float(np.linalg.norm(change)), 1e-9))
        self.position, self.velocity = self.position + (self.velocity + after) / 2 * STEP_S, after


@pytest.mark.parametrize(
    ("one", "other"), [((0.5, 3.0), (1.2, 2.5)), ((0.5, 5.0), (1.2, 2.5)), ((0.5, 3.0), (0.5, 1.0))]
)
def test_unlike_vehicles_head_on_keep_apart(one, other):
    for asked, theirs, from_s in itertools.product((5.0, 10.0), (5.0, 10.0), (0.0, 6.0, 9.0)):
        left, right, nearest_m = Flyer(0.0, *one), Flyer(120.0, *other), 120.0
        for step in range(600):
            left.look()
            right.look()
            seen = left.as_seen(), right.as_seen()
            left.fly(asked if step * STEP_S >= from_s else 0.0, seen[1])
            right.fly(-theirs, seen[0])
            nearest_m = min(nearest_m, float(np.linalg.norm(left.position - right.position)))
        assert nearest_m > SEPARATION_M, (asked, theirs, from_s)
