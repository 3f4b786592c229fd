"""One trial of the abstract swarm, from a scene to its record."""

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray

from companion.control.followers.layout_kernels import (
    EGO_SIZE,
    MAX_ROWS,
    MEMORY_SIZE,
    METHOD_IDS,
    NEIGHBOUR_SIZE,
)
from companion.control.followers.settings import FollowerSettings
from companion.control.leader.settings import LeaderSettings
from companion.geometry import rotation
from companion.logs.metrics import DEFAULT_CAP_M, mission_progress_percent
from companion.messages import FloatArray
from sitl.abstract.course import Course, plan_course
from sitl.abstract.judging_kernels import (
    ALIGNED,
    ALIGNMENT,
    ENDS,
    FLOCK_RADIUS,
    FLYING,
    N_SUMS,
    NEAR_OBSTACLE,
    OBSTACLE,
    SAMPLES,
    SEPARATION,
    TIMEOUT,
)
from sitl.abstract.leader_kernels import LEADER_WIDTH
from sitl.abstract.perception_kernels import TRACK_WIDTH
from sitl.abstract.settings import CONTROL_STEP_S, HISTORY, AbstractSettings
from sitl.abstract.swarm_kernels import Arrays, fly
from sitl.dynamics import GRAVITY
from sitl.dynamics_kernels import MEMORY_WIDTH, MOTION_WIDTH, THRUST, P, Q
from sitl.swarm.record import End, TrialRecord
from sitl.swarm.scene import SwarmScene
from sitl.swarm.settings import TerminationSettings

_STATE_WIDTH = 10


@dataclass(frozen=True, slots=True, eq=False)
class SwarmTrajectory:
    """Everything that happened, 20 times a second, in the world frame.

    Attributes:
        t: (T,) s since the followers were let go.
        p_world: (T, n, 3) m.
        v_world: (T, n, 3) m/s.
        q_world_body: (T, n, 4) attitudes.
        command_world: (T, n, 3) velocities asked for, m/s.
        perceived: (T, n, n) whether i knows of j; the leader's own row is False.
        distances: (T, n) to the nearest surface, m; infinite where none is near.
    """

    t: FloatArray
    p_world: FloatArray
    v_world: FloatArray
    q_world_body: FloatArray
    command_world: FloatArray
    perceived: NDArray[np.bool_]
    distances: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AbstractFlight:
    """One trial flown.

    Attributes:
        record: what it came to.
        trajectory: how it went, if that was asked for.
        course: the leader's route.
    """

    record: TrialRecord
    trajectory: SwarmTrajectory | None
    course: Course


def fly_abstract(
    scene: SwarmScene,
    method: str,
    follower: FollowerSettings,
    settings: AbstractSettings,
    *,
    termination: TerminationSettings | None = None,
    cap_m: float = DEFAULT_CAP_M,
    record: bool = False,
    world_name: str = "",
    trial: int = 0,
    leader: LeaderSettings | None = None,
    course: Course | None = None,
) -> AbstractFlight:
    """Fly one trial; equal arguments give equal bytes, whatever else runs.

    Args:
        scene: the world, the start and the leader's way.
        method: the followers' law.
        follower: its gains.
        settings: of perception and flight.
        termination: what ends the trial.
        cap_m: obstacles farther than this do not count for MDO.
        record: whether to keep the trajectory.
        world_name: for the record.
        trial: number of the trial, for the record.
        leader: how the leader keeps away from obstacles; mission and speed are the scene's.
        course: the leader's route if it is known already, from an earlier flight in the same scene.

    Raises:
        KeyError: if there is no such law.
    """
    termination = termination or TerminationSettings()
    law = follower.packed(method)
    if course is None:
        rng = np.random.default_rng(SeedSequence(scene.seed, spawn_key=(1,)))
        course = plan_course(scene, leader or LeaderSettings(), rng)
    number = len(scene.starts_world)
    steps = math.ceil(scene.timeout_s / CONTROL_STEP_S)
    samples = steps + 1 if record else 0
    trace = np.empty((samples, number, _STATE_WIDTH))
    commands = np.empty((samples, number, 3))
    known = np.empty((samples, number, number), np.uint8)
    rooms = np.empty((samples, number))
    sums, concerned = np.zeros(N_SUMS), np.full(2, -1, np.int64)
    motion = _motion(scene)
    end, last = fly(
        np.uint64(scene.seed), METHOD_IDS[method], steps, _world(scene), settings.packed_grid(), motion,
        _views(number, settings), _route(scene, course),
        settings.packed(termination, scene.timeout_s, cap_m), settings.packed_quadrotor(), law, sums,
        concerned, np.zeros((number, 3)), np.zeros((number, 3)), (trace, commands, known, rooms),
    )  # fmt: skip
    trajectory = None
    if record:
        trajectory = SwarmTrajectory(
            t=np.asarray(CONTROL_STEP_S * np.arange(last + 1), np.float64),
            p_world=trace[: last + 1, :, 0:3].copy(),
            v_world=trace[: last + 1, :, 3:6].copy(),
            q_world_body=trace[: last + 1, :, 6:10].copy(),
            command_world=commands[: last + 1].copy(),
            perceived=known[: last + 1].astype(np.bool_),
            distances=rooms[: last + 1].copy(),
        )
    p_end = motion[0][last % HISTORY, 0, :3]
    ended = cast(End, ENDS[TIMEOUT if end == FLYING else end])
    result = TrialRecord(
        world=world_name,
        method=method,
        followers=number - 1,
        fidelity="abstract",
        trial=trial,
        seed=scene.seed,
        scene_hash=scene.scene_hash,
        end=ended,
        ended_by=tuple(int(who) for who in concerned if who >= 0),
        t_end_s=last * CONTROL_STEP_S,
        mission_progress_percent=mission_progress_percent(
            scene.starts_world[0], scene.waypoints_world[-1], p_end, success=ended == "success"
        ),
        flock_radius_m=_mean(sums, FLOCK_RADIUS, SAMPLES),
        minimum_separation_m=_mean(sums, SEPARATION, SAMPLES),
        alignment=_mean(sums, ALIGNMENT, ALIGNED),
        obstacle_distance_m=_mean(sums, OBSTACLE, NEAR_OBSTACLE),
        steps=int(sums[SAMPLES]),
    )
    return AbstractFlight(result, trajectory, course)


def _mean(sums: FloatArray, which: int, how_many: int) -> float:
    return float(sums[which] / sums[how_many]) if sums[how_many] > 0.0 else math.nan


def _world(scene: SwarmScene) -> Arrays:
    world = scene.world.obstacles()
    number = len(scene.starts_world)
    return (
        world.kinds,
        world.rows,
        world.discs,
        np.empty((number, len(world.kinds)), np.int32),
        np.zeros(number, np.int64),
    )


def _motion(scene: SwarmScene) -> Arrays:
    number = len(scene.starts_world)
    motion = np.zeros((number, MOTION_WIDTH))
    motion[:, P : P + 3] = scene.starts_world
    motion[:, Q : Q + 4] = rotation.from_yaw(scene.yaws)
    motion[:, THRUST] = GRAVITY
    return (
        np.zeros((HISTORY, number, _STATE_WIDTH)),
        np.zeros((HISTORY, number, 3)),
        np.zeros((number, 3)),
        motion,
        np.zeros((number, MEMORY_WIDTH)),
        np.zeros((number, 5)),
        np.zeros((number, 3)),
        np.full(number, math.inf),
        np.zeros(number, np.uint8),
    )


def _views(number: int, settings: AbstractSettings) -> Arrays:
    return (
        np.zeros((number, number, TRACK_WIDTH)),
        np.zeros((number, EGO_SIZE)),
        np.zeros((number, MAX_ROWS, NEIGHBOUR_SIZE)),
        np.full((number, settings.grid.azimuths, settings.grid.elevations), math.inf),
        np.zeros((number, MEMORY_SIZE)),
        np.zeros(number, np.uint8),
        np.zeros(3),
    )


def _route(scene: SwarmScene, course: Course) -> Arrays:
    field = course.field
    return (
        scene.waypoints_world,
        scene.holds_s,
        course.legs,
        course.ends,
        course.clearances,
        field.distance,
        field.blocked,
        field.surface,
        field.first,
        course.rules,
        np.zeros(LEADER_WIDTH),
        np.zeros((LeaderSettings().potential_field.sectors, 3)),
        np.zeros((2, 3)),
    )
