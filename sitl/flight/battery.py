"""The battery: drained by the paper's propulsion power; an ideal source, or cells that sag under load.

Ideal (no resistance): the voltage is linear in the charge, which is counted as energy at the mean voltage. Cell model:
an open-circuit voltage by charge and a resistance in series; the charge is counted by the current that the power takes.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from airframe.power import NO_PANEL, Panel, RotaryWing, total_power
from sitl.flight.physics import Body, heading

WING = RotaryWing()

LIPO = (
    (0.0, 0.0),
    (0.05, 0.21),
    (0.1, 0.34),
    (0.2, 0.44),
    (0.4, 0.54),
    (0.6, 0.63),
    (0.8, 0.8),
    (0.9, 0.9),
    (1.0, 1.0),
)
"""Charge -> open-circuit voltage of a lithium-polymer cell, each as a share of the way from empty to full."""


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
    cell_ohm: float = 0.0
    """Internal resistance of one cell; 0: an ideal source."""
    lasting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The like of `thresholds`, of a charge that has been less for `patience_s`."""
    patience_s: float = 0.0

    @property
    def capacity_j(self) -> float:
        """The charge at the mean of the full and the empty voltage."""
        return self.capacity_mah * 3.6 * self.cells * 0.5 * (self.full_v + self.empty_v)

    def open_circuit_v(self, remaining: float) -> float:
        """Voltage without load at a remaining charge, 0 to 1."""
        share = remaining if self.cell_ohm == 0.0 else interpolated(remaining)
        return self.cells * (self.empty_v + (self.full_v - self.empty_v) * share)

    def current_a(self, remaining: float, power_w: float) -> float:
        """The current that a power takes at the terminals: P = (V0 - R I) I; at most the one of greatest power."""
        open_v = self.open_circuit_v(remaining)
        if self.cell_ohm == 0.0:
            return power_w / open_v
        ohm = self.cells * self.cell_ohm
        return (open_v - math.sqrt(max(open_v * open_v - 4.0 * ohm * power_w, 0.0))) / (2.0 * ohm)


def interpolated(remaining: float) -> float:
    """The LIPO curve between its points."""
    for (x0, y0), (x1, y1) in pairwise(LIPO):
        if remaining <= x1:
            return y0 + (y1 - y0) * (remaining - x0) / (x1 - x0)
    return 1.0


class Battery:
    """Charge left, from full."""

    def __init__(self, pack: Pack) -> None:
        self.pack = pack
        self.used = 0.0
        """Share of the charge used."""
        self.used_j = 0.0
        """Energy that left the terminals."""
        self.power_w = 0.0
        self._below_s = [0.0, 0.0, 0.0]
        """How long it has been below each of the lasting thresholds."""

    @property
    def remaining(self) -> float:
        """Share of the charge left, 0 to 1."""
        return max(0.0, 1.0 - self.used)

    @property
    def current_a(self) -> float:
        return self.pack.current_a(self.remaining, self.power_w)

    @property
    def voltage(self) -> float:
        """At the terminals, under the load of this moment [V]."""
        pack, remaining = self.pack, self.remaining
        open_v = pack.open_circuit_v(remaining)
        return open_v - pack.cells * pack.cell_ohm * self.current_a if pack.cell_ohm else open_v

    @property
    def level(self) -> int:
        """0 well, 1 low, 2 critical, 3 emergency."""
        remaining = self.remaining
        for level in (3, 2, 1):
            below_s = self._below_s[level - 1]
            if remaining < self.pack.thresholds[level - 1] or 0.0 < self.pack.patience_s <= below_s:
                return level
        return 0

    def leave(self, remaining: float) -> None:
        """Let so much charge be left, 0 to 1."""
        self.used = 1.0 - remaining

    def drain(self, power_w: float, dt: float) -> None:
        """Draw a power for dt [s]."""
        self.power_w = power_w
        self.used_j += power_w * dt
        if self.pack.cell_ohm:
            self.used += self.current_a * dt / (self.pack.capacity_mah * 3.6)
        else:
            self.used += power_w * dt / self.pack.capacity_j
        if not self.pack.patience_s:
            return
        for i, threshold in enumerate(self.pack.lasting):
            self._below_s[i] = self._below_s[i] + dt if self.remaining < threshold else 0.0


def propulsion_power(body: Body, panel: Panel) -> float:
    """What flying as the body does takes [W], paper eq. 15 to 19, by the velocity through the air."""
    vn, ve, vd = body.velocity.tolist()
    wn, we, wd = body.air.tolist()
    if panel.area_m2 == 0.0:
        return max(0.0, float(total_power(WING, NO_PANEL, ve - we, vn - wn, wd - vd, 1.0, 0.0)))
    yaw = heading(body.attitude)
    return max(0.0, float(total_power(WING, panel, ve - we, vn - wn, wd - vd, math.sin(yaw), math.cos(yaw))))
