"""A made-up flight of three vehicles whose metrics are known: logs in maps and by clocks of their own."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.logs import channels
from companion.logs.metadata import FlightMetadata
from companion.logs.records import CloudView, StampedPose
from companion.logs.swarm_starts import StartPose
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import (
    FloatArray,
    LandedState,
    NeighbourTracks,
    Odometry,
    OdometryStatus,
    VehicleMode,
    VehicleState,
)

NAMES = ("uav1", "uav2", "uav3")
DURATION_S = 12.0
SPEED_MPS = 1.0
LATERAL_M = (0.0, 1.6, -1.8)
PILLARS = ((4.0, 3.0), (8.0, -3.5))
STARTS = {
    "uav1": StartPose(position_m=(0.0, 0.0, 0.15), yaw_deg=0.0),
    "uav2": StartPose(position_m=(0.0, 1.6, 0.15), yaw_deg=100.0),
    "uav3": StartPose(position_m=(0.0, -1.8, 0.15), yaw_deg=-35.0),
}
GOAL = (SPEED_MPS * (DURATION_S - 2.0), 0.0, 1.5)
LANDED_AFTER_S = 11.5


@dataclass(frozen=True)
class Clocks:
    """What a computer's clock showed when the flight began, and how the log says so."""

    host_ns: tuple[int, int, int] = (0, 0, 0)
    dated: bool = False
    paired: bool = True
    wrong_s: tuple[float, float, float] = (0.0, 0.0, 0.0)


def position(t: float, vehicle: int) -> FloatArray:
    """Rest for a second, climb in one, fly along x, the second vehicle swaying."""
    climb = min(max(t - 1.0, 0.0), 1.0)
    along = SPEED_MPS * max(0.0, t - 2.0)
    sway = 0.3 * np.sin(0.8 * (t - 2.0)) if vehicle == 1 and t > 2.0 else 0.0
    return np.array([along, LATERAL_M[vehicle] + sway, 0.15 + 1.35 * climb])


def velocity(t: float, vehicle: int) -> FloatArray:
    return (position(t + 1e-4, vehicle) - position(t - 1e-4, vehicle)) / 2e-4


def pose_of_map(name: str) -> Pose:
    start = STARTS[name]
    return Pose.of(start.position_m, rotation.from_yaw(np.radians(start.yaw_deg)))


def cloud(t: float, vehicle: int) -> FloatArray:
    """Points in the common frame: pillars as lines, the ground, the others' bodies, the own one."""
    heights = np.arange(0.0, 3.0, 0.05)
    parts = [
        np.column_stack([np.full_like(heights, x), np.full_like(heights, y), heights]) for x, y in PILLARS
    ]
    ground = np.random.default_rng(1).uniform([-2, -6], [14, 6], (200, 2))
    parts.append(np.column_stack([ground, np.zeros(200)]))
    ring = 0.15 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    parts += [position(t, other) + ring for other in range(3)]
    return np.concatenate(parts)


def nearest_pillar(p: FloatArray) -> FloatArray:
    """True distance (...) of positions (..., 3) below the pillars' tops to the nearest pillar."""
    return np.asarray(np.min([np.linalg.norm(p[..., :2] - pillar, axis=-1) for pillar in PILLARS], axis=0))


def write_logs(
    folder: Path,
    *,
    clocks: Clocks = Clocks(),
    truth: bool = False,
    clouds: bool = True,
    tracks: bool = False,
    gap: tuple[float, float] | None = None,
    resets_at: float | None = None,
) -> list[Path]:
    return [
        _write(folder, vehicle, clocks, truth, clouds, tracks, gap if vehicle == 2 else None, resets_at)
        for vehicle in range(3)
    ]


def _write(
    folder: Path,
    vehicle: int,
    clocks: Clocks,
    truth: bool,
    clouds: bool,
    tracks: bool,
    gap: tuple[float, float] | None,
    resets_at: float | None,
) -> Path:
    name = NAMES[vehicle]
    path = folder / f"{name}.mcap"
    zero_ns = clocks.host_ns[vehicle]
    metadata = FlightMetadata(name, "leader" if vehicle == 0 else "follower", "flight", versions={})
    if clocks.dated:
        # The file was opened three seconds before the flight, by a clock that may be wrong.
        calendar_ns = 1_700_000_000_000_000_000 + round(clocks.wrong_s[vehicle] * 1e9)
        metadata = replace(metadata, calendar_ns=calendar_ns)
        if clocks.paired:
            metadata = replace(metadata, host_ns=zero_ns - 3_000_000_000)
    log = FlightLog(path, LogSettings(), metadata, threaded=False)
    T_common_map = pose_of_map(name)
    T_map_common = T_common_map.inverse()
    # The clocks of the three do not tick together.
    for step in range(round(DURATION_S * 25) - vehicle):
        t = step * 0.04 + 0.003 * vehicle
        t_ns = zero_ns + round(t * 1e9)
        known = gap is None or not gap[0] <= t < gap[1]
        moved = 5.0 if resets_at is not None and t >= resets_at else 0.0
        if known:
            log.record(_odometry(t, t_ns, vehicle, T_map_common, moved), t_ns)
        if truth:
            q = rotation.multiply(T_common_map.q, rotation.from_yaw(0.3 * t))
            log.write(channels.TRUTH, StampedPose(t_ns, "world", position(t, vehicle), q), t_ns)
        if step % 5 == 0:
            log.record(_vehicle(t, t_ns), t_ns)
            if tracks:
                log.record(NeighbourTracks(t_ns, step, ()), t_ns)
            if clouds:
                points = T_map_common.transform(cloud(t, vehicle)).astype(np.float32)
                view = CloudView(t_ns, points, np.zeros(len(points), np.uint8))
                log.write(channels.CLOUD, view, t_ns)
    log.close()
    return path


def _odometry(t: float, t_ns: int, vehicle: int, T_map_common: Pose, moved: float) -> Odometry:
    q_map_body = rotation.from_yaw(0.3 * t)
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=t_ns,
        p_map=T_map_common.transform(position(t, vehicle)) + moved,
        q_map_body=q_map_body,
        v_map=rotation.rotate(T_map_common.q, velocity(t, vehicle)),
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6) * 1e-4,
        covariance_velocity=np.eye(3) * 1e-4,
        quality=90,
        reset_counter=int(moved > 0.0),
        status=OdometryStatus.TRACKING,
    )


def _vehicle(t: float, t_ns: int) -> VehicleState:
    flying = 1.2 <= t < LANDED_AFTER_S
    return VehicleState(
        t_ns=t_ns,
        connected=True,
        armed=flying,
        mode=VehicleMode.OFFBOARD,
        landed=LandedState.IN_AIR if flying else LandedState.ON_GROUND,
        failsafe=False,
        t_local_ns=t_ns,
        p_map=np.zeros(3),
        v_map=np.zeros(3),
        q_map_body=rotation.IDENTITY,
        estimator_reset_counter=0,
        mode_changes=0,
    )
