"""A small analytic world, a smooth flight through it, and what a Mid-360-like sensor would report.

The IMU reports the exact rates of the trajectory's splines, lever arm included, plus white noise and
constant biases; every laser slot is cast from the pose at its own firing time.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample, LidarScan

SLOT_NS = 5_000
IMU_PERIOD_NS = 5_000_000
SCAN_NS = 100_000_000
GRAVITY = 9.80665
T_LIDAR_IMU = Pose.of([0.011, 0.02329, -0.04412], [1.0, 0.0, 0.0, 0.0])
T_BODY_LIDAR = Pose.of([0.05, -0.02, 0.08], [1.0, 0.0, 0.0, 0.0])
CLOCK_OFFSET_NS = 5_000_000_000


@dataclass(frozen=True)
class World:
    """Vertical cylinders (x, y, radius, height), boxes (x0, y0, z0, x1, y1, z1) seen from either side."""

    pillars: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))
    boxes: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))
    has_ground: bool = True


def pillar_field(rng: np.random.Generator, count: int = 50, half_size_m: float = 25.0) -> World:
    """Return pillars of 0.2-0.5 m radius and 5 m height on a plane, none near the flight's ring."""
    pillars: list[list[float]] = []
    while len(pillars) < count:
        x, y = rng.uniform(-half_size_m, half_size_m, 2)
        on_path = abs(np.hypot(x, y / 0.7) - 12.0) < 2.5
        if not on_path and all(np.hypot(x - p[0], y - p[1]) > 1.8 for p in pillars):
            pillars.append([x, y, rng.uniform(0.2, 0.5), 5.0])
    return World(pillars=np.array(pillars))


def room() -> World:
    """Return a 16 m x 12 m x 4.5 m hall with boxes standing in it."""
    boxes = [
        [-8.0, -6.0, 0.0, 8.0, 6.0, 4.5],
        [-7.5, -5.5, 0.0, -6.0, -4.0, 2.0],
        [5.5, 3.5, 0.0, 7.0, 5.0, 1.2],
        [-1.0, -0.8, 0.0, 0.8, 0.9, 1.0],
        [5.8, -5.5, 0.0, 7.8, -4.2, 3.0],
        [-7.8, 4.2, 0.0, -6.9, 5.8, 4.5],
    ]
    return World(boxes=np.array(boxes), has_ground=False)


def open_field() -> World:
    """Return a plane and nothing else: only height, roll and pitch can be observed."""
    return World()


@numba.njit(cache=True)
def _cast(
    origins: FloatArray,
    directions: FloatArray,
    pillars: FloatArray,
    boxes: FloatArray,
    has_ground: bool,
    max_range: float,
) -> FloatArray:
    ranges = np.full(origins.shape[0], np.inf)
    for i in range(origins.shape[0]):
        ox, oy, oz = origins[i]
        dx, dy, dz = directions[i]
        best = max_range
        if has_ground and dz < -1e-9:
            best = min(best, -oz / dz)
        a = dx * dx + dy * dy
        for k in range(pillars.shape[0]):
            px, py = pillars[k, 0] - ox, pillars[k, 1] - oy
            along = px * dx + py * dy
            square = along * along - a * (px * px + py * py - pillars[k, 2] ** 2)
            if along > 0.0 and square > 0.0:
                t = (along - np.sqrt(square)) / a
                if 0.0 < t < best and 0.0 < oz + t * dz < pillars[k, 3]:
                    best = t
        for k in range(boxes.shape[0]):
            near, far = -np.inf, np.inf
            for axis in range(3):
                direction = directions[i, axis]
                if abs(direction) < 1e-12:
                    direction = 1e-12
                t0 = (boxes[k, axis] - origins[i, axis]) / direction
                t1 = (boxes[k, axis + 3] - origins[i, axis]) / direction
                near, far = max(near, min(t0, t1)), min(far, max(t0, t1))
            if near <= far:
                if 0.0 < near < best:
                    best = near
                elif near <= 0.0 < far < best:
                    best = far
        if best < max_range:
            ranges[i] = best
    return ranges


def slot_directions(slots: NDArray[np.int64]) -> FloatArray:
    """Return unit directions (n, 3): rotor 181 Hz, nod 9.9 Hz, four emitters, elevations -7 to 52 deg."""
    t = (slots // 4) * (4 * SLOT_NS * 1e-9)
    line = slots % 4
    azimuth = 2.0 * np.pi * 181.08 * t + np.radians(0.3) * line
    nod = 2.0 * np.pi * 9.9 * t + 0.5 * np.pi * line + 0.1 * np.sin(azimuth)
    elevation = np.radians(22.5 + 28.5 * np.sin(nod) + 1.0 * np.sin(3.0 * azimuth + line))
    cosine = np.cos(elevation)
    return np.stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), np.sin(elevation)], axis=-1)


class Trajectory:
    """A quadrotor's smooth motion: it stands, takes off in place, then follows a closed curve."""

    def __init__(self, knots_s: FloatArray, p_world: FloatArray, yaw: FloatArray) -> None:
        self.duration_s = float(knots_s[-1])
        self._p = make_interp_spline(knots_s, p_world, k=5)
        self._v = self._p.derivative(1)
        self._a = self._p.derivative(2)
        grid = np.arange(0.0, self.duration_s + 0.01, 0.02)
        thrust = self._a(grid) + np.array([0.0, 0.0, GRAVITY])
        z = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
        heading = CubicSpline(knots_s, yaw)(grid)
        y = np.cross(z, np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=1))
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        matrices = np.stack([np.cross(y, z), y, z], axis=2)
        self._R = RotationSpline(grid, Rotation.from_matrix(matrices))

    def pose(self, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return body positions (n, 3) and rotation matrices (n, 3, 3) in the world at times (n,) s."""
        times = np.asarray(t, dtype=np.float64)
        return np.asarray(self._p(times)), np.asarray(self._R(times).as_matrix())

    def velocity(self, t: ArrayLike) -> FloatArray:
        """Return body velocities (n, 3) in the world."""
        return np.asarray(self._v(np.asarray(t, dtype=np.float64)))

    def rates(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return acceleration in the world, angular rate and acceleration in the body, each (n, 3)."""
        return np.asarray(self._a(t)), np.asarray(self._R(t, 1)), np.asarray(self._R(t, 2))


def loop_trajectory(
    duration_s: float,
    speed: float = 2.5,
    size_m: tuple[float, float] = (12.0, 8.4),
    height_m: float = 2.0,
    yaw_rate: float = 0.35,
    still_s: float = 2.0,
    ground_clearance_m: float = 0.2,
) -> Trajectory:
    """Return a flight that stands `still_s`, climbs for 2 s and then circles an ellipse with yawing."""
    knots = np.arange(0.0, duration_s + 1.0, 0.1)
    climb = np.clip((knots - still_s) / 2.0, 0.0, 1.0)
    climb = climb**3 * (10.0 - 15.0 * climb + 6.0 * climb**2)
    ramp_s = 1.5
    since = np.clip(knots - still_s - 1.2, 0.0, None)
    travelled = speed * np.where(
        since < ramp_s, since**3 / ramp_s**2 * (1 - 0.5 * since / ramp_s), since - 0.5 * ramp_s
    )
    phase = travelled / (0.5 * (size_m[0] + size_m[1]))
    bump = 0.35 * np.sin(0.9 * np.maximum(knots - still_s - 2.0, 0.0)) ** 2
    p_world = np.stack(
        [
            size_m[0] * np.cos(phase),
            size_m[1] * np.sin(phase),
            ground_clearance_m + (height_m - ground_clearance_m + bump) * climb,
        ],
        axis=1,
    )
    yaw = yaw_rate * np.where(
        since < ramp_s, since**3 / ramp_s**2 * (1 - 0.5 * since / ramp_s), since - 0.5 * ramp_s
    )
    return Trajectory(knots, p_world, yaw + 0.4 * np.sin(0.7 * since) * np.clip(since, 0.0, 1.0) ** 3)


def hover_trajectory(duration_s: float, p_world: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Trajectory:
    """Return a motionless flight."""
    knots = np.arange(0.0, duration_s + 1.0, 0.1)
    return Trajectory(knots, np.tile(p_world, (len(knots), 1)).astype(np.float64), np.zeros_like(knots))


@dataclass(frozen=True)
class SensorErrors:
    """Noise per sample at 200 Hz, constant biases, and what goes missing."""

    gyro_sigma: float = 8e-4
    accel_sigma: float = 0.01
    gyro_bias: tuple[float, float, float] = (0.003, -0.002, 0.004)
    accel_bias: tuple[float, float, float] = (0.015, -0.02, 0.03)
    range_sigma_m: float = 0.02
    missing_packets: float = 0.0
    outages_s: tuple[tuple[float, float], ...] = ()


class SimulatedFlight:
    """Sensor events in order of arrival, and the truth."""

    def __init__(
        self,
        world: World,
        trajectory: Trajectory,
        seed: int = 1,
        errors: SensorErrors | None = None,
        max_range_m: float = 40.0,
        min_range_m: float = 0.15,
    ) -> None:
        self.world, self.trajectory = world, trajectory
        self.errors = errors or SensorErrors()
        self._seed = seed
        self._ranges_m = (min_range_m, max_range_m)

    def events(self) -> Iterator[ImuSample | LidarScan]:
        """Yield the IMU samples and, after the first sample past its end, each scan."""
        rng = np.random.default_rng(self._seed)
        end_ns = int(self.trajectory.duration_s * 1e9) - SCAN_NS
        next_scan_ns, sequence = SCAN_NS, 0
        for t_ns in range(IMU_PERIOD_NS, end_ns, IMU_PERIOD_NS):
            sample = self._imu(t_ns, rng)
            lost = rng.uniform() < self.errors.missing_packets or self._in_outage(t_ns * 1e-9)
            if not lost:
                yield sample
            if t_ns >= next_scan_ns:
                scan = self._scan(next_scan_ns - SCAN_NS, sequence, t_ns, rng)
                sequence += 1
                next_scan_ns += SCAN_NS
                if scan is not None:
                    yield scan

    def truth(self, t_sensor_ns: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return p (n, 3), q (n, 4) and v (n, 3) of the body in the map (start) frame at sensor times."""
        t = np.asarray(t_sensor_ns) * 1e-9
        p_world, R_world = self.trajectory.pose(t)
        p0, R0 = self.trajectory.pose(np.array([0.2]))
        yaw = np.arctan2(R0[0, 1, 0], R0[0, 0, 0])
        R_map_world = rotation.to_matrix(rotation.from_yaw(-yaw))
        return (
            (p_world - p0[0]) @ R_map_world.T,
            rotation.from_matrix(R_map_world @ R_world),
            self.trajectory.velocity(t) @ R_map_world.T,
        )

    def _in_outage(self, t: float) -> bool:
        return any(start <= t < end for start, end in self.errors.outages_s)

    def _imu(self, t_ns: int, rng: np.random.Generator) -> ImuSample:
        t = np.array([t_ns * 1e-9])
        _, R = self.trajectory.pose(t)
        a_world, omega, alpha = (value[0] for value in self.trajectory.rates(t))
        lever = (T_BODY_LIDAR @ T_LIDAR_IMU).p
        a_body = R[0].T @ (a_world + np.array([0.0, 0.0, GRAVITY]))
        a_body += np.cross(alpha, lever) + np.cross(omega, np.cross(omega, lever))
        gyro = omega + self.errors.gyro_bias + rng.normal(0.0, self.errors.gyro_sigma, 3)
        accel = a_body + self.errors.accel_bias + rng.normal(0.0, self.errors.accel_sigma, 3)
        return ImuSample(t_ns + CLOCK_OFFSET_NS, t_ns, gyro, accel)

    def _scan(self, start_ns: int, sequence: int, now_ns: int, rng: np.random.Generator) -> LidarScan | None:
        slots = np.arange(start_ns // SLOT_NS, (start_ns + SCAN_NS) // SLOT_NS, dtype=np.int64)
        times = slots * (SLOT_NS * 1e-9)
        p_body, R_body = self.trajectory.pose(times)
        directions_lidar = slot_directions(slots)
        directions = np.einsum("nij,nj->ni", R_body, directions_lidar)
        origins = p_body + np.einsum("nij,j->ni", R_body, T_BODY_LIDAR.p)
        ranges = _cast(
            origins,
            directions,
            self.world.pillars,
            self.world.boxes,
            self.world.has_ground,
            self._ranges_m[1],
        )
        hit = np.isfinite(ranges)
        ranges = np.where(hit, ranges, 0.0) + rng.normal(0.0, self.errors.range_sigma_m, len(ranges))
        packets = slots // 96
        ids, first = np.unique(packets, return_inverse=True)
        arrived = rng.uniform(size=len(ids)) >= self.errors.missing_packets
        seconds = ids * 96 * SLOT_NS * 1e-9
        arrived &= np.array([not self._in_outage(float(t)) for t in seconds], dtype=bool)
        keep = hit & (ranges > self._ranges_m[0]) & arrived[first]
        if not arrived.any():
            return None
        return LidarScan(
            t_ns=now_ns + CLOCK_OFFSET_NS,
            sequence=sequence,
            t_sensor_start_ns=start_ns,
            t_sensor_end_ns=start_ns + SCAN_NS,
            clock_offset_ns=CLOCK_OFFSET_NS,
            points_lidar=(directions_lidar * ranges[:, None])[keep].astype(np.float32),
            offsets_ns=(slots * SLOT_NS - start_ns)[keep].astype(np.int32),
            reflectivity=np.full(int(keep.sum()), 30, dtype=np.uint8),
            tags=np.zeros(int(keep.sum()), dtype=np.uint8),
            packets=int(arrived.sum()),
            packets_expected=len(ids),
        )
