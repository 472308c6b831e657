"""What the flight model and the battery need, read from ArduCopter's parameters."""

import math

from sitl.arducopter.shaper import Shape
from sitl.flight.battery import Pack
from sitl.flight.control import Gains
from sitl.flight.physics import GRAVITY, Rotorcraft
from sitl.flight.reference import Limits
from sitl.flight.world import World, in_the_air
from sitl.flight.world import world as own_world
from sitl.parameters import Parameters

MASS = 3.0
"""Of ArduPilot's default simulated frame (SIM_Frame.cpp) [kg]."""
HOVER_THROTTLE = 0.39
"""MOT_THST_HOVER of the recorded vehicle: sizes the motors."""
ATTITUDE_GAIN_MAX = 10.0
"""What the rate loop can follow [1/s]."""
DRAG, DRAG_QUADRATIC = 0.74, 0.083
"""[N/(m/s)] and [N/(m/s)2]: least squares over the recorded flight, from tilt and acceleration at 1 to 10 m/s."""
CELLS, CELL_EMPTY_V = 3, 3.3
"""Of the simulated battery, 12.6 V when full (SIM_BATT_VOLTAGE)."""


DEAD_RECKONING_S = 10.0
"""How long EKF3 keeps a position without GPS (its posRetryTimeUseVel_ms); not in the recording."""
W20_PER_TURBULENCE = 5.0
"""Gusts of this Dryden wind have about SIM_WIND_TURB for a horizontal standard deviation at 10 m."""


def rotorcraft(p: Parameters) -> Rotorcraft:
    """ArduPilot's default frame: 3 kg, 0.35 m across; SIM_ENGINE_FAIL (motors as bits) leaves SIM_ENGINE_MUL."""
    failed = int(p["SIM_ENGINE_FAIL"])
    left = [p["SIM_ENGINE_MUL"] if failed >> motor & 1 else 1.0 for motor in range(4)]
    craft = Rotorcraft(
        mass=MASS,
        inertia=(0.046, 0.046, 0.092),
        arm_roll=0.124,
        arm_pitch=0.124,
        thrust_max=MASS * GRAVITY / 4.0 / HOVER_THROTTLE,
        torque_max=0.35,
        motor_lag=0.05,
        drag=DRAG,
        drag_quadratic=DRAG_QUADRATIC,
        angular_drag=0.02,
        health=(left[0], left[1], left[2], left[3]),
    )
    return in_the_air(craft, p)


def world(p: Parameters) -> World:
    """The world of the SITL_* parameters and of SIM_WIND_*, SIM_GPS1_ENABLE; SIM_WIND_DIR is where wind comes from."""
    own = own_world(p, DEAD_RECKONING_S, gps_fix=bool(p["SIM_GPS1_ENABLE"]))
    towards, speed = math.radians(p["SIM_WIND_DIR"]), p["SIM_WIND_SPD"]
    north, east, down = own.wind.mean
    mean = (north - speed * math.cos(towards), east - speed * math.sin(towards), down)
    return own._replace(wind=own.wind._replace(mean=mean, w20=own.wind.w20 + W20_PER_TURBULENCE * p["SIM_WIND_TURB"]))


def pack(p: Parameters) -> Pack:
    """The battery of the BATT_* parameters.

    Low is less than BATT_LOW_MAH, or than BATT_LOW_VOLT for BATT_LOW_TIMER [s] (0: the voltage is not watched);
    critical by BATT_CRT_* likewise.

    SIM_BATT_VOLTAGE is that of a full one: lowered in flight it makes the battery low, as on ArduPilot's simulator.
    """
    full_v = max(p["SIM_BATT_VOLTAGE"] / CELLS, 0.1)
    empty_v = min(CELL_EMPTY_V, 0.99 * full_v)

    def by_charge(mah: float) -> float:
        return min(mah / p["BATT_CAPACITY"], 1.0)

    def by_voltage(volts: float) -> float:
        watched = volts > 0.0 and p["BATT_LOW_TIMER"] > 0.0
        return min(max((volts / CELLS - empty_v) / (full_v - empty_v), 0.0), 1.0) if watched else 0.0

    return Pack(
        cells=CELLS,
        capacity_mah=p["BATT_CAPACITY"],
        full_v=full_v,
        empty_v=empty_v,
        thresholds=(by_charge(p["BATT_LOW_MAH"]), by_charge(p["BATT_CRT_MAH"]), 0.0),
        cell_ohm=p["SITL_BAT_R"],
        lasting=(by_voltage(p["BATT_LOW_VOLT"]), by_voltage(p["BATT_CRT_VOLT"]), 0.0),
        patience_s=p["BATT_LOW_TIMER"],
    )


def tilt_max(p: Parameters) -> float:
    """PSC_ANGLE_MAX [deg], or else ANGLE_MAX [cdeg], in rad."""
    return math.radians(p["PSC_ANGLE_MAX"] or p["ANGLE_MAX"] * 0.01)


def rate_max(degrees: float, otherwise: float) -> float:
    """ATC_RATE_*_MAX [deg/s] in rad/s; 0 means no limit, for which a large one is taken."""
    return math.radians(degrees or otherwise)


def gains(p: Parameters) -> Gains:
    """The control law of the PSC_* and ATC_* parameters.

    The cascade is the shared one. ArduCopter shapes the attitude asked for with ATC_INPUT_TC and feeds the rate
    forward (ATC_RATE_FF_ENAB); here that is an attitude gain of 1 / ATC_INPUT_TC.
    """
    hover = HOVER_THROTTLE
    forward = min(1.0 / p["ATC_INPUT_TC"], ATTITUDE_GAIN_MAX) if p["ATC_RATE_FF_ENAB"] else 0.0
    return Gains(
        position_p=(p["PSC_POSXY_P"], p["PSC_POSXY_P"], p["PSC_POSZ_P"]),
        velocity_p=(p["PSC_VELXY_P"], p["PSC_VELXY_P"], p["PSC_VELZ_P"]),
        velocity_i=(p["PSC_VELXY_I"], p["PSC_VELXY_I"], p["PSC_VELZ_I"]),
        velocity_d=(p["PSC_VELXY_D"], p["PSC_VELXY_D"], p["PSC_VELZ_D"]),
        velocity_derivative_hz=p["PSC_VELXY_FLTD"],
        speed_xy_max=200.0,
        speed_up_max=200.0,
        speed_down_max=200.0,
        tilt_max=tilt_max(p),
        thrust_min=0.0,
        thrust_max=1.0,
        thrust_xy_margin=0.3,
        hover_thrust=hover,
        attitude_p=(max(p["ATC_ANG_RLL_P"], forward), max(p["ATC_ANG_PIT_P"], forward), p["ATC_ANG_YAW_P"]),
        yaw_weight=1.0,
        rate_max=(
            rate_max(p["ATC_RATE_R_MAX"], 720.0),
            rate_max(p["ATC_RATE_P_MAX"], 720.0),
            rate_max(p["ATC_RATE_Y_MAX"], 200.0),
        ),
        rate_p=(p["ATC_RAT_RLL_P"], p["ATC_RAT_PIT_P"], p["ATC_RAT_YAW_P"]),
        rate_i=(p["ATC_RAT_RLL_I"], p["ATC_RAT_PIT_I"], p["ATC_RAT_YAW_I"]),
        rate_d=(p["ATC_RAT_RLL_D"], p["ATC_RAT_PIT_D"], p["ATC_RAT_YAW_D"]),
        rate_integral_max=(p["ATC_RAT_RLL_IMAX"], p["ATC_RAT_PIT_IMAX"], p["ATC_RAT_YAW_IMAX"]),
        yaw_torque_hz=p["ATC_RAT_YAW_FLTE"],
    )


def shape(p: Parameters) -> Shape:
    """Of velocities asked for in GUIDED, and of braking: WPNAV_ACCEL*, PSC_JERK_*."""
    return Shape(
        acceleration_xy=p["WPNAV_ACCEL"] * 0.01,
        jerk_xy=p["PSC_JERK_XY"],
        acceleration_z=p["WPNAV_ACCEL_Z"] * 0.01,
        jerk_z=p["PSC_JERK_Z"],
        speed_up=p["WPNAV_SPEED_UP"] * 0.01,
        speed_down=p["WPNAV_SPEED_DN"] * 0.01,
    )


def limits(p: Parameters, speed_cms: float = 0.0) -> Limits:
    """Of the autonomous modes: WPNAV_*; `speed_cms` is a speed to take in place of WPNAV_SPEED, if above zero."""
    return Limits(
        speed_xy=(speed_cms if speed_cms > 0.0 else p["WPNAV_SPEED"]) * 0.01,
        speed_up=p["WPNAV_SPEED_UP"] * 0.01,
        speed_down=p["WPNAV_SPEED_DN"] * 0.01,
        acceleration_xy=p["WPNAV_ACCEL"] * 0.01,
        acceleration_z=p["WPNAV_ACCEL_Z"] * 0.01,
        braking_z=0.6 * p["WPNAV_ACCEL_Z"] * 0.01,
        jerk=BRAKING_JERK * p["WPNAV_JERK"],
    )


BRAKING_JERK = 20.0
"""Per WPNAV_JERK. Makes the recorded way of coming to a stop: at 9 m/s 17 m before the place, at 6 m/s 6 m before."""
