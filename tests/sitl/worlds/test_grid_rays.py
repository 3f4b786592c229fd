"""The grid that training sees is the grid that flies: rays and points agree on the same scenes."""

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, Odometry, OdometryStatus, RegisteredScan
from companion.perception.occupancy import GridSettings, ObstacleGrid
from sitl.kinematics import BodyTrajectory, Kinematics
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.worlds.grid_rays import grid_ranges
from sitl.worlds.primitives import Box, Cylinder, Ground, Sphere, World

GRID = GridSettings()
SCANS = 3  # of 20,000 slots, so that a cell is crossed often enough
SLOTS = 20_000
SCAN_NS = 100_000_000


def scene(seed: int) -> World:
    rng = np.random.default_rng(seed)
    pillars: list[Cylinder] = []
    while len(pillars) < 8:
        x, y = rng.uniform(-9.0, 9.0, 2)
        if np.hypot(x, y) > 2.0:
            foot, top = (float(x), float(y), 0.0), (float(x), float(y), float(rng.uniform(1.0, 6.0)))
            pillars.append(
                Cylinder(start_world_m=foot, end_world_m=top, radius_m=float(rng.uniform(0.2, 0.5)))
            )
    wall = Box(centre_world_m=(0.0, 8.0, 1.0), size_m=(6.0, 0.3, 2.0))
    rock = Sphere(centre_world_m=(3.0, -3.0, 0.4), radius_m=0.9)
    return World.of([Ground(), wall, rock, *pillars])


def seen(world: World, p_world: FloatArray, q_world_body: FloatArray, settings: Mid360Settings) -> FloatArray:
    """What hovering there for a while returns, in the world."""
    still = Kinematics(p_world, np.zeros(3), q_world_body, np.zeros(3))
    model = Mid360Model(np.random.default_rng(1), Pose.identity(), settings)
    end_ns = SCANS * SCAN_NS
    slots = model.measure(0, SCANS * SLOTS, BodyTrajectory.between(0, still, end_ns, still), world)
    hit = np.any(slots.points_lidar != 0.0, axis=1)
    return rotation.rotate(q_world_body, slots.points_lidar[hit]) + p_world


def registered(points: FloatArray, p_world: FloatArray, q_world_body: FloatArray) -> RegisteredScan:
    odometry = Odometry(
        t_ns=SCAN_NS,
        t_sensor_ns=SCAN_NS,
        p_map=p_world,
        q_map_body=q_world_body,
        v_map=np.zeros(3),
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6),
        covariance_velocity=np.eye(3),
        quality=100,
        reset_counter=0,
        status=OdometryStatus.TRACKING,
    )
    count = len(points)
    return RegisteredScan(
        SCAN_NS,
        1,
        points.astype(np.float32),
        np.full(count, 30, np.uint8),
        odometry,
        np.zeros(count, np.int32),
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("imperfect", [False, True], ids=["ideal sensor", "real sensor"])
def test_rays_and_points_give_the_same_grid(seed: int, imperfect: bool) -> None:
    world = scene(seed)
    p_world = np.array([0.3, -0.2, 1.6])
    q_world_body = rotation.from_yaw(0.7 * seed)
    settings = Mid360Settings(spurious_probability=0.0) if imperfect else Mid360Settings.ideal()
    scan = registered(seen(world, p_world, q_world_body, settings), p_world, q_world_body)
    from_points = ObstacleGrid(GRID).ranges(scan, None, p_world, 0.7 * seed)
    from_rays = grid_ranges(world, p_world, 0.7 * seed, GRID, rays_per_cell=8)
    agree = np.isfinite(from_points) == np.isfinite(from_rays)
    assert agree.mean() > 0.97
    both = np.isfinite(from_points) & np.isfinite(from_rays)
    assert both.sum() > 60
    off = np.abs(from_points[both] - from_rays[both])
    # Where a cell holds two surfaces, one of both may have been passed by.
    assert np.median(off) < 0.03
    assert np.percentile(off, 95) < 0.3


def test_the_ground_and_the_own_body_are_not_shown() -> None:
    rays = grid_ranges(World.of([Ground()]), np.array([0.0, 0.0, 1.5]), 0.0, GRID)
    assert np.isinf(rays).all()
