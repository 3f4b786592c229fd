"""One trial of the abstract swarm, ready to fly: at once, or step by step with somebody's say in between."""

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
from sitl.abstract.swarm_kernels import Arrays, begin_step, finish_step, fly, set_off
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


class AbstractTrial:
    """One trial from its start to its end.

    Either `fly` it, or call `begin_step` and `finish_step` in turns until the latter says that it is over;
    then ask for the `result`.

    Attributes:
        views: what followers perceive, see `swarm_kernels.VIEWS`.
        motion: see `swarm_kernels.MOTION`.
        law: (PARAMETER_COUNT,) of the followers' law.
        flown: (n, 3) velocities that followers' memories held before the step, map.
        wanted: (n, 3) velocities that followers want, heading frame; may be changed between the halves.
    """

    def __init__(
        self,
        scene: SwarmScene,
        method: str,
        follower: FollowerSettings,
        settings: AbstractSettings,
        *,
        termination: TerminationSettings | None = None,
        cap_m: float = DEFAULT_CAP_M,
        record: bool = False,
        leader: LeaderSettings | None = None,
        course: Course | None = None,
    ) -> None:
        """Make everything ready; for the arguments see `flight.fly_abstract`.

        Raises:
            KeyError: if there is no such law.
        """
        termination = termination or TerminationSettings()
        self.law = follower.packed(method)
        course = course or leader_course(scene, leader)
        number = len(scene.starts_world)
        self._scene, self._course, self._method = scene, course, METHOD_IDS[method]
        self._most_steps = math.ceil(scene.timeout_s / CONTROL_STEP_S)
        samples = self._most_steps + 1 if record else 0
        self._record = record
        self._trace = (
            np.empty((samples, number, _STATE_WIDTH)),
            np.empty((samples, number, 3)),
            np.empty((samples, number, number), np.uint8),
            np.empty((samples, number)),
        )
        self._sums, self._concerned = np.zeros(N_SUMS), np.full(2, -1, np.int64)
        self.motion = _motion(scene)
        self.views = _views(number, settings)
        self._world, self._grid, self._route = _world(scene), settings.packed_grid(), _route(scene, course)
        self._parameters = settings.packed(termination, scene.timeout_s, cap_m)
        self._quadrotor = settings.packed_quadrotor()
        self.flown, self.wanted = np.zeros((number, 3)), np.zeros((number, 3))
        self._seed, self._step, self._end = np.uint64(scene.seed), 0, FLYING
        self._is_over = False

    @property
    def followers(self) -> int:
        """How many follow."""
        return len(self.wanted) - 1

    @property
    def is_over(self) -> bool:
        """Whether the trial has ended."""
        return self._is_over

    def fly(self) -> None:
        """Fly the whole trial as the law wants."""
        self._end, self._step = fly(
            self._seed, self._method, self._most_steps, self._world, self._grid, self.motion, self.views,
            self._route, self._parameters, self._quadrotor, self.law, self._sums, self._concerned, self.flown,
            self.wanted, self._trace,
        )  # fmt: skip
        self._is_over = True

    def begin_step(self) -> None:
        """Give everybody what it perceives; then `wanted` holds what the law wants."""
        if self._step == 0:
            set_off(self._world, self.motion, self._parameters)
        begin_step(
            self._seed, self._step, self._method, self._world, self._grid, self.motion, self.views,
            self._route, self._parameters, self.law, self._sums, self.flown, self.wanted,
        )  # fmt: skip

    def finish_step(self) -> bool:
        """Fly on with what is in `wanted`, unless the trial is over; return whether it is."""
        self._end = finish_step(
            self._seed, self._step, self._most_steps, self._world, self.motion, self.views, self._route,
            self._parameters, self._quadrotor, self.wanted, self._concerned, self._trace,
        )  # fmt: skip
        self._is_over = self._end != FLYING or self._step == self._most_steps
        if not self._is_over:
            self._step += 1
        return self._is_over

    def result(self, method: str, world: str = "", trial: int = 0) -> AbstractFlight:
        """Return what the trial came to.

        Args:
            method: name of the method, for the record.
            world: name of the world, for the record.
            trial: its number, for the record.
        """
        scene, last, sums = self._scene, self._step, self._sums
        p_end = self.motion[0][last % HISTORY, 0, :3]
        ended = cast(End, ENDS[TIMEOUT if self._end == FLYING else self._end])
        record = TrialRecord(
            world=world,
            method=method,
            followers=self.followers,
            fidelity="abstract",
            trial=trial,
            seed=scene.seed,
            scene_hash=scene.scene_hash,
            end=ended,
            ended_by=tuple(int(who) for who in self._concerned if who >= 0),
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
        return AbstractFlight(record, self._trajectory() if self._record else None, self._course)

    def _trajectory(self) -> SwarmTrajectory:
        states, commands, known, rooms = self._trace
        flown = slice(self._step + 1)
        return SwarmTrajectory(
            t=np.asarray(CONTROL_STEP_S * np.arange(self._step + 1), np.float64),
            p_world=states[flown, :, 0:3].copy(),
            v_world=states[flown, :, 3:6].copy(),
            q_world_body=states[flown, :, 6:10].copy(),
            command_world=commands[flown].copy(),
            perceived=known[flown].astype(np.bool_),
            distances=rooms[flown].copy(),
        )


def leader_course(scene: SwarmScene, leader: LeaderSettings | None = None) -> Course:
    """Return the leader's route in a scene; equal arguments give equal routes."""
    rng = np.random.default_rng(SeedSequence(scene.seed, spawn_key=(1,)))
    return plan_course(scene, leader or LeaderSettings(), rng)


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
