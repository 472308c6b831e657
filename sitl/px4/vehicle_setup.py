"""What the flight model and the battery need, read from PX4's parameters."""

import math

from sitl.flight.battery import Pack
from sitl.flight.control import Gains
from sitl.flight.physics import GRAVITY, Rotorcraft
from sitl.flight.world import World, in_the_air
from sitl.flight.world import world as own_world
from sitl.parameters import Parameters

SATELLITES_MIN = 4
"""SIM_GPS_USED below this is no fix."""


def rotorcraft(p: Parameters) -> Rotorcraft:
    """The airframe of the SIH_* parameters."""
    craft = Rotorcraft(
        mass=p["SIH_MASS"],
        inertia=(p["SIH_IXX"], p["SIH_IYY"], p["SIH_IZZ"]),
        arm_roll=p["SIH_L_ROLL"],
        arm_pitch=p["SIH_L_PITCH"],
        thrust_max=p["SIH_T_MAX"],
        torque_max=p["SIH_Q_MAX"],
        motor_lag=p["SIH_T_TAU"],
        drag=p["SIH_KDV"],
        angular_drag=p["SIH_KDW"],
    )
    return in_the_air(craft, p)


def world(p: Parameters) -> World:
    """The world of the SITL_* parameters; a position lasts EKF2_NOAID_TOUT [us] without GPS."""
    return own_world(p, p["EKF2_NOAID_TOUT"] * 1e-6, gps_fix=p["SIM_GPS_USED"] >= SATELLITES_MIN)


def pack(p: Parameters) -> Pack:
    """The battery of the BAT1_* and BAT_* parameters."""
    return Pack(
        cells=int(p["BAT1_N_CELLS"]),
        capacity_mah=p["BAT1_CAPACITY"],
        full_v=p["BAT1_V_CHARGED"],
        empty_v=p["BAT1_V_EMPTY"],
        thresholds=(p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"]),
        cell_ohm=p["SITL_BAT_R"],
    )


def rate_gains(p: Parameters, which: str) -> tuple[float, float, float]:
    """MC_*RATE_P, I or D, times MC_*RATE_K."""
    roll, pitch, yaw = (p[f"MC_{axis}RATE_{which}"] * p[f"MC_{axis}RATE_K"] for axis in ("ROLL", "PITCH", "YAW"))
    return roll, pitch, yaw


def gains(p: Parameters) -> Gains:
    """The control law of the MPC_* and MC_* parameters; with MPC_USE_HTE the hover thrust is the true one."""
    hover = p["SIH_MASS"] * GRAVITY / (4.0 * p["SIH_T_MAX"])
    return Gains(
        position_p=(p["MPC_XY_P"], p["MPC_XY_P"], p["MPC_Z_P"]),
        velocity_p=(p["MPC_XY_VEL_P_ACC"], p["MPC_XY_VEL_P_ACC"], p["MPC_Z_VEL_P_ACC"]),
        velocity_i=(p["MPC_XY_VEL_I_ACC"], p["MPC_XY_VEL_I_ACC"], p["MPC_Z_VEL_I_ACC"]),
        velocity_d=(p["MPC_XY_VEL_D_ACC"], p["MPC_XY_VEL_D_ACC"], p["MPC_Z_VEL_D_ACC"]),
        velocity_derivative_hz=p["MPC_VELD_LP"],
        speed_xy_max=p["MPC_XY_VEL_MAX"],
        speed_up_max=p["MPC_Z_VEL_MAX_UP"],
        speed_down_max=p["MPC_Z_VEL_MAX_DN"],
        tilt_max=math.radians(p["MPC_TILTMAX_AIR"]),
        thrust_min=p["MPC_THR_MIN"],
        thrust_max=p["MPC_THR_MAX"],
        thrust_xy_margin=p["MPC_THR_XY_MARG"],
        hover_thrust=min(max(hover, 0.1), 0.9) if p["MPC_USE_HTE"] else p["MPC_THR_HOVER"],
        attitude_p=(p["MC_ROLL_P"], p["MC_PITCH_P"], p["MC_YAW_P"]),
        yaw_weight=p["MC_YAW_WEIGHT"],
        rate_max=(
            math.radians(p["MC_ROLLRATE_MAX"]),
            math.radians(p["MC_PITCHRATE_MAX"]),
            math.radians(p["MC_YAWRATE_MAX"]),
        ),
        rate_p=rate_gains(p, "P"),
        rate_i=rate_gains(p, "I"),
        rate_d=rate_gains(p, "D"),
        rate_integral_max=(p["MC_RR_INT_LIM"], p["MC_PR_INT_LIM"], p["MC_YR_INT_LIM"]),
        yaw_torque_hz=p["MC_YAW_TQ_CUTOFF"],
    )
