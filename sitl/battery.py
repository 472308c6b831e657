"""The battery: drained by the paper's propulsion power, voltage falling with its charge."""

from dataclasses import dataclass

from airframe.power import NO_PANEL, RotaryWing, total_power

WING = RotaryWing()


@dataclass(frozen=True)
class Pack:
    """What a battery is made of, and when it counts as low."""

    cells: int
    capacity_mah: float
    full_v: float
    """Of one cell [V]."""
    empty_v: float
    thresholds: tuple[float, float, float]
    """Remaining share below which it is low, critical, and an emergency."""

    @property
    def capacity_j(self) -> float:
        """The charge at the mean of the full and the empty voltage."""
        return self.capacity_mah * 3.6 * self.cells * 0.5 * (self.full_v + self.empty_v)


class Battery:
    """Energy left, from full."""

    def __init__(self, pack: Pack) -> None:
        self.pack = pack
        self.used_j = 0.0
        self.power_w = 0.0

    @property
    def remaining(self) -> float:
        """Share of the capacity left, 0 to 1."""
        return max(0.0, 1.0 - self.used_j / self.pack.capacity_j)

    @property
    def voltage(self) -> float:
        """[V], linear in the charge."""
        pack = self.pack
        return pack.cells * (pack.empty_v + (pack.full_v - pack.empty_v) * self.remaining)

    @property
    def level(self) -> int:
        """0 well, 1 low, 2 critical, 3 emergency."""
        remaining = self.remaining
        return sum(remaining < threshold for threshold in self.pack.thresholds)

    def drain(self, north: float, east: float, down: float, flying: bool, dt: float) -> None:
        """Draw the power of this velocity [m/s] for dt [s]; nothing while the motors stand."""
        self.power_w = max(0.0, total_power(WING, NO_PANEL, east, north, -down, 1.0, 0.0)) if flying else 0.0
        self.used_j += self.power_w * dt
