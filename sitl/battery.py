"""The battery: drained by the paper's propulsion power, voltage falling with its charge."""

from airframe.power import NO_PANEL, RotaryWing, total_power
from sitl.parameters import Parameters

WING = RotaryWing()


class Battery:
    """Energy left, from full; capacity and cell voltages are BAT1_* parameters."""

    def __init__(self) -> None:
        self.used_j = 0.0
        self.power_w = 0.0

    def capacity_j(self, p: Parameters) -> float:
        """BAT1_CAPACITY [mAh] at the mean of the full and the empty voltage."""
        volts = p["BAT1_N_CELLS"] * 0.5 * (p["BAT1_V_CHARGED"] + p["BAT1_V_EMPTY"])
        return p["BAT1_CAPACITY"] * 3.6 * volts

    def remaining(self, p: Parameters) -> float:
        """Share of the capacity left, 0 to 1."""
        return max(0.0, 1.0 - self.used_j / self.capacity_j(p))

    def voltage(self, p: Parameters) -> float:
        """[V], linear in the charge."""
        empty, full = p["BAT1_V_EMPTY"], p["BAT1_V_CHARGED"]
        return p["BAT1_N_CELLS"] * (empty + (full - empty) * self.remaining(p))

    def drain(self, north: float, east: float, down: float, flying: bool, dt: float) -> None:
        """Draw the power of this velocity [m/s] for dt [s]; nothing while the motors stand."""
        self.power_w = max(0.0, total_power(WING, NO_PANEL, east, north, -down, 1.0, 0.0)) if flying else 0.0
        self.used_j += self.power_w * dt
