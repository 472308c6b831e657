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
from autopilot_bridge.vehicle import Vehicle, VehicleError

TRACKING_HEADROOM = 1.25
"""A vehicle that is behind its plan may be this much faster than plans are, if the autopilot lets it."""
STREAM_LOSS_MAX_S = 10.0
"""For so long a lost stream may at most fly on; PX4 and ArduCopter take 1 and 3 s by default."""
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
    name, unit = vehicle.dialect.stream_loss
    delay_s = vehicle.parameter(name) * unit
    if delay_s > STREAM_LOSS_MAX_S:
        raise VehicleError(
            f"offboard_loss is late: {name} is {delay_s:g} s, must be {STREAM_LOSS_MAX_S:g} s at most"
            f"{_way_out('offboard_loss')}"
        )


def _required(config: BridgeConfig, vehicle: Vehicle) -> None:
    """Failsafes that whoever runs the vehicle chooses. Raises VehicleError for one that is off."""
    for failsafe in dict.fromkeys((*REQUIRED, *config.require)):
        if failsafe in config.allow_without:
            continue
        for need in vehicle.dialect.owners_failsafes.get(failsafe, ()):
            found = vehicle.parameter(need.parameter)
            if not need.met(found):
                raise VehicleError(
                    f"{failsafe} is off: {need.parameter} is {found:g}, must be {need.allowed}{_way_out(failsafe)}"
                )


def _way_out(failsafe: str) -> str:
    return f"; set it, or say in the mission that it flies without (allow_without: [{failsafe}])"


def _bounds(config: BridgeConfig, vehicle: Vehicle) -> Bounds:
    dialect = vehicle.dialect
    theirs = {name: vehicle.parameter(limit) * unit for name, (limit, unit) in dialect.limits.items()}
    theirs["acceleration_mps2"] = min(theirs.get("acceleration_mps2", math.inf), _tilted(dialect, vehicle))
    limits = config.limits.within(**theirs)
    headroom_mps = min(limits.horizontal_mps * TRACKING_HEADROOM, theirs["horizontal_mps"])
    fence = dialect.own_fence(vehicle.parameter)
    _require_room(config, dialect, fence)
    home_m = min(config.home_distance_m or math.inf, fence.radius_m - KEEP_OFF_M)
    return Bounds(
        limits=limits,
        tracking=limits.model_copy(update={"horizontal_mps": headroom_mps}),
        home_distance_m=None if math.isinf(home_m) else home_m,
        ceiling_m=fence.height_m - KEEP_OFF_M,
        battery_reserve=0.0 if config.endurance is None else dialect.battery_acts_at(vehicle.parameter),
    )


def _tilted(dialect: Dialect, vehicle: Vehicle) -> float:
    """The horizontal acceleration [m/s2] of a hover tilted as far as the autopilot lets it."""
    name, unit = dialect.tilt_max
    return GRAVITY * math.tan(math.radians(min(vehicle.parameter(name) * unit, 89.0)))


def _require_room(config: BridgeConfig, dialect: Dialect, fence: OwnFence) -> None:
    """Raises VehicleError when plans could meet the autopilot's own fence."""
    reach_m, top_m = float(np.hypot(*config.box.corners.T).max()), config.box.z[1]
    for what, far_m, limit_m, name in zip(
        ("its corners are {:.1f} m from home", "its top is {:g} m above home"),
        (reach_m, top_m),
        (fence.radius_m, fence.height_m),
        dialect.fence_parameters,
        strict=True,
    ):
        if far_m > limit_m - KEEP_OFF_M:
            raise VehicleError(
                f"box: {what.format(far_m)}; the autopilot's own fence, {name} {limit_m:g} m, "
                f"must be {KEEP_OFF_M:g} m further"
            )
