"""A made-up flight whose numbers are known: climb, a bend between pillars, a short hold, landing."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from companion.geometry import rotation
from companion.logs import channels
from companion.logs.records import StampedPose, Statistics
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import (
    Authorisation,
    Datagram,
    FlightState,
    FloatArray,
    LandedState,
    ModeRequest,
    Odometry,
    OdometryStatus,
    PlanUpdate,
    RegisteredScan,
    Setpoint,
    Severity,
    StateChange,
    StatusText,
    Tick,
    VehicleMode,
    VehicleState,
)
from tests.logs.samples import METADATA

DURATION_S = 31.0
LENGTH_M = 20.0
HEIGHT_M = 1.5
LATENCY_MS = 40.0
GAP_MS = 180.0
DRIFT = 0.01
YAW_WORLD = 0.6
ORIGIN_WORLD = np.array([3.0, -2.0, 0.1])
GOAL_MAP = np.array([LENGTH_M, 0.0, HEIGHT_M])
PILLARS = ((4.0, 0.4), (9.0, 3.6), (12.0, 0.6), (16.5, 1.2), (7.0, -2.5), (18.0, -3.4))
PILLAR_RADIUS_M = 0.3
LOST_PACKETS = 120

_MODES = (
    (0.0, VehicleMode.POSITION),
    (5.6, VehicleMode.OFFBOARD),
    (27.2, VehicleMode.LAND),
)
_STATES = (
    (1.0, FlightState.STANDBY, "odometry and autopilot ready"),
    (4.0, FlightState.READY, "airborne, waiting for authorisation"),
    (5.0, FlightState.ENGAGING, "authorised"),
    (5.6, FlightState.ACTIVE, "autopilot is in OFFBOARD"),
    (15.0, FlightState.HOLDING, "odometry quality 20 below 30"),
    (15.6, FlightState.ACTIVE, "odometry usable again"),
    (27.0, FlightState.LANDING, "mission finished"),
    (30.5, FlightState.DONE, "landed and disarmed"),
)


def _ease(t: float, start: float, end: float) -> tuple[float, float]:
    """Return a smooth step from 0 to 1 and its rate per second."""
    x = min(max((t - start) / (end - start), 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / (end - start)


def true_state(t: float) -> tuple[FloatArray, FloatArray]:
    """Return true position and velocity in the map."""
    up, up_rate = _ease(t, 2.0, 5.0)
    down, down_rate = _ease(t, 27.2, 30.0)
    along, rate = _ease(t, 6.0, 26.0)
    angle = 2.0 * np.pi * along
    p = np.array([LENGTH_M * along, 2.0 * np.sin(angle), HEIGHT_M * (up - down)])
    v = np.array([LENGTH_M * rate, 4.0 * np.pi * np.cos(angle) * rate, HEIGHT_M * (up_rate - down_rate)])
    return p, v


def estimate(t: float, t_ns: int) -> Odometry:
    """Return the odometry: the truth, drifting sideways by `DRIFT` of the way along x."""
    p, v = true_state(t)
    holding = 15.0 <= t < 15.6
    status = OdometryStatus.DEGRADED if holding else OdometryStatus.TRACKING
    if t < 1.0:
        status = OdometryStatus.INITIALISING
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=t_ns - 7_000_000,
        p_map=p + np.array([0.0, DRIFT * p[0], 0.0]),
        q_map_body=rotation.from_yaw(0.2 * np.sin(t)),
        v_map=v,
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6) * (0.01 + 1e-3 * t) ** 2,
        covariance_velocity=np.eye(3) * 1e-4,
        quality=20 if holding else 92,
        reset_counter=0,
        status=status,
        reason="few points" if holding else "",
    )


def vehicle(t: float, t_ns: int) -> VehicleState:
    """Return what the autopilot says."""
    p, v = true_state(t - 0.05)
    mode = [mode for start, mode in _MODES if t >= start][-1]
    in_air = 2.2 <= t < 30.0
    return VehicleState(
        t_ns=t_ns,
        connected=True,
        armed=1.5 <= t < 30.3,
        mode=mode,
        landed=LandedState.IN_AIR if in_air else LandedState.ON_GROUND,
        failsafe=False,
        t_local_ns=t_ns,
        p_map=p,
        v_map=v,
        q_map_body=rotation.IDENTITY,
        estimator_reset_counter=0,
        mode_changes=0,
    )


def surroundings() -> FloatArray:
    """Return points on the pillars and on the ground."""
    rng = np.random.default_rng(4)
    parts = []
    for x, y in PILLARS:
        angle = rng.uniform(0.0, 2.0 * np.pi, 250)
        ring = np.stack([x + PILLAR_RADIUS_M * np.cos(angle), y + PILLAR_RADIUS_M * np.sin(angle)], axis=-1)
        parts.append(np.column_stack([ring, rng.uniform(0.0, 3.0, 250)]))
    parts.append(np.column_stack([rng.uniform([-5.0, -8.0], [25.0, 8.0], (1500, 2)), np.zeros(1500)]))
    points: FloatArray = np.concatenate(parts)
    return points


def write_flight(path: Path, *, raw: bool = False, vehicle_name: str = METADATA.vehicle) -> None:
    """Record the flight; `raw` adds LiDAR datagrams of noise."""
    log = FlightLog(path, LogSettings(), replace(METADATA, vehicle=vehicle_name), threaded=False)
    points = surroundings()
    states = list(_STATES)
    state = FlightState.STARTING
    lost = 0
    for step in range(round(DURATION_S * 50) + 1):
        t_ns = step * 20_000_000
        t = t_ns * 1e-9
        if raw:
            log.record(Datagram(t_ns, ("127.0.0.2", 56300), ("127.0.0.1", 56301), bytes(1380)), t_ns)
        if step % 5 == 2 and step > 5:
            # The scan's last packet came 40 ms ago; its estimate is known now.
            scan_ns = t_ns - round(LATENCY_MS * 1e6)
            odometry = estimate(scan_ns * 1e-9, scan_ns)
            log.record(odometry, t_ns)
            near = points[np.linalg.norm(points[:, :2] - odometry.p_map[:2], axis=1) < 8.0]
            reflectivity = np.full(len(near), 40, dtype=np.uint8)
            ages_ns = np.zeros(len(near), np.int32)
            scan = RegisteredScan(scan_ns, step, near.astype(np.float32), reflectivity, odometry, ages_ns)
            log.record(scan, t_ns)
            p, _ = true_state(scan_ns * 1e-9)
            world = ORIGIN_WORLD + rotation.rotate(rotation.from_yaw(YAW_WORLD), p)
            q_world = rotation.multiply(rotation.from_yaw(YAW_WORLD), odometry.q_map_body)
            log.write(channels.TRUTH, StampedPose(scan_ns, "world", world, q_world), t_ns)
        log.record(vehicle(t, t_ns), t_ns)
        log.record(Tick(t_ns), t_ns)
        while states and t >= states[0][0] - 1e-9:
            _, current, reason = states.pop(0)
            if current is FlightState.ENGAGING:
                log.record(Authorisation(t_ns, True, "ground_station"), t_ns)
                log.record(ModeRequest(t_ns, VehicleMode.OFFBOARD), t_ns)
            log.record(StateChange(t_ns, state, current, reason), t_ns)
            severity = Severity.WARNING if current is FlightState.HOLDING else Severity.INFO
            log.record(StatusText(t_ns, severity, f"CMP: {current.value}: {reason}"), t_ns)
            state = current
        _record_commands(log, step, t, t_ns, holding=state is FlightState.HOLDING)
        if step % 50 == 0:
            lost += 60 if 10.0 <= t < 12.0 else 0
            values = {"packets": 2083 * step // 50, "lost": lost, "clock_offset_ns": 7_000_000 + 200 * step}
            log.record(Statistics(t_ns, "lidar", values), t_ns)
    log.close()


def _record_commands(log: FlightLog, step: int, t: float, t_ns: int, *, holding: bool) -> None:
    """Record setpoint and plan; one pause of `GAP_MS` at 20 s."""
    if 5.0 <= t < 27.2 and not 20.001 < t < 20.179 - 0.02:
        scan_ns = ((step - 2) // 5 * 5) * 20_000_000
        _, v = true_state(t + 0.1)
        v_map = np.zeros(3) if holding else v
        reason = "hold: odometry quality" if holding else "follow path"
        log.record(Setpoint(t_ns, t_ns - 10_000_000, scan_ns, v_map, 0.05, reason), t_ns)
    if 6.0 <= t <= 26.6 and step % 10 == 0:
        ahead = np.array([true_state(t + later)[0] for later in np.linspace(0.0, 3.0, 10)])
        status = "arrived" if t >= 26.4 else "planned"
        log.record(PlanUpdate(t_ns, ahead + np.array([0.0, 0.05, 0.0]), GOAL_MAP, 0, status), t_ns)
