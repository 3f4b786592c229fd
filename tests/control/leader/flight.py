"""A small closed loop: pillars, a ring of random rays, a velocity loop as slow as PX4's, the leader."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from companion.clock import seconds_to_ns
from companion.control.leader.planner import LeaderPlanner
from companion.control.leader.settings import LeaderSettings, MissionSettings
from companion.messages import FloatArray, Odometry, OdometryStatus, PlanUpdate, RegisteredScan

GROUND_Z = -0.15
TICK_S = 0.02
TICKS_PER_SCAN = 5
DEAD_TIME_S = 0.25
TIME_CONSTANT_S = 0.55
SCAN_DELAY_S = 0.1


def odometry_at(
    t_ns: int,
    p_map: FloatArray,
    v_map: FloatArray | None = None,
    status: OdometryStatus = OdometryStatus.TRACKING,
    reset_counter: int = 0,
) -> Odometry:
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=t_ns,
        p_map=np.asarray(p_map, np.float64),
        q_map_body=np.array([1.0, 0.0, 0.0, 0.0]),
        v_map=np.zeros(3) if v_map is None else np.asarray(v_map, np.float64),
        omega_body=np.zeros(3),
        covariance_pose=1e-4 * np.eye(6),
        covariance_velocity=1e-4 * np.eye(3),
        quality=100,
        reset_counter=reset_counter,
        status=status,
    )


def scan_of(points_map: FloatArray, odometry: Odometry, sequence: int = 0) -> RegisteredScan:
    points = np.asarray(points_map, np.float32).reshape(-1, 3)
    count = points.shape[0]
    reflectivity = np.full(count, 50, np.uint8)
    return RegisteredScan(odometry.t_ns, sequence, points, reflectivity, odometry, np.zeros(count, np.int32))


@dataclass(frozen=True)
class Pillars:
    """Upright cylinders: centres (n, 2), radii (n,), from the ground to `top_z`."""

    centres: FloatArray
    radii: FloatArray
    top_z: float = 5.0

    def distance(self, p: FloatArray) -> float:
        """Horizontal distance from p to the nearest surface."""
        if self.radii.shape[0] == 0:
            return float("inf")
        return float((np.hypot(*(self.centres - p[:2]).T) - self.radii).min())

    def returns(
        self, p_map: FloatArray, rng: np.random.Generator, rays: int, range_noise_m: float = 0.02
    ) -> FloatArray:
        """Points (k, 3) that random rays between -7 and 52 degrees of elevation hit, pillars within 14 m."""
        azimuth = rng.uniform(-np.pi, np.pi, rays)
        elevation = np.arcsin(rng.uniform(np.sin(np.radians(-7.0)), np.sin(np.radians(52.0)), rays))
        direction = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        ground = np.where(
            elevation < 0.0, (GROUND_Z - p_map[2]) / np.tan(np.minimum(elevation, -1e-6)), np.inf
        )
        horizontal = ground
        for centre, radius in zip(self.centres, self.radii, strict=True):
            offset = centre - p_map[:2]
            if np.hypot(*offset) > 14.0:
                continue
            along = direction @ offset
            chord = radius**2 - (offset @ offset - along**2)
            hit = (chord > 0.0) & (along > 0.0)
            rho = np.where(hit, along - np.sqrt(np.maximum(chord, 0.0)), np.inf)
            z = p_map[2] + np.where(hit, rho, 0.0) * np.tan(elevation)
            horizontal = np.where(hit & (z < self.top_z) & (rho < horizontal), rho, horizontal)
        distance = horizontal / np.cos(elevation)
        seen = (distance < 40.0) & (distance > 0.1)
        noisy = distance[seen] + range_noise_m * rng.standard_normal(int(seen.sum()))
        rays_map = np.column_stack(
            [direction[seen] * np.cos(elevation[seen])[:, None], np.sin(elevation[seen])]
        )
        return np.asarray(p_map + noisy[:, None] * rays_map)


def pillar_field(
    rng: np.random.Generator, gap_m: float, goal: FloatArray, extent_m: float = 18.0, tries: int = 3000
) -> Pillars:
    """Pack pillars, at least `gap_m` from surface to surface, round the straight line to `goal`."""
    low = np.minimum(goal[:2], 0.0) - extent_m
    high = np.maximum(goal[:2], 0.0) + extent_m
    centres = np.zeros((0, 2))
    radii = np.zeros(0)
    for _ in range(tries):
        centre = rng.uniform(low, high)
        radius = rng.uniform(0.2, 0.5)
        if np.hypot(*centre) < 4.0 + radius or np.hypot(*(centre - goal[:2])) < 2.5 + radius:
            continue
        if radii.shape[0] and (np.hypot(*(centres - centre).T) - radii - radius).min() < gap_m:
            continue
        centres = np.concatenate([centres, centre[None, :]])
        radii = np.concatenate([radii, [radius]])
    return Pillars(centres, radii)


@dataclass
class Flight:
    """What happened."""

    finished: bool = False
    time_s: float = 0.0
    least_distance_m: float = float("inf")
    track: list[FloatArray] = field(default_factory=list)
    commands: list[FloatArray] = field(default_factory=list)
    plans: list[PlanUpdate] = field(default_factory=list)

    def mean_jerk(self) -> float:
        """Mean magnitude of the jerk of the vehicle's motion, m/s^3."""
        return float(np.linalg.norm(np.diff(np.array(self.track), 3, axis=0), axis=1).mean() / TICK_S**3)


def mission_to(*waypoints: tuple[float, float, float], speed_mps: float = 1.0) -> LeaderSettings:
    return LeaderSettings(
        mission=MissionSettings(waypoints_m=[list(p) for p in waypoints], speed_mps=speed_mps)
    )


def fly(
    settings: LeaderSettings,
    pillars: Pillars,
    seed: int,
    limit_s: float,
    rays: int = 3000,
    start: tuple[float, float, float] = (0.0, 0.0, 1.5),
    spurious: int = 0,
    drift: FloatArray | None = None,
) -> Flight:
    """Fly a mission; `spurious` returns per scan lie anywhere within 10 m, pillars move by `drift` m/s."""
    rng = np.random.default_rng([seed, 1])
    leader = LeaderPlanner(settings, np.random.default_rng([seed, 2]))
    flight = Flight()
    p = np.array(start)
    v = np.zeros(3)
    pending: deque[np.ndarray] = deque([np.zeros(3)] * round(DEAD_TIME_S / TICK_S))
    scans: deque[tuple[int, RegisteredScan]] = deque()
    newest = odometry_at(0, p)
    leader.reset(newest)
    for tick in range(round(limit_s / TICK_S)):
        t_ns = seconds_to_ns(tick * TICK_S)
        if tick % TICKS_PER_SCAN == 0:
            measured = odometry_at(t_ns, p + 0.02 * rng.standard_normal(3), v + 0.05 * rng.standard_normal(3))
            points = pillars.returns(p, rng, rays)
            if spurious:
                noise = p + rng.uniform([-10.0, -10.0, -1.0], [10.0, 10.0, 2.0], (spurious, 3))
                points = np.concatenate([points, noise])
            scans.append((t_ns + seconds_to_ns(SCAN_DELAY_S), scan_of(points, measured, tick)))
        while scans and scans[0][0] <= t_ns:
            _, scan = scans.popleft()
            newest = scan.odometry
            leader.observe(scan)
        decision = leader.decide(newest, t_ns)
        if decision.plan is not None:
            flight.plans.append(decision.plan)
        flight.commands.append(decision.command.v_map)
        pending.append(decision.command.v_map)
        acceleration = (pending.popleft() - v) / TIME_CONSTANT_S
        size = float(np.linalg.norm(acceleration))
        v = v + TICK_S * acceleration * min(1.0, 3.0 / max(size, 1e-9))
        p = p + TICK_S * v
        flight.track.append(p)
        if drift is not None:
            pillars = Pillars(pillars.centres + TICK_S * drift, pillars.radii, pillars.top_z)
        flight.least_distance_m = min(flight.least_distance_m, pillars.distance(p))
        flight.time_s = tick * TICK_S
        if decision.finished:
            flight.finished = True
            break
    return flight
