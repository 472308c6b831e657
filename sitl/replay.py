"""Fly a recorded flight again: what was sent to a real vehicle, frame by frame and at the same vehicle times."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from sitl.autopilot import TICK_MS, Autopilot
from sitl.links.frames import Frame, split
from sitl.links.link import Link
from sitl.links.network import Network
from sitl.links.signing import Signing
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import Personality
from sitl.recording import Motion, Stamped, motion

RATES_HZ = {"HEARTBEAT": 100.0, "EXTENDED_SYS_STATE": 100.0, "ATTITUDE": 20.0}
"""Events often enough to see a change in the tick in which it happens."""


class Tape:
    """A port without a socket: plays frames in, keeps what the vehicle says."""

    def __init__(self, signing: Signing) -> None:
        self.name = "tape"
        self.counters: Counter[str] = Counter()
        self.said: list[Stamped] = []
        self.now_ms = 0
        self._waiting: list[Frame] = []
        self.links = [Link("tape", RATES_HZ, 1, signing, self._put)]

    def play(self, frame: Frame) -> None:
        self._waiting.append(frame)

    def _put(self, raw: bytes) -> bool:
        self.said += (Stamped(self.now_ms / 1000.0, one) for one in split(raw, self.counters)[0])
        return True

    def receive(self, now_ms: int) -> Iterable[tuple[Link, Frame]]:
        link = self.links[0]
        link.heard = True
        waiting, self._waiting = self._waiting, []
        return [(link, frame) for frame in waiting]

    def lost(self) -> dict[Link | None, int]:
        return {}

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


def replay(
    recorded: list[Stamped],
    personality: Personality,
    client: int,
    origin: Origin,
    yaw: float = 0.0,
    placed_at_s: Sequence[float] = (),
) -> tuple[Motion, list[Stamped]]:
    """How a simulated vehicle moves under what `client` sent, on vehicle time, and what it says.

    It boots as the recorded one did and stands with a heading `yaw` [rad]. At the times `placed_at_s` it is put where
    the recorded one was, so that what follows is judged by itself and not by what drift came before.
    """
    signing = Signing()
    tape = Tape(signing)
    autopilot = Autopilot(personality, Parameters(personality.table), origin, Network((tape,), 1, signing), 0, 0)
    body = autopilot.vehicle.body
    body.attitude[:] = (np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw))
    times, velocity, position = [], [], []
    truth = motion(recorded)
    places = sorted(placed_at_s, reverse=True)

    def advance(until_ms: int) -> None:
        while autopilot.now_ms < until_ms:
            tick = min(TICK_MS - autopilot.now_ms % TICK_MS, until_ms - autopilot.now_ms)
            tape.now_ms = autopilot.now_ms + tick
            autopilot.advance(tick)
            times.append(autopilot.now_ms / 1000.0)
            velocity.append(body.velocity.copy())
            position.append(body.position.copy())

    for time_s, frame in recorded:
        advance(round(time_s * 1000.0))
        while places and time_s >= places[-1]:
            body.position[:] = truth.at(np.array([places.pop()])).position[0]
        if frame.system == client:
            tape.play(frame)
            autopilot.receive()
    return Motion(np.array(times), np.array(velocity), np.array(position)), tape.said
