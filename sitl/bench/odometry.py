"""Time per scan and accuracy of the odometry on simulated flights through a pillar field and a hall."""

from dataclasses import asdict, dataclass

import numpy as np

from companion.clock import SystemClock
from companion.geometry import trajectory_error
from companion.messages import LidarScan, Odometry, RegisteredScan
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from sitl.bench.synthetic_flights import T_BODY_LIDAR, T_LIDAR_IMU, Course, field, fly, hall

SYSTEM = "companion"


@dataclass(frozen=True)
class Row:
    """Result of one flight; times are per scan."""

    world: str
    system: str
    ape_rmse_m: float
    drift_percent: float
    attitude_rmse_deg: float
    velocity_rmse_mps: float
    ms_median: float
    ms_p99: float
    cpu_ms_median: float
    cpu_ms_p99: float
    imu_sample_cpu_us: float
    path_m: float
    returns_per_scan: int


def _row(name: str, course: Course, duration_s: float, seed: int) -> Row:
    """Fly one course and compare odometry with truth."""
    flight = fly(course, duration_s, np.random.default_rng(seed))
    lio = LidarInertialOdometry(OdometrySettings(), T_BODY_LIDAR, T_LIDAR_IMU)
    clock = SystemClock()
    scan_ns: list[int] = []
    scan_cpu_ns: list[int] = []
    sample_cpu_ns: list[int] = []
    registered: list[Odometry] = []
    published: list[Odometry] = []
    for event in flight.events:
        before_ns, cpu_before_ns = clock.now_ns(), clock.thread_cpu_ns()
        outputs = lio.handle(event)
        taken_ns, cpu_ns = clock.now_ns() - before_ns, clock.thread_cpu_ns() - cpu_before_ns
        poses = [output.odometry for output in outputs if isinstance(output, RegisteredScan)]
        if poses:
            scan_ns.append(taken_ns)
            scan_cpu_ns.append(cpu_ns)
        else:
            sample_cpu_ns.append(cpu_ns)
        registered += poses
        published += [output for output in outputs if isinstance(output, Odometry) and output.quality > 0]
    p_true, q_true, _ = flight.truth(np.array([entry.t_sensor_ns for entry in registered]))
    p = np.array([entry.p_map for entry in registered])
    q = np.array([entry.q_map_body for entry in registered])
    ape = trajectory_error.absolute_error(p, q, p_true, q_true)
    T_true_estimated = trajectory_error.align(p, p_true)
    _, _, v_true = flight.truth(np.array([entry.t_sensor_ns for entry in published]))
    v = T_true_estimated.transform(np.array([entry.v_map for entry in published])) - T_true_estimated.p
    path_m = float(np.linalg.norm(np.diff(p_true, axis=0), axis=1).sum())
    returns = [len(event.points_lidar) for event in flight.events if isinstance(event, LidarScan)]
    return Row(
        world=name,
        system=SYSTEM,
        ape_rmse_m=round(ape.rmse_m, 4),
        drift_percent=round(trajectory_error.drift_percent(p, q, p_true, q_true), 3),
        attitude_rmse_deg=round(ape.rotation_rmse_deg, 3),
        velocity_rmse_mps=round(float(np.sqrt(np.mean(np.sum((v - v_true) ** 2, axis=1)))), 3),
        ms_median=round(1e-6 * float(np.median(scan_ns)), 2),
        ms_p99=round(1e-6 * float(np.percentile(scan_ns, 99)), 2),
        cpu_ms_median=round(1e-6 * float(np.median(scan_cpu_ns)), 2),
        cpu_ms_p99=round(1e-6 * float(np.percentile(scan_cpu_ns, 99)), 2),
        imu_sample_cpu_us=round(1e-3 * float(np.mean(sample_cpu_ns)), 1),
        path_m=round(path_m, 1),
        returns_per_scan=round(float(np.mean(returns))),
    )


def measure(duration_s: float = 60.0, seed: int = 1) -> list[dict[str, object]]:
    """Fly every course and return one row each."""
    courses = {"pillars": field(np.random.default_rng(seed)), "hall": hall()}
    return [asdict(_row(name, course, duration_s, seed)) for name, course in courses.items()]
