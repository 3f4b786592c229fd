"""Time per scan and accuracy of the odometry on simulated flights through a pillar field and a hall.

Run from the repository's root: ``python -m benchmarks.odometry_scan_time [--duration 60] [--json]``.
"""

import argparse
import json
import time
from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.synthetic_flights import T_BODY_LIDAR, T_LIDAR_IMU, Course, field, fly, hall
from companion import compiled
from companion.clock import SystemClock
from companion.messages import LidarScan, Odometry, RegisteredScan
from companion.perception.odometry import trajectory_error
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings


@dataclass(frozen=True)
class Figures:
    """Results of one flight."""

    course: str
    duration_s: float
    path_m: float
    scans: int
    returns_per_scan: int
    scan_ms_median: float
    scan_ms_p99: float
    scan_cpu_ms_median: float
    scan_cpu_ms_p99: float
    sample_cpu_us_mean: float
    ape_rmse_cm: float
    ape_max_cm: float
    rotation_rmse_deg: float
    rpe_10m_cm: float
    drift_percent: float
    velocity_rmse: float
    worst_quality: int


def measure(name: str, course: Course, duration_s: float, seed: int) -> Figures:
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
        before_ns, cpu_before_ns = clock.now_ns(), time.thread_time_ns()
        outputs = lio.handle(event)
        taken_ns, cpu_ns = clock.now_ns() - before_ns, time.thread_time_ns() - cpu_before_ns
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
    return Figures(
        course=name,
        duration_s=duration_s,
        path_m=round(float(np.linalg.norm(np.diff(p_true, axis=0), axis=1).sum()), 1),
        scans=len(registered),
        returns_per_scan=round(
            float(np.mean([len(e.points_lidar) for e in flight.events if isinstance(e, LidarScan)]))
        ),
        scan_ms_median=round(float(np.median(scan_ns)) * 1e-6, 2),
        scan_ms_p99=round(float(np.percentile(scan_ns, 99)) * 1e-6, 2),
        scan_cpu_ms_median=round(float(np.median(scan_cpu_ns)) * 1e-6, 2),
        scan_cpu_ms_p99=round(float(np.percentile(scan_cpu_ns, 99)) * 1e-6, 2),
        sample_cpu_us_mean=round(float(np.mean(sample_cpu_ns)) * 1e-3, 1),
        ape_rmse_cm=round(100.0 * ape.rmse_m, 2),
        ape_max_cm=round(100.0 * ape.max_m, 2),
        rotation_rmse_deg=round(ape.rotation_rmse_deg, 3),
        rpe_10m_cm=round(100.0 * trajectory_error.relative_error(p, q, p_true, q_true, 10.0).rmse_m, 2),
        drift_percent=round(trajectory_error.drift_percent(p, q, p_true, q_true), 3),
        velocity_rmse=round(float(np.sqrt(np.mean(np.sum((v - v_true) ** 2, axis=1)))), 3),
        worst_quality=min(entry.quality for entry in published),
    )


def main() -> None:
    """Measure both courses and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=60.0, help="seconds per flight")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print one JSON object per line")
    options = parser.parse_args()
    compiled.warm_up()
    courses = {"pillar field": field(np.random.default_rng(options.seed)), "hall": hall()}
    for name, course in courses.items():
        figures = measure(name, course, options.duration, options.seed)
        if options.json:
            print(json.dumps(asdict(figures)))
            continue
        print(f"{figures.course}: {figures.path_m} m, {figures.scans} scans")
        for key, value in asdict(figures).items():
            print(f"  {key:20} {value}")


if __name__ == "__main__":
    main()
