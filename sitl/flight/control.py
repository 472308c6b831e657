"""PX4's cascaded multicopter control law, compiled.

Position P -> velocity PID -> thrust vector and yaw -> attitude P (quaternion) -> rate PID -> mixer, with the
parameter names of PX4's mc_pos_control, mc_att_control, mc_rate_control and control_allocator. NED and FRD; thrust
and torques are normalised: 1 is all four motors at full thrust, and one motor's full share of a torque.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.flight.compiled import compiled
from sitl.flight.physics import GRAVITY, PITCH_SIGN, ROLL_SIGN, YAW_SIGN, Body, heading, rotate

TORQUE_SHARE = math.sqrt(0.5)
"""A motor's share of roll and pitch after PX4's normalisation of a symmetric quad's effectiveness matrix."""
GYRO_DERIVATIVE_HZ = 30.0
"""IMU_DGYRO_CUTOFF: low-pass of the angular acceleration behind the D gain."""


class Gains(NamedTuple):
    """PX4 parameters of the control law; angles in rad, rates in rad/s."""

    position_p: tuple[float, float, float]
    """MPC_XY_P, MPC_XY_P, MPC_Z_P [1/s]."""
    velocity_p: tuple[float, float, float]
    """MPC_XY_VEL_P_ACC, MPC_Z_VEL_P_ACC [1/s]."""
    velocity_i: tuple[float, float, float]
    """MPC_XY_VEL_I_ACC, MPC_Z_VEL_I_ACC [1/s2]."""
    velocity_d: tuple[float, float, float]
    """MPC_XY_VEL_D_ACC, MPC_Z_VEL_D_ACC [1]."""
    velocity_derivative_hz: float
    """MPC_VELD_LP [Hz]."""
    speed_xy_max: float
    """MPC_XY_VEL_MAX [m/s]."""
    speed_up_max: float
    """MPC_Z_VEL_MAX_UP [m/s]."""
    speed_down_max: float
    """MPC_Z_VEL_MAX_DN [m/s]."""
    tilt_max: float
    """MPC_TILTMAX_AIR [rad]."""
    thrust_min: float
    """MPC_THR_MIN."""
    thrust_max: float
    """MPC_THR_MAX."""
    thrust_xy_margin: float
    """MPC_THR_XY_MARG."""
    hover_thrust: float
    """MPC_THR_HOVER, or what the hover thrust estimator would find (MPC_USE_HTE)."""
    attitude_p: tuple[float, float, float]
    """MC_ROLL_P, MC_PITCH_P, MC_YAW_P [1/s]."""
    yaw_weight: float
    """MC_YAW_WEIGHT."""
    rate_max: tuple[float, float, float]
    """MC_ROLLRATE_MAX, MC_PITCHRATE_MAX, MC_YAWRATE_MAX [rad/s]."""
    rate_p: tuple[float, float, float]
    rate_i: tuple[float, float, float]
    rate_d: tuple[float, float, float]
    """MC_ROLLRATE_P, ... I, ... D."""
    rate_integral_max: tuple[float, float, float]
    """MC_RR_INT_LIM, MC_PR_INT_LIM, MC_YR_INT_LIM."""
    yaw_torque_hz: float
    """MC_YAW_TQ_CUTOFF [Hz]."""


class Setpoint(NamedTuple):
    """What to fly, NED; NaN = not controlled. Velocity is a feed-forward where a position is given."""

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    acceleration: tuple[float, float, float]
    yaw: float
    """[rad]; NaN keeps the heading as it is."""
    yaw_rate: float
    """[rad/s]; NaN = none."""
    climb_max: float = math.inf
    """Climb limit [m/s] on top of the parameter's; PX4's takeoff ramp starts it below zero. As long as there is one the
    velocity integral is kept on the ground, too: it delays PX4's lift-off by a second."""
    thrust_min: float = 0.0
    """MPC_THR_MIN in flight, 0 until then."""
    thrust: float = math.nan
    """Collective, 0 to 1: flown instead of position and velocity, with `attitude` or `rates`; NaN = not given."""
    attitude: tuple[float, float, float, float] = (math.nan, math.nan, math.nan, math.nan)
    """Body to NED, w first."""
    rates: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """FRD [rad/s]; NaN = from the attitude."""


class Controller(NamedTuple):
    """Memory of the control law and what it asked for; arrays of float64 changed in place."""

    velocity_integral: NDArray[np.float64]
    velocity_before: NDArray[np.float64]
    velocity_derivative: NDArray[np.float64]
    rate_integral: NDArray[np.float64]
    rate_before: NDArray[np.float64]
    rate_derivative: NDArray[np.float64]
    yaw_torque: NDArray[np.float64]
    velocity_setpoint: NDArray[np.float64]
    acceleration_setpoint: NDArray[np.float64]
    thrust_setpoint: NDArray[np.float64]
    """[3] NED, normalised."""
    attitude_setpoint: NDArray[np.float64]
    rate_setpoint: NDArray[np.float64]
    commands: NDArray[np.float64]
    """[4] motor commands, 0 to 1."""


def controller_at_rest() -> Controller:
    """Nothing integrated, nothing asked for."""
    return Controller(
        velocity_integral=np.zeros(3),
        velocity_before=np.zeros(3),
        velocity_derivative=np.zeros(3),
        rate_integral=np.zeros(3),
        rate_before=np.zeros(3),
        rate_derivative=np.zeros(3),
        yaw_torque=np.zeros(1),
        velocity_setpoint=np.full(3, np.nan),
        acceleration_setpoint=np.zeros(3),
        thrust_setpoint=np.zeros(3),
        attitude_setpoint=np.array([1.0, 0.0, 0.0, 0.0]),
        rate_setpoint=np.zeros(3),
        commands=np.zeros(4),
    )


@compiled
def low_pass(cutoff_hz: float, dt: float) -> float:
    """Gain of a first-order low-pass per step; 1 when there is no cutoff."""
    if cutoff_hz <= 0.0:
        return 1.0
    return 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * dt)


@compiled
def saturate_horizontal(x: float, y: float, limit: float) -> tuple[float, float]:
    """Shorten (x, y) to at most `limit`."""
    norm = math.sqrt(x * x + y * y)
    if norm <= limit:
        return x, y
    return x / norm * limit, y / norm * limit


@compiled
def prioritise(px: float, py: float, fx: float, fy: float, limit: float) -> tuple[float, float]:
    """p + f, shortened to `limit` by giving up f first (p, from the position error, has priority)."""
    sx, sy = px + fx, py + fy
    if sx * sx + sy * sy <= limit * limit:
        return sx, sy
    p2 = px * px + py * py
    f = math.sqrt(fx * fx + fy * fy)
    if p2 >= limit * limit:
        return saturate_horizontal(px, py, limit)
    if f < 1e-9:
        return px, py
    ux, uy = fx / f, fy / f
    along = ux * px + uy * py
    reach = -along + math.sqrt(along * along + limit * limit - p2)
    return px + ux * reach, py + uy * reach


@compiled
def velocity_from_position(body: Body, setpoint: Setpoint, gains: Gains, out: NDArray[np.float64]) -> None:
    """Position P with velocity feed-forward, inside the speed limits (PositionControl::_positionControl)."""
    towards = np.zeros(3)
    forward = np.zeros(3)
    for i in range(3):
        have_position = not math.isnan(setpoint.position[i])
        have_velocity = not math.isnan(setpoint.velocity[i])
        if have_position:
            towards[i] = (setpoint.position[i] - body.position[i]) * gains.position_p[i]
        if have_velocity:
            forward[i] = setpoint.velocity[i]
        out[i] = towards[i] + forward[i] if have_position or have_velocity else math.nan
    if not math.isnan(out[0]) and not math.isnan(out[1]):
        out[0], out[1] = prioritise(towards[0], towards[1], forward[0], forward[1], gains.speed_xy_max)
    if not math.isnan(out[2]):
        # The ramp's limit wins, which begins further down than MPC_Z_VEL_MAX_DN.
        out[2] = max(min(out[2], gains.speed_down_max), -min(gains.speed_up_max, setpoint.climb_max))


@compiled
def control_velocity(body: Body, c: Controller, setpoint: Setpoint, gains: Gains, dt: float) -> None:
    """Velocity PID -> acceleration -> thrust vector, with anti-windup (PositionControl::_velocityControl)."""
    velocity_from_position(body, setpoint, gains, c.velocity_setpoint)
    smooth = low_pass(gains.velocity_derivative_hz, dt)
    error = np.zeros(3)
    for i in range(3):
        derivative = (body.velocity[i] - c.velocity_before[i]) / dt
        c.velocity_before[i] = body.velocity[i]
        c.velocity_derivative[i] += (derivative - c.velocity_derivative[i]) * smooth
        wanted = 0.0 if math.isnan(setpoint.acceleration[i]) else setpoint.acceleration[i]
        if not math.isnan(c.velocity_setpoint[i]):
            error[i] = c.velocity_setpoint[i] - body.velocity[i]
            wanted += (
                gains.velocity_p[i] * error[i] + c.velocity_integral[i] - gains.velocity_d[i] * c.velocity_derivative[i]
            )
        else:  # forgotten, as recorded when OFFBOARD was entered again after a coasting failsafe
            c.velocity_integral[i] = 0.0
        c.acceleration_setpoint[i] = wanted

    a = c.acceleration_setpoint
    thrust = c.thrust_setpoint
    # Tilt is chosen as if the vertical axis only carried the weight (MPC_ACC_DECOUPLE = 1).
    norm = math.sqrt(a[0] * a[0] + a[1] * a[1] + GRAVITY * GRAVITY)
    bx, by, bz = -a[0] / norm, -a[1] / norm, GRAVITY / norm
    if bz < math.cos(gains.tilt_max):
        level = math.sqrt(bx * bx + by * by)
        bx, by = bx / level * math.sin(gains.tilt_max), by / level * math.sin(gains.tilt_max)
        bz = math.cos(gains.tilt_max)
    vertical = a[2] * gains.hover_thrust / GRAVITY - gains.hover_thrust
    collective = min(vertical / bz, -setpoint.thrust_min)
    thrust[0], thrust[1], thrust[2] = bx * collective, by * collective, bz * collective

    if (thrust[2] >= -setpoint.thrust_min and error[2] >= 0.0) or (thrust[2] <= -gains.thrust_max and error[2] <= 0.0):
        error[2] = 0.0
    horizontal = math.sqrt(thrust[0] * thrust[0] + thrust[1] * thrust[1])
    margin = min(horizontal, gains.thrust_xy_margin)
    thrust[2] = max(thrust[2], -math.sqrt(gains.thrust_max**2 - margin * margin))
    left = math.sqrt(max(gains.thrust_max**2 - thrust[2] * thrust[2], 0.0))
    thrust[0], thrust[1] = saturate_horizontal(thrust[0], thrust[1], left)

    # Tracking anti-windup: what saturation took from the acceleration is taken from the integral's input.
    produced_x = thrust[0] * GRAVITY / gains.hover_thrust
    produced_y = thrust[1] * GRAVITY / gains.hover_thrust
    if a[0] * a[0] + a[1] * a[1] > produced_x * produced_x + produced_y * produced_y:
        error[0] -= 2.0 / gains.velocity_p[0] * (a[0] - produced_x)
        error[1] -= 2.0 / gains.velocity_p[1] * (a[1] - produced_y)
    for i in range(3):
        c.velocity_integral[i] += gains.velocity_i[i] * error[i] * dt
    c.velocity_integral[2] = min(max(c.velocity_integral[2], -GRAVITY), GRAVITY)


@compiled
def attitude_from_thrust(thrust: NDArray[np.float64], yaw: float, out: NDArray[np.float64]) -> None:
    """Quaternion whose body z axis opposes the thrust and whose x axis points to yaw (ControlMath::bodyzToAttitude)."""
    norm = math.sqrt(thrust[0] * thrust[0] + thrust[1] * thrust[1] + thrust[2] * thrust[2])
    if norm < 1e-6:
        out[0], out[1], out[2], out[3] = math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)
        return
    zx, zy, zz = -thrust[0] / norm, -thrust[1] / norm, -thrust[2] / norm
    # x = y_c x z, with y_c the level vector to the right of yaw.
    cx, cy = -math.sin(yaw), math.cos(yaw)
    xx, xy, xz = cy * zz, -cx * zz, cx * zy - cy * zx
    norm = math.sqrt(xx * xx + xy * xy + xz * xz)
    xx, xy, xz = xx / norm, xy / norm, xz / norm
    yx, yy, yz = zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx
    quaternion_of(xx, yx, zx, xy, yy, zy, xz, yz, zz, out)


@compiled
def quaternion_of(
    r00: float,
    r01: float,
    r02: float,
    r10: float,
    r11: float,
    r12: float,
    r20: float,
    r21: float,
    r22: float,
    out: NDArray[np.float64],
) -> None:
    """Unit quaternion of a rotation matrix, the largest component first for accuracy."""
    trace = r00 + r11 + r22
    if trace > 0.0:
        s = 2.0 * math.sqrt(trace + 1.0)
        out[0], out[1], out[2], out[3] = 0.25 * s, (r21 - r12) / s, (r02 - r20) / s, (r10 - r01) / s
    elif r00 > r11 and r00 > r22:
        s = 2.0 * math.sqrt(1.0 + r00 - r11 - r22)
        out[0], out[1], out[2], out[3] = (r21 - r12) / s, 0.25 * s, (r01 + r10) / s, (r02 + r20) / s
    elif r11 > r22:
        s = 2.0 * math.sqrt(1.0 + r11 - r00 - r22)
        out[0], out[1], out[2], out[3] = (r02 - r20) / s, (r01 + r10) / s, 0.25 * s, (r12 + r21) / s
    else:
        s = 2.0 * math.sqrt(1.0 + r22 - r00 - r11)
        out[0], out[1], out[2], out[3] = (r10 - r01) / s, (r02 + r20) / s, (r12 + r21) / s, 0.25 * s


@compiled
def multiply(
    a: tuple[float, float, float, float], b: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """Hamilton product."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@compiled
def control_attitude(body: Body, c: Controller, setpoint: Setpoint, gains: Gains) -> None:
    """Attitude P on the quaternion, tilt before yaw (Brescianini et al. 2013, as in AttitudeControl::update)."""
    q = (body.attitude[0], body.attitude[1], body.attitude[2], body.attitude[3])
    back = (q[0], -q[1], -q[2], -q[3])
    goal = (c.attitude_setpoint[0], c.attitude_setpoint[1], c.attitude_setpoint[2], c.attitude_setpoint[3])
    zx, zy, zz = rotate(body.attitude, 0.0, 0.0, 1.0)
    gx, gy, gz = rotate(c.attitude_setpoint, 0.0, 0.0, 1.0)
    dot = zx * gx + zy * gy + zz * gz
    if dot < -1.0 + 1e-5:  # upside down: no shortest tilt exists, turn by the full attitude
        reduced = goal
    else:
        w, x, y, z = 1.0 + dot, zy * gz - zz * gy, zz * gx - zx * gz, zx * gy - zy * gx
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        reduced = multiply((w / norm, x / norm, y / norm, z / norm), q)
    mix = multiply((reduced[0], -reduced[1], -reduced[2], -reduced[3]), goal)
    sign = 1.0 if mix[0] >= 0.0 else -1.0
    turn_w = math.cos(gains.yaw_weight * math.acos(min(max(sign * mix[0], -1.0), 1.0)))
    turn_z = math.sin(gains.yaw_weight * math.asin(min(max(sign * mix[3], -1.0), 1.0)))
    wanted = multiply(reduced, (turn_w, 0.0, 0.0, turn_z))
    error = multiply(back, wanted)
    sign = 2.0 if error[0] >= 0.0 else -2.0
    yaw_p = gains.attitude_p[2] / gains.yaw_weight if gains.yaw_weight > 1e-4 else gains.attitude_p[2]
    rate = c.rate_setpoint
    rate[0] = sign * error[1] * gains.attitude_p[0]
    rate[1] = sign * error[2] * gains.attitude_p[1]
    rate[2] = sign * error[3] * yaw_p
    if not math.isnan(setpoint.yaw_rate):
        # The world's z axis seen from the body, times the yaw rate.
        rate[0] += 2.0 * (q[1] * q[3] - q[0] * q[2]) * setpoint.yaw_rate
        rate[1] += 2.0 * (q[2] * q[3] + q[0] * q[1]) * setpoint.yaw_rate
        rate[2] += (1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])) * setpoint.yaw_rate
    for i in range(3):
        rate[i] = min(max(rate[i], -gains.rate_max[i]), gains.rate_max[i])


@compiled
def control_rates(body: Body, c: Controller, gains: Gains, dt: float) -> None:
    """Rate PID -> torques -> motor commands; the integral stops where the mixer saturated."""
    smooth = low_pass(GYRO_DERIVATIVE_HZ, dt)
    torque = np.zeros(3)
    error = np.zeros(3)
    for i in range(3):
        derivative = (body.rates[i] - c.rate_before[i]) / dt
        c.rate_before[i] = body.rates[i]
        c.rate_derivative[i] += (derivative - c.rate_derivative[i]) * smooth
        error[i] = c.rate_setpoint[i] - body.rates[i]
        torque[i] = gains.rate_p[i] * error[i] + c.rate_integral[i] - gains.rate_d[i] * c.rate_derivative[i]
        torque[i] = min(max(torque[i], -1.0), 1.0)
    c.yaw_torque[0] += (torque[2] - c.yaw_torque[0]) * low_pass(gains.yaw_torque_hz, dt)
    torque[2] = c.yaw_torque[0]

    thrust = c.thrust_setpoint
    collective = math.sqrt(thrust[0] * thrust[0] + thrust[1] * thrust[1] + thrust[2] * thrust[2])
    achieved = mix(collective, torque, c.commands)
    for i in range(3):
        short = torque[i] - achieved[i]
        if short * error[i] > 0.0 and abs(short) > 1e-3:
            continue
        fade = max(0.0, 1.0 - (error[i] / math.radians(400.0)) ** 2)
        integral = c.rate_integral[i] + fade * gains.rate_i[i] * error[i] * dt
        c.rate_integral[i] = min(max(integral, -gains.rate_integral_max[i]), gains.rate_integral_max[i])


@compiled
def unsaturating(commands: NDArray[np.float64], share: NDArray[np.float64], top: float) -> float:
    """How much of `share` to add so that commands come back into [0, top] (both ends: the mean)."""
    lowest = 0.0
    highest = 0.0
    for i in range(4):
        if abs(share[i]) < 1e-9:
            continue
        k = 0.0
        if commands[i] < 0.0:
            k = -commands[i] / share[i]
        elif commands[i] > top:
            k = (top - commands[i]) / share[i]
        lowest = min(lowest, k)
        highest = max(highest, k)
    return lowest + highest


@compiled
def desaturate(commands: NDArray[np.float64], share: NDArray[np.float64], top: float, reduce_only: bool) -> None:
    """PX4's ControlAllocationSequentialDesaturation: one full correction, then half of what is left."""
    gain = unsaturating(commands, share, top)
    if reduce_only and gain > 0.0:
        return
    commands += gain * share
    gain = 0.5 * unsaturating(commands, share, top)
    if not (reduce_only and gain > 0.0):
        commands += gain * share


@compiled
def mix(collective: float, torque: NDArray[np.float64], commands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Motor commands [4] from thrust and torques; gives up yaw first, then thrust, then roll and pitch (MC_AIRMODE 0).

    Returns the torques [3] that the commands really make.
    """
    roll = np.empty(4)
    pitch = np.empty(4)
    yaw = np.empty(4)
    lift = np.ones(4)
    for i in range(4):
        roll[i] = ROLL_SIGN[i] * TORQUE_SHARE
        pitch[i] = PITCH_SIGN[i] * TORQUE_SHARE
        yaw[i] = YAW_SIGN[i]
        commands[i] = collective + roll[i] * torque[0] + pitch[i] * torque[1]
    desaturate(commands, lift, 1.0, True)
    desaturate(commands, roll, 1.0, False)
    desaturate(commands, pitch, 1.0, False)
    commands += yaw * torque[2]
    desaturate(commands, yaw, 1.15, False)  # some yaw is kept even at full thrust
    desaturate(commands, lift, 1.0, True)
    achieved = np.zeros(3)
    for i in range(4):
        commands[i] = min(max(commands[i], 0.0), 1.0)
        achieved[0] += ROLL_SIGN[i] * commands[i] / (4.0 * TORQUE_SHARE)
        achieved[1] += PITCH_SIGN[i] * commands[i] / (4.0 * TORQUE_SHARE)
        achieved[2] += YAW_SIGN[i] * commands[i] / 4.0
    return achieved


@compiled
def rest(c: Controller, yaw: float) -> None:
    """Forget everything: motors off or idling on the ground."""
    c.velocity_integral[:] = 0.0
    c.velocity_before[:] = 0.0
    c.velocity_derivative[:] = 0.0
    c.rate_integral[:] = 0.0
    c.rate_before[:] = 0.0
    c.rate_derivative[:] = 0.0
    c.yaw_torque[0] = 0.0
    c.velocity_setpoint[:] = math.nan
    c.acceleration_setpoint[:] = 0.0
    c.thrust_setpoint[:] = 0.0
    c.attitude_setpoint[0] = math.cos(0.5 * yaw)
    c.attitude_setpoint[1] = 0.0
    c.attitude_setpoint[2] = 0.0
    c.attitude_setpoint[3] = math.sin(0.5 * yaw)
    c.rate_setpoint[:] = 0.0
    c.commands[:] = 0.0


@compiled
def take_thrust(body: Body, c: Controller, setpoint: Setpoint) -> None:
    """A collective and an attitude given from outside take the place of the position and velocity loops."""
    zx, zy, zz = rotate(body.attitude, 0.0, 0.0, 1.0)
    c.thrust_setpoint[0] = -zx * setpoint.thrust
    c.thrust_setpoint[1] = -zy * setpoint.thrust
    c.thrust_setpoint[2] = -zz * setpoint.thrust
    for i in range(4):
        given = setpoint.attitude[i]
        c.attitude_setpoint[i] = body.attitude[i] if math.isnan(given) else given
    for i in range(3):
        c.velocity_setpoint[i] = math.nan
        c.acceleration_setpoint[i] = 0.0
        c.velocity_integral[i] = 0.0
        c.velocity_derivative[i] = 0.0
        c.velocity_before[i] = body.velocity[i]


@compiled
def control(body: Body, c: Controller, setpoint: Setpoint, gains: Gains, dt: float) -> None:
    """One pass of the whole cascade: from the setpoint to motor commands."""
    if math.isnan(setpoint.thrust):
        control_velocity(body, c, setpoint, gains, dt)
        yaw = heading(body.attitude) if math.isnan(setpoint.yaw) else setpoint.yaw
        attitude_from_thrust(c.thrust_setpoint, yaw, c.attitude_setpoint)
    else:
        take_thrust(body, c, setpoint)
    if body.contact_s[0] > 0.0:  # integrals must not wind up against the ground
        c.rate_integral[:] = 0.0
        if math.isinf(setpoint.climb_max):
            c.velocity_integral[:] = 0.0
    if math.isnan(setpoint.rates[0]):
        control_attitude(body, c, setpoint, gains)
    else:
        for i in range(3):
            c.rate_setpoint[i] = min(max(setpoint.rates[i], -gains.rate_max[i]), gains.rate_max[i])
    control_rates(body, c, gains, dt)
