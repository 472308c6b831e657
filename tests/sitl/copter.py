"""A client that flies the ArduCopter personality in this process, as `tests.sitl.client.Direct` flies PX4."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sitl.arducopter.personality import ARDUCOPTER
from tests.sitl.client import Direct

SET_MESSAGE_INTERVAL, ARM, TAKEOFF, DO_SET_MODE = 511, 400, 22, 176
STABILIZE, AUTO, GUIDED, LOITER, RTL, LAND = 0, 3, 4, 5, 6, 9
WATCHED = {
    30: 20.0,  # ATTITUDE
    32: 50.0,  # LOCAL_POSITION_NED
    33: 10.0,  # GLOBAL_POSITION_INT
    85: 20.0,  # POSITION_TARGET_LOCAL_NED
    245: 5.0,  # EXTENDED_SYS_STATE
    1: 2.0,  # SYS_STATUS
    24: 5.0,  # GPS_RAW_INT
    193: 2.0,  # EKF_STATUS_REPORT
}
"""What the recorded flight asked for: message id -> Hz."""


class Copter(Direct):
    """Knows ArduCopter's modes and how to take off."""

    def __init__(self, **parameters: float) -> None:
        super().__init__(ARDUCOPTER.companion_rates_hz, 0, ARDUCOPTER, **parameters)

    @property
    def mode(self) -> int:
        return self.latest["HEARTBEAT"].custom_mode

    def watch(self) -> None:
        """Ask for the messages of the recorded flight."""
        for number, rate in WATCHED.items():
            assert self.command(SET_MESSAGE_INTERVAL, number, 1e6 / rate) == 0

    def boot(self) -> None:
        """Advance until it may arm, in strides."""
        self.until(lambda: "HEARTBEAT" in self.latest, 3)
        self.watch()
        while not self.commander.ready:
            self.advance(500)
            assert self.time_ms < 60_000

    def take_off(self, altitude: float = 10.0) -> None:
        """Boot, GUIDED, arm, take off, and wait until it is there."""
        self.boot()
        assert self.command(DO_SET_MODE, 1, GUIDED) == 0
        assert self.command(ARM, 1) == 0
        assert self.command(TAKEOFF, 0, 0, 0, 0, 0, 0, altitude) == 0
        self.until(lambda: self.landed == 2, 40)
        self.fly(3)

    def stream(self, seconds: float, *velocity: float, **how: float) -> None:
        """Velocity setpoints at 20 Hz."""
        self.fly(seconds, lambda: self.setpoint(*velocity, **how))

    def fastest(self, seconds: float, axis: int, each: Callable[[], None] | None = None) -> float:
        """Advance; the greatest absolute velocity on an axis [m/s]."""
        top = 0.0

        def watch() -> None:
            nonlocal top
            if each is not None:
                each()
            top = max(top, abs(self.velocity[axis]))

        self.fly(seconds, watch)
        return top


@contextmanager
def copter(**parameters: float) -> Iterator[Copter]:
    client = Copter(**parameters)
    try:
        yield client
    finally:
        client.close()
