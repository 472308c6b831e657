"""The world outside the autopilot, by parameters of our own (SITL_*), the same for every personality.

No real autopilot has these names. All are off by default, but for the noise of the raw sensor messages.
"""

from typing import NamedTuple

from sitl.flight.physics import Rotorcraft
from sitl.flight.wind import Wind
from sitl.parameters import REAL32, Parameter, Parameters

AIR_DENSITY = 1.225
"""[kg/m3], as in `airframe.power`."""


def _real(name: str, default: float, low: float, high: float) -> Parameter:
    return Parameter(name, default, low, high, REAL32)


OWN = (
    _real("SITL_BAT_R", 0.0, 0.0, 0.1),  # [ohm] of one cell; above 0: the cell model
    _real("SITL_EST_ERR", 0.0, 0.0, 20.0),  # [m] standard deviation of the estimated position; read at start
    _real("SITL_GUST_W20", 0.0, 0.0, 30.0),  # [m/s] Dryden gusts of this wind at 20 ft
    _real("SITL_KDQ", 0.0, 0.0, 10.0),  # [N/(m/s)2] quadratic drag
    _real("SITL_NOISE", 1.0, 0.0, 100.0),  # times the noise of GPS_RAW_INT and the IMU messages; 0 = off
    _real("SITL_PANEL_AREA", 0.0, 0.0, 10.0),  # [m2] of a flat panel across the body's x axis
    _real("SITL_PANEL_CD", 2.1, 0.0, 10.0),  # its drag coefficient
    _real("SITL_WIND_D", 0.0, -10.0, 10.0),  # [m/s] mean wind, towards where it blows
    _real("SITL_WIND_E", 0.0, -30.0, 30.0),
    _real("SITL_WIND_N", 0.0, -30.0, 30.0),
)


class World(NamedTuple):
    """What surrounds the vehicle and how well it sees it."""

    wind: Wind = Wind()
    noise: float = 1.0
    """Times the usual noise of the raw sensor messages."""
    estimator_error_m: float = 0.0
    panel_area_m2: float = 0.0
    panel_drag_coefficient: float = 0.0
    gps_fix: bool = True
    """Whether the parameters let the receiver have a fix."""
    dead_reckoning_s: float = 5.0
    """How long a position is believed without GPS."""


def world(p: Parameters, dead_reckoning_s: float, gps_fix: bool = True) -> World:
    """The world of the SITL_* parameters."""
    return World(
        wind=Wind((p["SITL_WIND_N"], p["SITL_WIND_E"], p["SITL_WIND_D"]), p["SITL_GUST_W20"]),
        noise=p["SITL_NOISE"],
        estimator_error_m=p["SITL_EST_ERR"],
        panel_area_m2=p["SITL_PANEL_AREA"],
        panel_drag_coefficient=p["SITL_PANEL_CD"],
        gps_fix=gps_fix,
        dead_reckoning_s=dead_reckoning_s,
    )


def in_the_air(craft: Rotorcraft, p: Parameters) -> Rotorcraft:
    """A craft with the drag of the SITL_* parameters on top of its own."""
    panel = 0.5 * AIR_DENSITY * p["SITL_PANEL_AREA"] * p["SITL_PANEL_CD"]
    return craft._replace(drag_quadratic=craft.drag_quadratic + p["SITL_KDQ"], panel=panel)
