"""Content of the messages that the emulated autopilot sends without being asked for each one.

Every function returns the fields in the order of the message's definition, or None while there is nothing
to send. Axes change from z-up to z-down here.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sitl.autopilot import Autopilot
from sitl.autopilot_filter import rotate_by
from sitl.autopilot_inputs import Quaternion
from sitl.mavlink_inbound import LOCAL_NED, flipped
from sitl.mavlink_modes import base_mode, custom_mode, landed_code, standard_mode

Fields = tuple[Any, ...]
_NAN = math.nan
_ORIGIN_LATITUDE_DEG, _ORIGIN_LONGITUDE_DEG, _ORIGIN_ALTITUDE_M = 47.3977432, 8.5455939, 489.4
_METRES_PER_DEGREE = 111_319.5
_CALENDAR_AT_BOOT_US = 1_767_225_600_000_000
_GRAVITY = 9.81
_FULL_VOLTAGE_MV, _EMPTY_VOLTAGE_MV = 16_200, 14_000
_PWM_STOPPED, _PWM_FLYING = 900, 1500


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The autopilot at the boot time of one transmission.

    Attributes:
        autopilot: the state machine.
        boot_us: microseconds since boot on the autopilot's own clock.
        ping_sequence: number of the next PING.
    """

    autopilot: Autopilot
    boot_us: int
    ping_sequence: int

    @property
    def boot_ms(self) -> int:
        """Milliseconds since boot."""
        return self.boot_us // 1000 & 0xFFFFFFFF


def heartbeat(s: Snapshot) -> Fields:
    """HEARTBEAT of a quadrotor with PX4."""
    autopilot = s.autopilot
    status = (5 if autopilot.failsafe else 4) if autopilot.armed else 3 if autopilot.ready_to_arm else 0
    mode = autopilot.mode
    return (2, 12, base_mode(mode, autopilot.armed), custom_mode(mode), status, 3)


def sys_status(s: Snapshot) -> Fields:
    """SYS_STATUS with the sensor bits measured with and without GNSS."""
    autopilot = s.autopilot
    conditions = autopilot.conditions()
    gnss = 0x20 if conditions.global_position else 0
    health = 0x320883F | (0x4000 if conditions.local_position else 0)
    if autopilot.armed or autopilot.ready_to_arm:
        health |= 0x10000000
    if conditions.manual_control:
        health |= 0x10000
    remaining = round(100.0 * autopilot.battery)
    present, enabled = 0x300C00F | gnss, 0x301C00F | gnss
    return (present, enabled, health, 180, _voltage_mv(s), -1, remaining, 0, 0, 0, 0, 0, 0, 0, 0, 1)


def battery_status(s: Snapshot) -> Fields:
    """BATTERY_STATUS of a four-cell pack."""
    voltages = (_voltage_mv(s), *(65535,) * 9)
    remaining = round(100.0 * s.autopilot.battery)
    return (0, 1, 1, 32767, voltages, -1, 0, -1, remaining, 0, 1, (0, 0, 0, 0), 0, 0)


def system_time(s: Snapshot) -> Fields:
    """SYSTEM_TIME with a fixed calendar time at boot."""
    return (_CALENDAR_AT_BOOT_US + s.boot_us, s.boot_ms)


def ping(s: Snapshot) -> Fields:
    """PING to everybody."""
    return (s.boot_us, s.ping_sequence & 0xFFFFFFFF, 0, 0)


def attitude(s: Snapshot) -> Fields:
    """ATTITUDE, z-down."""
    w, x, y, z = _q_ned_frd(s)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return (s.boot_ms, roll, pitch, yaw, *flipped(*s.autopilot.omega_body))


def attitude_quaternion(s: Snapshot) -> Fields:
    """ATTITUDE_QUATERNION, z-down."""
    return (s.boot_ms, *_q_ned_frd(s), *flipped(*s.autopilot.omega_body), (0.0, 0.0, 0.0, 0.0))


def local_position_ned(s: Snapshot) -> Fields:
    """LOCAL_POSITION_NED, sent whether valid or not."""
    estimator = s.autopilot.estimator
    return (s.boot_ms, *flipped(*estimator.p_local), *flipped(*estimator.v_local))


def odometry(s: Snapshot) -> Fields:
    """ODOMETRY with position and velocity both in the local frame; quality is always 0."""
    estimator = s.autopilot.estimator
    motion = estimator.motion
    position, velocity = estimator.position_variance, estimator.velocity_variance
    pose = [0.0] * 21
    pose[0] = pose[6] = position
    pose[11] = motion.vertical.position
    pose[15] = pose[18] = 5.0e-5
    pose[20] = motion.yaw_variance
    speed = [0.0] * 21
    speed[0] = speed[6] = velocity
    speed[11] = motion.vertical.velocity
    return (
        s.boot_us,
        LOCAL_NED,
        LOCAL_NED,
        *flipped(*estimator.p_local),
        _q_ned_frd(s),
        *flipped(*estimator.v_local),
        *flipped(*s.autopilot.omega_body),
        pose,
        speed,
        motion.reset_counter & 0xFF,
        8,
        0,
    )


def highres_imu(s: Snapshot) -> Fields:
    """HIGHRES_IMU; the magnetic field is a constant of the place, turned into the body."""
    w, x, y, z = _q_ned_frd(s)
    back = (w, -x, -y, -z)
    accel = flipped(*s.autopilot.specific_force_body)
    field = rotate_by(back, (0.21, 0.01, 0.43))
    pressure = 955.8 - 0.113 * s.autopilot.estimator.p_local[2]
    return (
        s.boot_us,
        *accel,
        *flipped(*s.autopilot.omega_body),
        *field,
        pressure,
        0.0,
        _altitude(s),
        15.0,
        63,
        0,
    )


def extended_sys_state(s: Snapshot) -> Fields:
    """EXTENDED_SYS_STATE."""
    return (0, landed_code(s.autopilot.landed_state))


def estimator_status(s: Snapshot) -> Fields:
    """ESTIMATOR_STATUS with the flag patterns measured on the ground, in flight and while coasting."""
    estimator = s.autopilot.estimator
    flags = 0b1100101
    if estimator.velocity_valid:
        flags |= 0b1010
        if estimator.aided:
            flags |= 0b100000000
    if estimator.global_valid:
        flags |= 0b1000010000
    if s.autopilot.landed:
        flags |= 0b10000000
    ratio = 0.02 if estimator.aided else _NAN
    horizontal, vertical = math.sqrt(2.0 * estimator.position_variance), estimator.motion.vertical.position
    return (s.boot_us, flags, ratio, ratio, 0.01, 0.02, 0.01, _NAN, horizontal, math.sqrt(vertical))


def current_mode(s: Snapshot) -> Fields:
    """CURRENT_MODE: what is flown, and what was asked for."""
    autopilot = s.autopilot
    return (standard_mode(autopilot.mode), custom_mode(autopilot.mode), custom_mode(autopilot.user_mode))


def position_target_local_ned(s: Snapshot) -> Fields:
    """POSITION_TARGET_LOCAL_NED: what the position controller follows, z-down."""
    autopilot = s.autopilot
    demand, yaw = autopilot.demand, -autopilot.estimator.yaw
    unknown = (_NAN, _NAN, _NAN)
    if not autopilot.armed:
        return (s.boot_ms, LOCAL_NED, 63, *unknown, *unknown, 0.0, 0.0, 100.0, yaw, 0.0)
    v = flipped(*demand.v_local)
    rate = -demand.yaw_rate
    if not demand.horizontal:
        return (s.boot_ms, LOCAL_NED, 31, *unknown, _NAN, _NAN, v[2], 0.0, 0.0, 0.0, yaw, rate)
    if demand.p_local is None:
        return (s.boot_ms, LOCAL_NED, 7, *unknown, *v, 0.0, 0.0, 0.0, yaw, rate)
    return (s.boot_ms, LOCAL_NED, 0, *flipped(*demand.p_local), *v, 0.0, 0.0, 0.0, yaw, rate)


def attitude_target(s: Snapshot) -> Fields:
    """ATTITUDE_TARGET: level at the present heading, since the inner loops live in the dynamics."""
    thrust = 0.5 if s.autopilot.armed else 0.001
    half = -0.5 * s.autopilot.estimator.yaw
    rate = -s.autopilot.demand.yaw_rate
    return (s.boot_ms, 0, (math.cos(half), 0.0, 0.0, math.sin(half)), 0.0, 0.0, rate, thrust)


def altitude(s: Snapshot) -> Fields:
    """ALTITUDE."""
    z, above_sea = s.autopilot.estimator.p_local[2], _altitude(s)
    return (s.boot_us, above_sea, above_sea, z, z, 0.0, max(z, 0.0))


def vfr_hud(s: Snapshot) -> Fields:
    """VFR_HUD."""
    estimator = s.autopilot.estimator
    v_x, v_y, v_z = estimator.v_local
    heading = round(math.degrees(-estimator.yaw)) % 360
    throttle = 50 if s.autopilot.armed else 0
    return (_NAN, math.hypot(v_x, v_y), heading, throttle, _altitude(s), v_z)


def servo_output_raw(s: Snapshot) -> Fields:
    """SERVO_OUTPUT_RAW: four motors."""
    motor = _PWM_FLYING if s.autopilot.armed and not s.autopilot.landed else _PWM_STOPPED
    return (s.boot_us & 0xFFFFFFFF, 0, *(motor,) * 4, *(_PWM_STOPPED,) * 12)


def distance_sensor(s: Snapshot) -> Fields:
    """DISTANCE_SENSOR looking down."""
    distance_cm = round(100.0 * max(0.0, min(s.autopilot.estimator.p_local[2], 100.0)))
    return (s.boot_ms, 0, 10000, distance_cm, 0, 0, 25, 0, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0), 1)


def global_position_int(s: Snapshot) -> Fields | None:
    """GLOBAL_POSITION_INT, once GNSS has a fix."""
    if not s.autopilot.estimator.global_valid:
        return None
    latitude, longitude = _geographic(s)
    v = [max(-32767, min(32767, round(100.0 * c))) for c in flipped(*s.autopilot.estimator.v_local)]
    heading = round(math.degrees(-s.autopilot.estimator.yaw) * 100.0) % 36000
    relative = round(1000.0 * s.autopilot.estimator.p_local[2])
    return (s.boot_ms, latitude, longitude, round(1000.0 * _altitude(s)), relative, *v, heading)


def gps_raw_int(s: Snapshot) -> Fields | None:
    """GPS_RAW_INT, once GNSS has a fix."""
    if not s.autopilot.estimator.global_valid:
        return None
    latitude, longitude = _geographic(s)
    height = round(1000.0 * _altitude(s))
    speed = min(65534, round(100.0 * math.hypot(*s.autopilot.estimator.v_local[:2])))
    return (s.boot_us, 3, latitude, longitude, height, 70, 110, speed, 0, 10, height, 900, 1780, 400, 0, 0)


def home_position(s: Snapshot) -> Fields | None:
    """HOME_POSITION, once GNSS has a fix."""
    if not s.autopilot.estimator.global_valid:
        return None
    latitude, longitude = round(1e7 * _ORIGIN_LATITUDE_DEG), round(1e7 * _ORIGIN_LONGITUDE_DEG)
    height = round(1000.0 * _ORIGIN_ALTITUDE_M)
    return (latitude, longitude, height, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, s.boot_us)


def vibration(s: Snapshot) -> Fields:
    """VIBRATION."""
    return (s.boot_us, 0.0, 0.01, 0.11, 0, 0, 0)


def mission_current(_: Snapshot) -> Fields:
    """MISSION_CURRENT: there is no mission."""
    return (0, 65535, 1, 2)


def scaled_pressure(s: Snapshot) -> Fields:
    """SCALED_PRESSURE."""
    return (s.boot_ms, 955.8 - 0.113 * s.autopilot.estimator.p_local[2], 0.0, 1182, 0)


def autopilot_version(_: Snapshot) -> Fields:
    """AUTOPILOT_VERSION of a PX4 1.18 development build."""
    commit = (0, 0, 0, 128, 229, 244, 196, 131)
    return (59647, 17957056, 17957056, 101854463, 1, commit, commit, (0,) * 8, 0, 0, 1, (0,) * 18)


BUILDERS: dict[str, Callable[[Snapshot], Fields | None]] = {
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "BATTERY_STATUS": battery_status,
    "SYSTEM_TIME": system_time,
    "PING": ping,
    "ATTITUDE": attitude,
    "ATTITUDE_QUATERNION": attitude_quaternion,
    "LOCAL_POSITION_NED": local_position_ned,
    "ODOMETRY": odometry,
    "HIGHRES_IMU": highres_imu,
    "EXTENDED_SYS_STATE": extended_sys_state,
    "ESTIMATOR_STATUS": estimator_status,
    "CURRENT_MODE": current_mode,
    "POSITION_TARGET_LOCAL_NED": position_target_local_ned,
    "ATTITUDE_TARGET": attitude_target,
    "ALTITUDE": altitude,
    "VFR_HUD": vfr_hud,
    "SERVO_OUTPUT_RAW": servo_output_raw,
    "DISTANCE_SENSOR": distance_sensor,
    "GLOBAL_POSITION_INT": global_position_int,
    "GPS_RAW_INT": gps_raw_int,
    "HOME_POSITION": home_position,
    "VIBRATION": vibration,
    "MISSION_CURRENT": mission_current,
    "SCALED_PRESSURE": scaled_pressure,
    "AUTOPILOT_VERSION": autopilot_version,
}
"""Every message that can be streamed or requested."""


def _q_ned_frd(s: Snapshot) -> Quaternion:
    w, x, y, z = s.autopilot.estimator.q_local_body
    return (w, x, -y, -z)


def _altitude(s: Snapshot) -> float:
    return _ORIGIN_ALTITUDE_M + s.autopilot.estimator.p_local[2]


def _geographic(s: Snapshot) -> tuple[int, int]:
    north, west, _ = s.autopilot.estimator.p_local
    latitude = _ORIGIN_LATITUDE_DEG + north / _METRES_PER_DEGREE
    shrink = math.cos(math.radians(_ORIGIN_LATITUDE_DEG))
    longitude = _ORIGIN_LONGITUDE_DEG - west / (_METRES_PER_DEGREE * shrink)
    return round(1e7 * latitude), round(1e7 * longitude)


def _voltage_mv(s: Snapshot) -> int:
    return round(_EMPTY_VOLTAGE_MV + s.autopilot.battery * (_FULL_VOLTAGE_MV - _EMPTY_VOLTAGE_MV))
