"""What must be true before a flight, and how fast and how far it may go on this autopilot.

In this order: disarmed, and what an earlier flight left behind put back; the mission's parameters set; the failsafes
that a flight stands on; the autopilot's limits and its own fence. Nothing of this arms.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot_bridge.config import REQUIRED, BridgeConfig, Limits
from autopilot_bridge.dialects import Dialect, Need, OwnFence
from autopilot_bridge.flight_parameters import FlightParameters, Tell
from autopilot_bridge.uploaded_fence import areas, objection
from autopilot_bridge.vehicle import Vehicle, VehicleError

TRACKING_HEADROOM = 1.25
"""A vehicle that is behind its plan may be this much faster than plans are, if the autopilot lets it."""
VERTICAL_SHARE = 0.9
"""Plans use so much of the autopilot's climb and descent rates at most: who is behind has the rest to catch up."""
STREAM_LOSS_MAX_S = 10.0
"""For so long a lost stream may at most fly on; PX4 and ArduCopter take 1 and 3 s by default."""
STREAM_LOSS_MIN_S = 0.25
"""A stream of 20 Hz that has lost four setpoints in a row must not be taken for a lost one."""
KEEP_OFF_M = 2.0
"""Distance from the autopilot's own fence, which is to act only when we have failed."""
GRAVITY = 9.80665


@dataclass(frozen=True)
class Bounds:
    """What plans and setpoints must stay inside of, with the autopilot's limits in them."""

    limits: Limits
    """Of plans."""
    tracking: Limits
    """Of setpoints: plans' with headroom, within the autopilot's."""
    home_distance_m: float | None
    ceiling_m: float
    """Above home; infinity: the fence's alone."""
    battery_reserve: float
    """The share of the pack that is the autopilot's: there it comes down by itself."""


def unbound(config: BridgeConfig) -> Bounds:
    """The mission's own, as long as the autopilot's are not known."""
    return Bounds(config.limits, config.limits, config.home_distance_m, math.inf, 0.0)


def clear(config: BridgeConfig, vehicle: Vehicle, parameters: FlightParameters, tell: Tell) -> Bounds:
    """The bounds to fly in. Raises VehicleError with what forbids the flight, JournalError."""
    if vehicle.telemetry.armed:
        raise VehicleError(
            f"the vehicle is armed already, in mode {vehicle.telemetry.mode_name}: a flight begins disarmed"
        )
    parameters.put_back()
    for name, value in config.parameters.items():
        parameters.set(name, value)
    _own_loss(config, vehicle, parameters)
    _required(config, vehicle)
    altitude = vehicle.dialect.takeoff_altitude
    if altitude is not None:
        parameters.set(altitude, config.takeoff_altitude_m)
    bounds = _bounds(config, vehicle)
    if bounds.limits != config.limits:
        tell("limits", f"planning inside the autopilot's limits: {bounds.limits}")
    return bounds


def _own_loss(config: BridgeConfig, vehicle: Vehicle, parameters: FlightParameters) -> None:
    """What the autopilot does once we are gone: there is one safe answer, so it is set, but not against the mission."""
    if "offboard_loss" in config.allow_without:
        return
    for name, safe in vehicle.dialect.failsafes.items():
        found = vehicle.parameter(name)
        if found in safe:
            continue
        if name in config.parameters:
            raise VehicleError(
                f"offboard_loss is off: parameters.{name} is {found:g}, must be {Need(name, safe).allowed}"
                f"{_way_out('offboard_loss')}"
            )
        parameters.set(name, safe[0], why=", with which a vehicle without its bridge neither lands nor returns")
    name, longest_s = vehicle.dialect.stream_loss
    if name not in config.parameters and vehicle.parameter(name) > longest_s:
        parameters.set(name, longest_s, why=" s, for which the last velocity of a dead link is flown on")
    delay_s = vehicle.parameter(name)
    if delay_s > STREAM_LOSS_MAX_S:
        raise VehicleError(
            f"offboard_loss is late: {name} is {delay_s:g} s, must be {STREAM_LOSS_MAX_S:g} s at most"
            f"{_way_out('offboard_loss')}"
        )
    if delay_s < STREAM_LOSS_MIN_S:
        raise VehicleError(
            f"offboard_loss is hasty: {name} is {delay_s:g} s, must be {STREAM_LOSS_MIN_S:g} s at least"
            f"{_way_out('offboard_loss')}"
        )


def _required(config: BridgeConfig, vehicle: Vehicle) -> None:
    """Failsafes that whoever runs the vehicle chooses. Raises VehicleError for one that is off."""
    for failsafe in dict.fromkeys((*REQUIRED, *config.require)):
        if failsafe in config.allow_without:
            continue
        for need in vehicle.dialect.owners_failsafes.get(failsafe, ()):
            wrong = need.unmet(vehicle.parameter)
            if wrong:
                raise VehicleError(f"{failsafe} is off: {wrong}{_way_out(failsafe)}")


def _way_out(failsafe: str) -> str:
    return f"; set it, or say in the mission that it flies without (allow_without: [{failsafe}])"


def clear_of_uploaded_fence(config: BridgeConfig, vehicle: Vehicle, tell: Tell) -> None:
    """Once home is known: the box, and the way to it, inside the areas uploaded to the autopilot, if they are in force.

    Raises VehicleError.
    """
    fence, home = vehicle.dialect.own_fence(vehicle.parameter), vehicle.telemetry.home_lat_lon_alt
    if not fence.areas or home is None:
        return
    try:
        found = areas(vehicle.uploaded_fence(), home)
    except ValueError as error:
        raise VehicleError(f"the fence uploaded to the autopilot is not understood: {error}") from error
    start = config.start_position_enu[:2]
    wrong = objection(found, fence.any_inclusion, config.box, start, max(KEEP_OFF_M, fence.margin_m))
    if wrong:
        raise VehicleError(f"the fence uploaded to the autopilot: {wrong}")
    if found:
        tell("preflight", f"inside the fence uploaded to the autopilot: {', '.join(map(str, found))}")


def _bounds(config: BridgeConfig, vehicle: Vehicle) -> Bounds:
    dialect = vehicle.dialect
    theirs = {name: _limit(vehicle, limit) * unit for name, (limit, unit) in dialect.limits.items()}
    theirs["acceleration_mps2"] = min(theirs.get("acceleration_mps2", math.inf), _tilted(dialect, vehicle))
    planned = {
        name: most * (VERTICAL_SHARE if name in ("up_mps", "down_mps") else 1.0) for name, most in theirs.items()
    }
    limits = config.limits.within(**planned)
    speeds = ("horizontal_mps", "up_mps", "down_mps")
    headroom = {name: min(getattr(limits, name) * TRACKING_HEADROOM, theirs[name]) for name in speeds}
    fence = dialect.own_fence(vehicle.parameter)
    keep_off_m = max(KEEP_OFF_M, fence.margin_m)
    _require_room(config, dialect, fence, keep_off_m)
    home_m = min(config.home_distance_m or math.inf, fence.radius_m - keep_off_m)
    return Bounds(
        limits=limits,
        tracking=limits.model_copy(update=headroom),
        home_distance_m=None if math.isinf(home_m) else home_m,
        ceiling_m=fence.height_m - keep_off_m,
        battery_reserve=0.0 if config.endurance is None else dialect.battery_acts_at(vehicle.parameter),
    )


def _limit(vehicle: Vehicle, name: str) -> float:
    """A parameter that limits. Raises VehicleError for one with which nothing flies."""
    value = vehicle.parameter(name)
    if value <= 0:
        raise VehicleError(f"{name} is {value:g}: must be more than 0 to fly within it")
    return value


def _tilted(dialect: Dialect, vehicle: Vehicle) -> float:
    """The horizontal acceleration [m/s2] of a hover tilted as far as the autopilot lets it."""
    tilt_deg = dialect.tilt_max_deg(vehicle.parameter)
    if tilt_deg <= 0:
        raise VehicleError(f"the autopilot's tilt limit is {tilt_deg:g} deg: must be more than 0 to fly within it")
    return GRAVITY * math.tan(math.radians(min(tilt_deg, 89.0)))


def _require_room(config: BridgeConfig, dialect: Dialect, fence: OwnFence, keep_off_m: float) -> None:
    """Raises VehicleError when plans could meet the autopilot's own fence."""
    reach_m, (bottom_m, top_m) = float(np.hypot(*config.box.corners.T).max()), config.box.z
    for what, over_m, limit_m, name in zip(
        (
            f"its corners are {reach_m:.1f} m from home",
            f"its top is {top_m:g} m above home",
            f"its bottom is {bottom_m:g} m above home",
        ),
        (reach_m - fence.radius_m, top_m - fence.height_m, fence.floor_m - bottom_m),
        (fence.radius_m, fence.height_m, fence.floor_m),
        dialect.fence_parameters,
        strict=True,
    ):
        if over_m > -keep_off_m:
            raise VehicleError(
                f"box: {what}; the autopilot's own fence, {name} {limit_m:g} m, must be {keep_off_m:g} m further"
            )
