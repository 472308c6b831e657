"""The conformance kit's wire to an autopilot in this process: real UDP, and the vehicle moves only while the kit waits.

So a whole run takes seconds, and does not depend on how busy the machine is.
"""

from collections.abc import Callable, Iterable

from sitl.arducopter.personality import ARDUCOPTER
from sitl.conformance.wire import split
from sitl.px4.personality import PX4
from tests.sitl.client import Direct

STEP_MS = 20
PERSONALITIES = {"px4": PX4, "arducopter": ARDUCOPTER}

Tamper = Callable[[bytes], Iterable[bytes]]
"""What becomes of a frame on its way."""


def untouched(frame: bytes) -> Iterable[bytes]:
    return (frame,)


class SteppedWire:
    """`outward` is done to frames of the kit, `inward` to those of the vehicle."""

    def __init__(self, personality: str, outward: Tamper = untouched, inward: Tamper = untouched, **parameters) -> None:
        # The kit asks for what it looks at: what else a PX4 sends would only take time here.
        self.direct = Direct({"HEARTBEAT": 1.0}, 0, PERSONALITIES[personality], **parameters)
        self._outward, self._inward = outward, inward

    def clock(self) -> float:
        """The wall clock of a world in which the vehicle is exactly as fast as real time [s]."""
        return self.direct.time_ms / 1000.0

    def send(self, frame: bytes) -> None:
        for passed in self._outward(frame):
            self.direct.udp.sendto(passed, self.direct.to)

    def receive(self, timeout_s: float) -> list[bytes]:
        frames = self._waiting()
        if not frames:
            self.direct.step(STEP_MS)
            frames = self._waiting()
        return [passed for frame in frames for passed in self._inward(frame)]

    def _waiting(self) -> list[bytes]:
        frames: list[bytes] = []
        while True:
            try:
                frames += split(self.direct.udp.recv(65535))[0]
            except BlockingIOError:
                return frames

    def close(self) -> None:
        self.direct.close()
