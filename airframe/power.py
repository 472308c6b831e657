"""Propulsion power of a rotary-wing vehicle that carries a panel (paper eq. 15-19).

One formula serves floats, torch tensors (leading batch dimensions broadcast) and `numba.njit(power_terms)`: only plain
arithmetic, `abs` and `x ** 0.5`. Velocities are those relative to the air; without wind they are the ground velocity.
"""

from typing import TYPE_CHECKING, Generic, Literal, NamedTuple, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

Real = TypeVar("Real", float, "Tensor")

Induced = Literal["sqrt", "paper", "zeng"]
Climb = Literal["nonnegative", "signed"]
VPerp = Literal["normal", "speed"]
RisArea = Literal["paper", "full"]


def hover_induced_velocity(weight_n: float, air_density: float, disc_area_m2: float) -> float:
    """Mean induced velocity of the rotors in hover by momentum theory, sqrt(W / (2 rho A)) [m/s]."""
    return float((weight_n / (2.0 * air_density * disc_area_m2)) ** 0.5)


class RotaryWing(NamedTuple):
    """A rotary wing and how its power is read; the defaults are the paper's table with W = 25 N."""

    weight_n: float = 25.0
    air_density: float = 1.225
    """rho [kg/m^3]."""
    disc_area_m2: float = 0.503
    """A, all rotors together."""
    solidity: float = 0.05
    tip_speed_mps: float = 120.0
    """r Omega."""
    profile_drag: float = 0.012
    """delta."""
    fuselage_drag_ratio: float = 0.6
    """d0."""
    induced_velocity_mps: float = hover_induced_velocity(25.0, 1.225, 0.503)
    """v_i; the paper prints 4.028, which belongs to W = 20 N."""
    induced_correction: float = 0.1
    """k, used by `induced == "zeng"` only."""
    induced: Induced = "sqrt"
    """`sqrt`: eq. 16b with both its roots; `paper`: as printed; `zeng`: `sqrt` times 1 + k."""
    climb: Climb = "nonnegative"
    """`nonnegative`: a descent gives no power back; `signed`: eq. 16c as printed."""


class Panel(NamedTuple):
    """A flat plate carried upright (its normal is horizontal)."""

    area_m2: float = 0.0
    drag_coefficient: float = 2.1
    v_perp: VPerp = "normal"
    """`normal`: the velocity component along the panel's normal; `speed`: the whole horizontal speed."""


NO_PANEL = Panel()

ZENG_2019 = RotaryWing(weight_n=20.0, induced_velocity_mps=hover_induced_velocity(20.0, 1.225, 0.503), induced="zeng")
"""Zeng, Xu, Zhang, "Energy Minimization for Wireless Communication with Rotary-Wing UAV", 2019, table I."""


class PowerTerms(NamedTuple, Generic[Real]):
    """The summands of eq. 15 and 19 [W]: floats, or tensors of the velocities' shape."""

    blade: Real
    induced: Real
    parasite: Real
    climb: Real
    panel_drag: Real


def panel_area_m2(rows: int, columns: int, spacing_m: float, ris_area: RisArea = "paper") -> float:
    """Area of a panel of rows x columns elements [m^2].

    `paper` is eq. 17, (Nx - 1)^2 squares of the element spacing; `full` counts one square for each element.
    """
    if ris_area == "paper":
        return (rows - 1) * (columns - 1) * spacing_m**2
    return rows * columns * spacing_m**2


def power_terms(
    wing: RotaryWing,
    panel: Panel,
    velocity_x: Real,
    velocity_y: Real,
    velocity_z: Real,
    normal_x: Real | float,
    normal_y: Real | float,
) -> PowerTerms[Real]:
    """The summands of the total power [W] at a velocity [m/s] (z up), for a panel with a horizontal unit normal.

    V of eq. 16 is the horizontal speed, as in the model's source (Zeng 2019); vertical motion costs the climb power.
    Arguments are floats or broadcastable tensors; the function calls no other, so that `numba.njit` compiles it as is.
    """
    V_squared = velocity_x * velocity_x + velocity_y * velocity_y

    hover_blade = wing.air_density * wing.profile_drag * wing.disc_area_m2 * wing.solidity * wing.tip_speed_mps**3 / 8.0
    blade = hover_blade + (3.0 * hover_blade / wing.tip_speed_mps**2) * V_squared

    # sqrt(1 + a^2) - a is 1 / (sqrt(1 + a^2) + a): the difference cancels at high speed, float32 would go negative.
    a = V_squared * (0.5 / wing.induced_velocity_mps**2)
    inverse_correction = (1.0 + a * a) ** 0.5 + a
    disc_loading = 2.0 * wing.air_density * wing.disc_area_m2
    if wing.induced == "paper":
        induced = wing.weight_n**1.5 / disc_loading * inverse_correction**-1.0
    elif wing.induced == "zeng":
        hover_induced = (1.0 + wing.induced_correction) * wing.weight_n**1.5 / disc_loading**0.5
        induced = hover_induced * inverse_correction**-0.5
    else:
        induced = wing.weight_n**1.5 / disc_loading**0.5 * inverse_correction**-0.5

    fuselage = 0.5 * wing.air_density * wing.solidity * wing.disc_area_m2 * wing.fuselage_drag_ratio
    parasite = fuselage * V_squared**1.5

    if wing.climb == "nonnegative":
        climb = 0.5 * wing.weight_n * (velocity_z + abs(velocity_z))
    else:
        climb = wing.weight_n * velocity_z

    cubed = abs(velocity_x * normal_x + velocity_y * normal_y) ** 3 if panel.v_perp == "normal" else V_squared**1.5
    panel_drag = 0.5 * wing.air_density * panel.area_m2 * panel.drag_coefficient * cubed

    return PowerTerms(blade, induced, parasite, climb, panel_drag)


def total_power(
    wing: RotaryWing,
    panel: Panel,
    velocity_x: Real,
    velocity_y: Real,
    velocity_z: Real,
    normal_x: Real | float,
    normal_y: Real | float,
) -> Real:
    """Sum of `power_terms` (eq. 19) [W]; under numba compile `power_terms` and sum its fields."""
    terms = power_terms(wing, panel, velocity_x, velocity_y, velocity_z, normal_x, normal_y)
    return terms.blade + terms.induced + terms.parasite + terms.climb + terms.panel_drag


def drag_force(
    wing: RotaryWing,
    panel: Panel,
    velocity_x: Real,
    velocity_y: Real,
    normal_x: Real | float,
    normal_y: Real | float,
) -> tuple[Real, Real]:
    """Horizontal force [N] that holds a velocity through the air [m/s]: the powers of eq. 16c and 18 over speed.

    In still air a vehicle at constant velocity leans by this force against its weight.
    """
    V = (velocity_x * velocity_x + velocity_y * velocity_y + 1e-12) ** 0.5  # differentiable at rest
    fuselage = 0.5 * wing.air_density * wing.solidity * wing.disc_area_m2 * wing.fuselage_drag_ratio * V
    plate = 0.5 * wing.air_density * panel.area_m2 * panel.drag_coefficient
    if panel.v_perp == "speed":
        return (fuselage + plate * V) * velocity_x, (fuselage + plate * V) * velocity_y
    across = velocity_x * normal_x + velocity_y * normal_y
    push = plate * abs(across) * across
    return fuselage * velocity_x + push * normal_x, fuselage * velocity_y + push * normal_y


def hover_power(wing: RotaryWing) -> float:
    """P_hover [W]: 192.5 for the paper's wing with the roots of eq. 16b in place."""
    return float(total_power(wing, NO_PANEL, 0.0, 0.0, 0.0, 1.0, 0.0))
