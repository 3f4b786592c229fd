"""Registered scans of made-up UAVs and posts, as a scanner that stands at `SENSOR` would see them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray, Odometry, OdometryStatus, RegisteredScan

SCAN_NS = 100_000_000
POINTS_PER_STERADIAN = 3500.0
SENSOR = np.array([0.0, 0.0, 1.5])


@dataclass(frozen=True)
class Uav:
    """A body of 0.25 m by 0.12 m that moves evenly, a part of its points bright.

    Bright ones lie on a hull in its middle, the others also on what sticks out all around.
    """

    p_map: tuple[float, float, float]
    v_map: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bright_share: float = 0.4

    def at(self, t_s: float) -> FloatArray:
        """Return where its centre is."""
        return np.array(self.p_map) + t_s * np.array(self.v_map)


@dataclass(frozen=True)
class Post:
    """An upright strip, dim but for a band."""

    x: float
    y: float
    width_m: float = 0.08
    height_m: float = 2.5
    band_m: tuple[float, float] = (1.4, 1.6)


Thing = Uav | Post


def odometry(t_ns: int, **changes: object) -> Odometry:
    """Return a good estimate of standing at `SENSOR`."""
    values: dict[str, object] = {
        "t_ns": t_ns,
        "t_sensor_ns": t_ns,
        "p_map": SENSOR.copy(),
        "q_map_body": np.array([1.0, 0.0, 0.0, 0.0]),
        "v_map": np.zeros(3),
        "omega_body": np.zeros(3),
        "covariance_pose": np.eye(6) * 1e-4,
        "covariance_velocity": np.eye(3) * 1e-4,
        "quality": 100,
        "reset_counter": 0,
        "status": OdometryStatus.TRACKING,
    }
    return Odometry(**(values | changes))  # type: ignore[arg-type]


def scan(
    number: int, things: list[Thing], rng: np.random.Generator, own: Odometry | None = None
) -> RegisteredScan:
    """Return the scan that ends at ``number`` tenths of a second.

    Points fall evenly on what a thing shows of itself, as many as its solid angle deserves; each is
    measured at its own time.
    """
    t_ns = number * SCAN_NS
    found = [
        _on_uav(thing, t_ns * 1e-9, rng) if isinstance(thing, Uav) else _on_post(thing, rng)
        for thing in things
    ]
    points = np.concatenate([np.zeros((0, 3)), *(points for points, _, _ in found)])
    is_bright = np.concatenate([np.zeros(0, np.bool_), *(bright for _, bright, _ in found)])
    ages_ns = np.concatenate([np.zeros(0), *(ages for _, _, ages in found)])
    return RegisteredScan(
        t_ns=t_ns + 1_000_000,
        sequence=number,
        points_map=points.astype(np.float32),
        reflectivity=np.where(is_bright, 220, 20).astype(np.uint8),
        odometry=own or odometry(t_ns),
        ages_ns=ages_ns.astype(np.int32),
    )


def _on_uav(
    uav: Uav, t_s: float, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    away = uav.at(t_s) - SENSOR
    count = rng.poisson(POINTS_PER_STERADIAN * 0.25 * 0.12 / float(away @ away))
    ages_ns = rng.uniform(0.0, SCAN_NS, count)
    flat = -away[:2] / np.linalg.norm(away[:2])
    left = rng.uniform(-0.125, 0.125, count)
    bright = rng.random(count) < uav.bright_share
    near = np.where(bright, rng.normal(0.082, 0.02, count), rng.uniform(-0.06, 0.15, count))
    up = np.where(bright, 0.5, 1.0) * rng.uniform(-0.08, 0.08, count)
    surface = np.column_stack([near * flat[0] - left * flat[1], near * flat[1] + left * flat[0], up])
    centres = np.array([uav.at(t_s - 1e-9 * age) for age in ages_ns]).reshape(-1, 3)
    noise = rng.normal(0.0, 0.005, (count, 3))
    return centres + surface + noise, bright, ages_ns


def _on_post(post: Post, rng: np.random.Generator) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    square = post.x**2 + post.y**2
    count = rng.poisson(POINTS_PER_STERADIAN * post.width_m * post.height_m / square)
    flat = np.array([post.x, post.y]) / np.sqrt(square)
    left, z = rng.uniform(-0.5, 0.5, count) * post.width_m, rng.uniform(0.0, post.height_m, count)
    points = np.column_stack([post.x - left * flat[1], post.y + left * flat[0], z])
    low, high = post.band_m
    seen = np.arctan2(z - SENSOR[2], np.sqrt(square)) > np.radians(-7.0)
    bright = (z >= low) & (z <= high)
    return points[seen], bright[seen], rng.uniform(0.0, SCAN_NS, int(seen.sum()))
