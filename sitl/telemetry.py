"""What the vehicle says of itself: one function per MAVLink message, from the state of this moment.

A function returns None while the vehicle does not know yet (no position, no home).
"""

import math
import struct
from collections.abc import Callable

import numpy as np

from sitl.flight import sensors
from sitl.flight.physics import GRAVITY, euler, heading
from sitl.flight.reference import vector
from sitl.links.frames import Payload, pack
from sitl.vehicle import Vehicle

NAN = math.nan


def compass(yaw: float) -> float:
    """Yaw [rad] as degrees in [0, 360)."""
    return math.degrees(yaw) % 360.0


def int16(value: float) -> int:
    """Rounded, and held inside the field: what is beyond it must not stop the vehicle."""
    return round(min(max(value, -32768.0), 32767.0))


def millivolts(volts: float) -> int:
    """For an uint16 field, whose last value means unknown."""
    return min(round(volts * 1000.0), 65534)


def heartbeat(v: Vehicle) -> Payload | None:
    if v.now_ms < v.personality.timeline.heartbeat_ms:
        return None
    commander = v.commander
    return pack(
        "HEARTBEAT",
        type=v.personality.vehicle_type(v.parameters),
        autopilot=v.personality.autopilot,
        base_mode=commander.base_mode,
        custom_mode=commander.custom_mode,
        system_status=int(commander.system_status),
        mavlink_version=3,
    )


def current_mode(v: Vehicle) -> Payload:
    return pack(
        "CURRENT_MODE",
        standard_mode=0,
        custom_mode=v.commander.custom_mode,
        intended_custom_mode=v.commander.intended_custom_mode,
    )


def sys_status(v: Vehicle) -> Payload:
    present, enabled, health = v.personality.sensors(v)
    battery = v.commander.battery
    volts = battery.voltage
    return pack(
        "SYS_STATUS",
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=enabled,
        onboard_control_sensors_health=health,
        load=100,
        voltage_battery=millivolts(volts),
        current_battery=int16(battery.current_a * 100.0),
        battery_remaining=math.ceil(battery.remaining * 100.0),
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
        onboard_control_sensors_present_extended=0,
        onboard_control_sensors_enabled_extended=0,
        onboard_control_sensors_health_extended=1,
    )


def battery_status(v: Vehicle) -> Payload:
    battery = v.commander.battery
    volts = battery.voltage
    return pack(
        "BATTERY_STATUS",
        id=0,
        battery_function=1,
        type=1,
        temperature=32767,
        voltages=[millivolts(volts)] + [65535] * 9,
        current_battery=int16(battery.current_a * 100.0),
        current_consumed=round((1.0 - battery.remaining) * battery.pack.capacity_mah),
        energy_consumed=round(battery.used_j / 100.0),
        battery_remaining=math.ceil(battery.remaining * 100.0),
        time_remaining=0,
        charge_state=1 + battery.level,
        voltages_ext=[0, 0, 0, 0],
        mode=0,
        fault_bitmask=0,
    )


def extended_sys_state(v: Vehicle) -> Payload:
    return pack("EXTENDED_SYS_STATE", vtol_state=0, landed_state=int(v.commander.landed))


def attitude(v: Vehicle) -> Payload:
    roll, pitch, yaw = euler(v.body.attitude)
    p, q, r = vector(v.body.rates)
    return pack(
        "ATTITUDE",
        time_boot_ms=v.now_ms,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        rollspeed=p,
        pitchspeed=q,
        yawspeed=r,
    )


def attitude_quaternion(v: Vehicle) -> Payload:
    w, x, y, z = v.body.attitude.tolist()
    p, q, r = vector(v.body.rates)
    return pack(
        "ATTITUDE_QUATERNION",
        time_boot_ms=v.now_ms,
        q1=w,
        q2=x,
        q3=y,
        q4=z,
        rollspeed=p,
        pitchspeed=q,
        yawspeed=r,
        repr_offset_q=[0.0, 0.0, 0.0, 0.0],
    )


def local_position_ned(v: Vehicle) -> Payload | None:
    if not v.located:
        return None
    x, y, z = vector(v.body.position)
    vx, vy, vz = vector(v.body.velocity)
    return pack("LOCAL_POSITION_NED", time_boot_ms=v.now_ms, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)


def global_position_int(v: Vehicle) -> Payload | None:
    return global_position(v) if v.located else None


def global_position(v: Vehicle) -> Payload:
    """GLOBAL_POSITION_INT, whatever the estimator says."""
    x, y, z = vector(v.body.position)
    vx, vy, vz = vector(v.body.velocity)
    latitude, longitude = v.origin.globe(x, y)
    home_down = v.commander.home[2] if v.commander.home is not None else 0.0
    return pack(
        "GLOBAL_POSITION_INT",
        time_boot_ms=v.now_ms,
        lat=round(latitude * 1e7),
        lon=round(longitude * 1e7),
        alt=round((v.origin.altitude - z) * 1000.0),
        relative_alt=round((home_down - z) * 1000.0),
        vx=int16(vx * 100.0),
        vy=int16(vy * 100.0),
        vz=int16(vz * 100.0),
        hdg=int(compass(heading(v.body.attitude)) * 100.0),
    )


def odometry(v: Vehicle) -> Payload | None:
    if not v.located:
        return None
    x, y, z = vector(v.body.position)
    vx, vy, vz = vector(v.body.velocity)
    p, q, r = vector(v.body.rates)
    return pack(
        "ODOMETRY",
        time_usec=v.now_ms * 1000,
        frame_id=1,
        child_frame_id=1,
        x=x,
        y=y,
        z=z,
        q=v.body.attitude.tolist(),
        vx=vx,
        vy=vy,
        vz=vz,
        rollspeed=p,
        pitchspeed=q,
        yawspeed=r,
        pose_covariance=[NAN] * 21,
        velocity_covariance=[NAN] * 21,
        reset_counter=0,
        estimator_type=8,
        quality=0,
    )


def altitude(v: Vehicle) -> Payload | None:
    if not v.located:
        return None
    up = -float(v.body.position[2])
    home_up = -v.commander.home[2] if v.commander.home is not None else 0.0
    return pack(
        "ALTITUDE",
        time_usec=v.now_ms * 1000,
        altitude_monotonic=v.origin.altitude + up,
        altitude_amsl=v.origin.altitude + up,
        altitude_local=up,
        altitude_relative=up - home_up,
        altitude_terrain=0.0,
        bottom_clearance=up,
    )


def vfr_hud(v: Vehicle) -> Payload | None:
    if not v.located:
        return None
    vx, vy, vz = vector(v.body.velocity)
    return pack(
        "VFR_HUD",
        airspeed=0.0,
        groundspeed=math.hypot(vx, vy),
        heading=int(compass(heading(v.body.attitude))),
        throttle=round(100.0 * float(np.linalg.norm(v.controller.thrust_setpoint))),
        alt=v.origin.altitude - float(v.body.position[2]),
        climb=-vz,
    )


def gps_raw_int(v: Vehicle) -> Payload:
    """The true place with noise; zeros without a fix."""
    if not v.model.estimator.gps:
        return no_fix(v)
    x, y, z = v.measured(v.model.truth.position, sensors.GPS)
    vx, vy, _ = vector(v.model.truth.velocity)
    latitude, longitude = v.origin.globe(x, y)
    return pack(
        "GPS_RAW_INT",
        time_usec=v.now_ms * 1000,
        fix_type=3,
        lat=round(latitude * 1e7),
        lon=round(longitude * 1e7),
        alt=round((v.origin.altitude - z) * 1000.0),
        eph=70,
        epv=110,
        vel=int16(math.hypot(vx, vy) * 100.0),
        cog=int(compass(math.atan2(vy, vx)) * 100.0),
        satellites_visible=10,
        alt_ellipsoid=round((v.origin.altitude - z) * 1000.0),
        h_acc=900,
        v_acc=1780,
        vel_acc=400,
        hdg_acc=0,
        yaw=0,
    )


def no_fix(v: Vehicle) -> Payload:
    """GPS_RAW_INT of a receiver that is there and sees nothing."""
    zero = dict.fromkeys(("lat", "lon", "alt", "vel", "cog", "alt_ellipsoid", "vel_acc", "hdg_acc", "yaw"), 0)
    return pack(
        "GPS_RAW_INT",
        time_usec=v.now_ms * 1000,
        fix_type=1,
        eph=65535,
        epv=65535,
        satellites_visible=0,
        h_acc=0,
        v_acc=0,
        **zero,
    )


def pressure(v: Vehicle) -> float:
    """What the barometer shows [hPa], with noise."""
    amsl = v.origin.altitude - float(v.model.truth.position[2])
    true: float = 1013.25 * max(1.0 - 2.25577e-5 * amsl, 0.0) ** 5.25588
    return true + v.deviation(sensors.BAROMETER) * float(v.noise.standard_normal())


def highres_imu(v: Vehicle) -> Payload:
    force = v.measured(v.body.specific_force, sensors.ACCELEROMETER)
    rates = v.measured(v.body.rates, sensors.GYRO)
    amsl = v.origin.altitude - float(v.body.position[2])
    yaw = heading(v.body.attitude)
    return pack(
        "HIGHRES_IMU",
        time_usec=v.now_ms * 1000,
        xacc=force[0],
        yacc=force[1],
        zacc=force[2],
        xgyro=rates[0],
        ygyro=rates[1],
        zgyro=rates[2],
        xmag=0.21 * math.cos(yaw),
        ymag=-0.21 * math.sin(yaw),
        zmag=0.43,
        abs_pressure=pressure(v),
        diff_pressure=0.0,
        pressure_alt=amsl,
        temperature=15.0 - 0.0065 * amsl,
        fields_updated=0x1BFF,
        id=0,
    )


def servo_output_raw(v: Vehicle) -> Payload:
    pulses = [round(1000.0 + 1000.0 * u) for u in v.controller.commands.tolist()] if v.commander.armed else [900] * 4
    outputs = {f"servo{i + 1}_raw": pulse for i, pulse in enumerate(pulses + [900] * 12)}
    return pack("SERVO_OUTPUT_RAW", time_usec=v.now_ms * 1000 & 0xFFFFFFFF, port=0, **outputs)


def attitude_target(v: Vehicle) -> Payload:
    p, q, r = vector(v.controller.rate_setpoint)
    return pack(
        "ATTITUDE_TARGET",
        time_boot_ms=v.now_ms,
        type_mask=0,
        q=v.controller.attitude_setpoint.tolist(),
        body_roll_rate=p,
        body_pitch_rate=q,
        body_yaw_rate=r,
        thrust=float(np.linalg.norm(v.controller.thrust_setpoint)),
    )


def position_target_local_ned(v: Vehicle) -> Payload:
    vx, vy, vz = vector(v.controller.velocity_setpoint)
    ax, ay, az = vector(v.controller.acceleration_setpoint)
    return pack(
        "POSITION_TARGET_LOCAL_NED",
        time_boot_ms=v.now_ms,
        coordinate_frame=1,
        type_mask=7,
        x=NAN,
        y=NAN,
        z=NAN,
        vx=vx,
        vy=vy,
        vz=vz,
        afx=ax,
        afy=ay,
        afz=az,
        yaw=euler(v.controller.attitude_setpoint)[2],
        yaw_rate=0.0,
    )


def system_time(v: Vehicle) -> Payload:
    return pack("SYSTEM_TIME", time_unix_usec=v.epoch_us + v.now_ms * 1000, time_boot_ms=v.now_ms)


def home_position(v: Vehicle, q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)) -> Payload | None:
    """`q`: the ground's attitude that the autopilot tells."""
    home = v.commander.home
    if home is None:
        return None
    latitude, longitude = v.origin.globe(home[0], home[1])
    return pack(
        "HOME_POSITION",
        latitude=round(latitude * 1e7),
        longitude=round(longitude * 1e7),
        altitude=round((v.origin.altitude - home[2]) * 1000.0),
        x=home[0],
        y=home[1],
        z=home[2],
        q=q,
        approach_x=0.0,
        approach_y=0.0,
        approach_z=0.0,
        time_usec=v.now_ms * 1000,
    )


def gps_global_origin(v: Vehicle) -> Payload | None:
    return global_origin(v) if v.located else None


def global_origin(v: Vehicle) -> Payload:
    """GPS_GLOBAL_ORIGIN, once it is known."""
    return pack(
        "GPS_GLOBAL_ORIGIN",
        latitude=round(v.origin.latitude * 1e7),
        longitude=round(v.origin.longitude * 1e7),
        altitude=round(v.origin.altitude * 1000.0),
        time_usec=v.now_ms * 1000,
    )


def autopilot_version(v: Vehicle) -> Payload:
    version = v.personality.version
    return pack(
        "AUTOPILOT_VERSION",
        capabilities=v.personality.capabilities,
        uid=1,
        flight_sw_version=version.flight,
        middleware_sw_version=version.middleware,
        os_sw_version=version.operating_system,
        board_version=version.board,
        vendor_id=0,
        product_id=0,
        flight_custom_version=list(version.commit.ljust(8, b"\0")[:8]),
        middleware_custom_version=[0] * 8,
        os_custom_version=[0] * 8,
        uid2=[0] * 18,
    )


def protocol_version(_: Vehicle) -> Payload:
    """MAVLink 2.0, spoken from 1.0 on; laid out here, since pymavlink no longer knows it."""
    return Payload(300, bytes((217,)), struct.pack("<HHH", 200, 100, 200))


def hil_state_quaternion(v: Vehicle) -> Payload:
    """The true state, without any sensor's or estimator's error."""
    true = v.model.truth
    x, y, z = vector(true.position)
    vx, vy, vz = (int16(speed * 100.0) for speed in vector(true.velocity))
    p, q, r = vector(true.rates)
    ax, ay, az = (int16(force / GRAVITY * 1000.0) for force in vector(true.specific_force))
    latitude, longitude = v.origin.globe(x, y)
    airspeed = min(round(float(np.linalg.norm(true.velocity - true.air)) * 100.0), 65535)
    return pack(
        "HIL_STATE_QUATERNION",
        time_usec=v.now_ms * 1000,
        attitude_quaternion=v.body.attitude.tolist(),
        rollspeed=p,
        pitchspeed=q,
        yawspeed=r,
        lat=round(latitude * 1e7),
        lon=round(longitude * 1e7),
        alt=round((v.origin.altitude - z) * 1000.0),
        vx=vx,
        vy=vy,
        vz=vz,
        ind_airspeed=airspeed,
        true_airspeed=airspeed,
        xacc=ax,
        yacc=ay,
        zacc=az,
    )


def mission_current(v: Vehicle) -> Payload:
    """mission_state: 2 not begun, 3 flown, 4 paused, 5 done; mission_mode: 1 in mission mode, 2 in another.

    Without a mission PX4 was recorded to leave both unknown; ArduPilot says 1, and does not count its home.
    """
    plans = v.commander.plans
    if not plans.flyable:
        state = int(v.personality.missions.home_first)
        return pack("MISSION_CURRENT", seq=0, total=65535, mission_state=state, mission_mode=0)
    flown = v.commander.armed and v.commander.in_mission
    state = 5 if plans.finished else 3 if flown else 4 if plans.begun else 2
    mode = 1 if v.commander.in_mission else 2
    return pack(
        "MISSION_CURRENT",
        seq=plans.current,
        total=len(plans.mission) - plans.first,
        mission_state=state,
        mission_mode=mode,
    )


MESSAGES: dict[str, Callable[[Vehicle], Payload | None]] = {
    function.__name__.upper(): function
    for function in (
        heartbeat,
        current_mode,
        sys_status,
        battery_status,
        extended_sys_state,
        attitude,
        attitude_quaternion,
        local_position_ned,
        global_position_int,
        odometry,
        altitude,
        vfr_hud,
        gps_raw_int,
        highres_imu,
        servo_output_raw,
        attitude_target,
        position_target_local_ned,
        system_time,
        home_position,
        gps_global_origin,
        autopilot_version,
        mission_current,
        protocol_version,
        hil_state_quaternion,
    )
}
"""What every personality can send, by message name."""


TEXT_CHUNK = 50
"""Bytes of text in one STATUSTEXT."""


def statustexts(text: str, severity: int, number: int) -> list[Payload]:
    """A STATUSTEXT in chunks of 50 characters; a full last chunk is followed by an empty one, which ends it."""
    raw = text.encode("ascii", "replace")
    chunks = [raw[i : i + TEXT_CHUNK] for i in range(0, len(raw) + 1, TEXT_CHUNK)]
    return [
        pack("STATUSTEXT", severity=severity, text=chunk, id=number, chunk_seq=sequence)
        for sequence, chunk in enumerate(chunks)
    ]
