"""The leader of full fidelity: it plans by a scan of rays and flies as the abstract vehicles do."""

import numpy as np

from companion.clock import seconds_to_ns
from companion.control.leader.planner import LeaderPlanner
from companion.control.leader.settings import LeaderSettings, MissionSettings
from companion.messages import FloatArray, Odometry, OdometryStatus, RegisteredScan
from sitl.abstract.motion_kernels import move
from sitl.abstract.settings import CONTROL_STEP_S, HISTORY, AbstractSettings
from sitl.dynamics import at_rest
from sitl.dynamics_kernels import P, Q, V
from sitl.swarm.scene import SwarmScene
from sitl.swarm.settings import TerminationSettings

_AZIMUTHS, _ELEVATIONS = 240, 9
_RANGE_M = 15.0


def fly_leader(scene: SwarmScene) -> FloatArray:
    """Return the positions (T, 3) of a leader that plans by what it sees, until its mission is over."""
    settings = AbstractSettings()
    planner = LeaderPlanner(
        LeaderSettings(
            mission=MissionSettings(
                waypoints_m=scene.waypoints_world.tolist(),
                speed_mps=scene.speed_mps,
                waypoint_holds_s=scene.holds_s[:-1].tolist(),
                final_hold_s=float(scene.holds_s[-1]),
            )
        ),
        np.random.default_rng(scene.seed),
    )
    state = at_rest(scene.starts_world[:1], np.zeros(1), settings=settings.quadrotor)
    motion, loop = state.motion.copy(), state.memory.copy()
    commands = np.zeros((HISTORY, 1, 3))
    parameters = settings.packed(TerminationSettings(), scene.timeout_s, 4.0)
    world, directions = scene.world, _directions()
    path = []
    for step in range(int(scene.timeout_s / CONTROL_STEP_S)):
        t_ns = seconds_to_ns(1.0 + step * CONTROL_STEP_S)
        odometry = _odometry(t_ns, motion[0])
        path.append(motion[0, P : P + 3].copy())
        if step % 2 == 0:
            origins = np.broadcast_to(odometry.p_map, directions.shape)
            ranges = world.cast(origins, directions, _RANGE_M).ranges
            hit = np.isfinite(ranges)
            points = (origins[hit] + ranges[hit, None] * directions[hit]).astype(np.float32)
            dark, fresh = np.zeros(len(points), np.uint8), np.zeros(len(points), np.int32)
            planner.observe(RegisteredScan(t_ns, step, points, dark, odometry, fresh))
        decision = planner.decide(odometry, t_ns)
        if decision.finished:
            break
        commands[step % HISTORY, 0] = decision.command.v_map
        move(
            np.uint64(0), step, commands, parameters, settings.packed_quadrotor(), np.zeros((1, 3)), motion,
            loop, np.zeros((1, 5)), np.zeros((1, 3)),
        )  # fmt: skip
    return np.array(path)


def _directions() -> FloatArray:
    azimuth = np.arange(_AZIMUTHS) * (2.0 * np.pi / _AZIMUTHS)
    elevation = np.radians(np.linspace(-7.0, 40.0, _ELEVATIONS))
    a, e = (grid.ravel() for grid in np.meshgrid(azimuth, elevation, indexing="ij"))
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def _odometry(t_ns: int, motion: FloatArray) -> Odometry:
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=t_ns,
        p_map=motion[P : P + 3].copy(),
        q_map_body=motion[Q : Q + 4].copy(),
        v_map=motion[V : V + 3].copy(),
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6) * 1e-4,
        covariance_velocity=np.eye(3) * 1e-4,
        quality=100,
        reset_counter=0,
        status=OdometryStatus.TRACKING,
    )
