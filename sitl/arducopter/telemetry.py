"""What only ArduCopter says, or says otherwise than PX4: one function per MAVLink message."""

import math
from collections.abc import Callable

from sitl import telemetry as common
from sitl.arducopter.arming import READY_MS
from sitl.arducopter.commander import Commander
from sitl.arducopter.modes import Mode
from sitl.flight.physics import GRAVITY, euler, heading
from sitl.flight.reference import vector
from sitl.flight.sensors import ACCELEROMETER, GYRO, measured
from sitl.links.frames import Payload, pack
from sitl.telemetry import compass, int16
from sitl.vehicle import Vehicle

NAN = math.nan
GPS_DETECTED_MS, GPS_FIX_MS = 9_900, 10_100
"""As recorded."""
EKF_UNINITIALISED, EKF_ALIGNED, EKF_POSITION = 1024, 167, 831
"""EKF_STATUS_REPORT.flags as recorded."""
TICKS_PER_TURN = 36_000
MILLI_G = 1000.0 / GRAVITY

# SYS_STATUS as recorded.
SENSORS_PRESENT = 1399979055
SENSORS_ENABLED = 1398930479
SENSORS_HEALTHY = 1198652463
GPS = 0x20
PREARM_CHECK = 0x10000000


def commander(v: Vehicle) -> Commander:
    """This personality's own commander."""
    assert isinstance(v.commander, Commander)
    return v.commander


def sensors(v: Vehicle) -> tuple[int, int, int]:
    """SYS_STATUS: sensors present, enabled, healthy."""
    missing = GPS if v.now_ms < GPS_FIX_MS or not v.model.estimator.gps else 0
    ready = PREARM_CHECK if v.commander.ready else 0
    return SENSORS_PRESENT & ~missing, SENSORS_ENABLED & ~missing, SENSORS_HEALTHY & ~missing | ready


def timesync(v: Vehicle) -> Payload:
    """A request to everybody, every 10 s."""
    return pack("TIMESYNC", tc1=0, ts1=v.now_ms * 1_000_000 + 1, target_system=0, target_component=0)


def extended_sys_state(v: Vehicle) -> Payload:
    """vtol_state 3: a multicopter."""
    return pack("EXTENDED_SYS_STATE", vtol_state=3, landed_state=int(v.commander.landed))


def home_position(v: Vehicle) -> Payload | None:
    """With no attitude in it."""
    return common.home_position(v, (NAN, NAN, NAN, NAN))


def gps_global_origin(v: Vehicle) -> Payload | None:
    """Known as soon as home is."""
    return None if v.commander.home is None else common.global_origin(v)


def global_position_int(v: Vehicle) -> Payload:
    """Zeros until the receiver has a fix."""
    if v.now_ms >= GPS_FIX_MS:
        return common.global_position(v)
    yaw = round(compass(heading(v.body.attitude)) * 100.0) % TICKS_PER_TURN
    return pack(
        "GLOBAL_POSITION_INT",
        time_boot_ms=v.now_ms,
        lat=0,
        lon=0,
        alt=0,
        relative_alt=0,
        vx=0,
        vy=0,
        vz=0,
        hdg=yaw,
    )


def gps_raw_int(v: Vehicle) -> Payload:
    """fix_type 0 before the receiver is there, then 1, then 6 (fixed RTK) with 10 satellites."""
    if v.now_ms >= GPS_FIX_MS and not v.model.estimator.gps:
        return common.no_fix(v)
    if v.now_ms >= GPS_FIX_MS:
        true = v.model.truth
        x, y, z = measured(true.position, v.parameters["SIM_GPS1_NOISE"], v.noise)
        vx, vy, _ = vector(true.velocity)
        latitude, longitude = v.origin.globe(x, y)
        altitude = round((v.origin.altitude - z) * 1000.0)
        return pack(
            "GPS_RAW_INT",
            time_usec=v.now_ms * 1000,
            fix_type=6,
            lat=round(latitude * 1e7),
            lon=round(longitude * 1e7),
            alt=altitude,
            eph=121,
            epv=200,
            vel=int16(math.hypot(vx, vy) * 100.0),
            cog=round(compass(math.atan2(vy, vx)) * 100.0) % TICKS_PER_TURN,
            satellites_visible=10,
            alt_ellipsoid=altitude,
            h_acc=300,
            v_acc=300,
            vel_acc=0,
            hdg_acc=0,
            yaw=0,
        )
    detected = v.now_ms >= GPS_DETECTED_MS
    return pack(
        "GPS_RAW_INT",
        time_usec=0,
        fix_type=int(detected),
        lat=0,
        lon=0,
        alt=0,
        eph=121 if detected else 65535,
        epv=200 if detected else 65535,
        vel=0,
        cog=0,
        satellites_visible=3 if detected else 0,
        alt_ellipsoid=0,
        h_acc=0,
        v_acc=0,
        vel_acc=0,
        hdg_acc=0,
        yaw=0,
    )


def ekf_status_report(v: Vehicle) -> Payload:
    aligned = EKF_ALIGNED if v.now_ms >= 6000 else EKF_UNINITIALISED
    good = 0.01 if v.located else 0.0
    return pack(
        "EKF_STATUS_REPORT",
        flags=EKF_POSITION if v.located else aligned,
        velocity_variance=good,
        pos_horiz_variance=good,
        pos_vert_variance=good,
        compass_variance=good,
        terrain_alt_variance=0.0,
        airspeed_variance=0.0,
    )


def raw_imu(v: Vehicle) -> Payload:
    return pack("RAW_IMU", time_usec=v.now_ms * 1000, id=0, temperature=4500, **_imu(v))


def scaled_imu2(v: Vehicle) -> Payload:
    return pack("SCALED_IMU2", time_boot_ms=v.now_ms, temperature=4500, **_imu(v))


def scaled_imu3(v: Vehicle) -> Payload:
    """The third is a compass only."""
    only = {name: value if "mag" in name else 0 for name, value in _imu(v).items()}
    return pack("SCALED_IMU3", time_boot_ms=v.now_ms, temperature=0, **only)


def _imu(v: Vehicle) -> dict[str, int]:
    """Milli-g, mrad/s, mgauss."""
    force = v.measured(v.body.specific_force, ACCELEROMETER)
    rates = v.measured(v.body.rates, GYRO)
    yaw = heading(v.body.attitude)
    values = {f"{axis}acc": int16(f * MILLI_G) for axis, f in zip("xyz", force, strict=True)}
    values |= {f"{axis}gyro": int16(w * 1000.0) for axis, w in zip("xyz", rates, strict=True)}
    return values | {"xmag": round(210.0 * math.cos(yaw)), "ymag": round(-210.0 * math.sin(yaw)), "zmag": 430}


def scaled_pressure(v: Vehicle) -> Payload:
    return pack("SCALED_PRESSURE", **_pressure(v))


def scaled_pressure2(v: Vehicle) -> Payload:
    return pack("SCALED_PRESSURE2", **_pressure(v))


def _pressure(v: Vehicle) -> dict[str, object]:
    amsl = v.origin.altitude - float(v.body.position[2])
    return {
        "time_boot_ms": v.now_ms,
        "press_abs": common.pressure(v),
        "press_diff": 0.0,
        "temperature": int16((15.0 - 0.0065 * amsl) * 100.0),
        "temperature_press_diff": 0,
    }


def power_status(_: Vehicle) -> Payload:
    return pack("POWER_STATUS", Vcc=5000, Vservo=0, flags=0)


def mcu_status(_: Vehicle) -> Payload:
    return pack("MCU_STATUS", id=0, MCU_temperature=4500, MCU_voltage=3300, MCU_voltage_min=3300, MCU_voltage_max=3300)


def meminfo(_: Vehicle) -> Payload:
    return pack("MEMINFO", brkval=0, freemem=65535, freemem32=131072)


def nav_controller_output(v: Vehicle) -> Payload:
    """Attitude asked for, and the way to the place flown to."""
    roll, pitch, yaw = euler(v.controller.attitude_setpoint)
    x, y, z = v.position()
    goal = commander(v).destination
    north, east, up = (goal[0] - x, goal[1] - y, z - goal[2]) if goal is not None else (0.0, 0.0, 0.0)
    bearing = round(math.degrees(math.atan2(east, north))) if goal is not None else round(math.degrees(yaw))
    return pack(
        "NAV_CONTROLLER_OUTPUT",
        nav_roll=math.degrees(roll),
        nav_pitch=math.degrees(pitch),
        nav_bearing=round(math.degrees(yaw)),
        target_bearing=bearing,
        wp_dist=min(round(math.hypot(north, east)), 65535),
        alt_error=up,
        aspd_error=0.0,
        xtrack_error=0.0,
    )


VELOCITY_MASK, POSITION_MASK = 3079, 3576
"""type_mask of POSITION_TARGET_* as recorded: velocity and acceleration, and position alone."""


def position_target_local_ned(v: Vehicle) -> Payload | None:
    """What GUIDED was asked for; sent in GUIDED only."""
    if commander(v).mode is not Mode.GUIDED:
        return None
    place, velocity = commander(v).target
    return pack(
        "POSITION_TARGET_LOCAL_NED",
        time_boot_ms=v.now_ms,
        coordinate_frame=1,
        type_mask=POSITION_MASK if place is not None else VELOCITY_MASK,
        x=place[0] if place else 0.0,
        y=place[1] if place else 0.0,
        z=place[2] if place else 0.0,
        vx=velocity[0],
        vy=velocity[1],
        vz=velocity[2],
        afx=0.0,
        afy=0.0,
        afz=0.0,
        yaw=0.0,
        yaw_rate=0.0,
    )


def position_target_global_int(v: Vehicle) -> Payload | None:
    """Where it is flying to, or where it is."""
    if not v.located:
        return None
    x, y, z = commander(v).destination or v.position()
    latitude, longitude = v.origin.globe(x, y)
    return pack(
        "POSITION_TARGET_GLOBAL_INT",
        time_boot_ms=v.now_ms,
        coordinate_frame=5,
        type_mask=POSITION_MASK,
        lat_int=round(latitude * 1e7),
        lon_int=round(longitude * 1e7),
        alt=v.origin.altitude - z,
        vx=0.0,
        vy=0.0,
        vz=0.0,
        afx=0.0,
        afy=0.0,
        afz=0.0,
        yaw=0.0,
        yaw_rate=0.0,
    )


def rc_channels(v: Vehicle) -> Payload:
    """Centred sticks on sixteen channels."""
    channels = {f"chan{i}_raw": 1500 if i <= 16 else 65535 for i in range(1, 19)}
    return pack("RC_CHANNELS", time_boot_ms=v.now_ms, chancount=16, rssi=0, **channels)


def simstate(v: Vehicle) -> Payload:
    roll, pitch, yaw = euler(v.body.attitude)
    x, y, _ = vector(v.model.truth.position)
    latitude, longitude = v.origin.globe(x, y)
    ax, ay, az = vector(v.body.specific_force)
    p, q, r = vector(v.body.rates)
    return pack(
        "SIMSTATE",
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        xacc=ax,
        yacc=ay,
        zacc=az,
        xgyro=p,
        ygyro=q,
        zgyro=r,
        lat=round(latitude * 1e7),
        lng=round(longitude * 1e7),
    )


def ahrs(_: Vehicle) -> Payload:
    fields = ("omegaIx", "omegaIy", "omegaIz", "accel_weight", "renorm_val", "error_rp", "error_yaw")
    return pack("AHRS", **dict.fromkeys(fields, 0.0))


def ahrs2(v: Vehicle) -> Payload:
    roll, pitch, yaw = euler(v.body.attitude)
    x, y, z = v.position()
    latitude, longitude = v.origin.globe(x, y)
    return pack(
        "AHRS2",
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        altitude=v.origin.altitude - z,
        lat=round(latitude * 1e7),
        lng=round(longitude * 1e7),
    )


def terrain_report(v: Vehicle) -> Payload | None:
    """Flat ground."""
    if not v.located:
        return None
    x, y, z = v.position()
    latitude, longitude = v.origin.globe(x, y)
    return pack(
        "TERRAIN_REPORT",
        lat=round(latitude * 1e7),
        lon=round(longitude * 1e7),
        spacing=0,
        terrain_height=0.0,
        current_height=-z,
        pending=0,
        loaded=0,
    )


def vibration(v: Vehicle) -> Payload:
    level = 0.003 if v.commander.flying else 0.0
    return pack(
        "VIBRATION",
        time_usec=v.now_ms * 1000,
        vibration_x=level,
        vibration_y=level,
        vibration_z=level,
        clipping_0=0,
        clipping_1=0,
        clipping_2=0,
    )


def fence_status(v: Vehicle) -> Payload | None:
    """While there is a fence."""
    if not v.parameters["FENCE_ENABLE"]:
        return None
    c = commander(v)
    return pack(
        "FENCE_STATUS",
        breach_status=int(bool(c.watch.breach)),
        breach_count=min(c.watch.breaches, 65535),
        breach_type=int(c.watch.breach),
        breach_time=0,
        breach_mitigation=0,
    )


OWN = (
    timesync,
    extended_sys_state,
    home_position,
    gps_global_origin,
    global_position_int,
    gps_raw_int,
    ekf_status_report,
    raw_imu,
    scaled_imu2,
    scaled_imu3,
    scaled_pressure,
    scaled_pressure2,
    power_status,
    mcu_status,
    meminfo,
    nav_controller_output,
    position_target_local_ned,
    position_target_global_int,
    rc_channels,
    simstate,
    ahrs,
    ahrs2,
    terrain_report,
    vibration,
    fence_status,
)
NOT_SENT = frozenset({"ODOMETRY", "ALTITUDE", "CURRENT_MODE"})
"""What the other personality has and ArduCopter has not."""
EARLY = frozenset({"HEARTBEAT", "TIMESYNC", "AUTOPILOT_VERSION"})
"""What is sent before it is initialised."""


def initialised(build: Callable[[Vehicle], Payload | None]) -> Callable[[Vehicle], Payload | None]:
    """A message that is sent only once the autopilot is ready."""

    def send(v: Vehicle) -> Payload | None:
        return build(v) if v.now_ms >= READY_MS else None

    return send


MESSAGES: dict[str, Callable[[Vehicle], Payload | None]] = {
    name: build if name in EARLY else initialised(build)
    for name, build in {**common.MESSAGES, **{function.__name__.upper(): function for function in OWN}}.items()
    if name not in NOT_SENT
}
"""What can be streamed or requested, by message name."""
