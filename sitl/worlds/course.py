"""Where a swarm begins and flies to in a world: the places that every generator keeps free."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from companion.messages import FloatArray
from sitl.worlds.placing import FreeDisc

GOAL_DISTANCE_M = 30.0
SPAWN_CLEAR_M = 4.0
GOAL_CLEAR_M = 2.5
_CELL_M = 1.6
_BEYOND_CELLS_M = SPAWN_CLEAR_M - _CELL_M * math.sqrt(2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A start and the leader's waypoints.

    Attributes:
        spawn_world: (2,) middle of the swarm at the start, m.
        spawn_clear_m: nothing stands nearer to it.
        waypoints_world: (k, 2) the last is the goal, m.
        goal_clear_m: nothing stands nearer to any of them.
    """

    spawn_world: FloatArray
    spawn_clear_m: float
    waypoints_world: FloatArray
    goal_clear_m: float = GOAL_CLEAR_M

    @property
    def points_world(self) -> FloatArray:
        """Start and waypoints in one polyline (k + 1, 2), m."""
        return np.vstack([self.spawn_world, self.waypoints_world])

    def free(self, beyond_m: float = 0.0) -> list[FreeDisc]:
        """Return the discs to be kept free, all larger by `beyond_m`."""
        x, y = self.spawn_world.tolist()
        discs = [(x, y, self.spawn_clear_m + beyond_m)]
        discs += [(x, y, self.goal_clear_m + beyond_m) for x, y in self.waypoints_world.tolist()]
        return discs

    def distance(self, points_world: FloatArray) -> FloatArray:
        """Return the distance (n,) of points (n, 2) from the polyline, m."""
        nearest = np.full(len(points_world), np.inf)
        corners = self.points_world
        for start, end in pairwise(corners):
            along = end - start
            square = float(along @ along)
            offsets = points_world - start
            share = np.clip(offsets @ along / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(offsets))
            nearest = np.minimum(nearest, np.hypot(*(offsets - share[:, None] * along).T))
        return nearest


def spawn_clear_m(followers: int) -> float:
    """Return the radius of the free disc at the start: 4 m round 3 x 3 cells, more where more must stand."""
    side = max(3, math.ceil(math.sqrt(followers + 1)))
    return 0.5 * (side - 1) * _CELL_M * math.sqrt(2.0) + _BEYOND_CELLS_M


def open_course(
    rng: Generator,
    *,
    followers: int,
    spawn_world: ArrayLike = (0.0, 0.0),
    goal_world: ArrayLike | None = None,
    goal_distance_m: float = GOAL_DISTANCE_M,
) -> Course:
    """Return a course in open country: to the goal or waypoints given, or in a random direction.

    Args:
        rng: draws the direction, if one is needed.
        followers: how many fly behind the leader.
        spawn_world: (2,) m.
        goal_world: (2,) goal or (k, 2) waypoints, m.
        goal_distance_m: from the start to a random goal.

    Raises:
        ValueError: if the waypoints have another shape or are not finite.
    """
    spawn = np.asarray(spawn_world, np.float64)
    if goal_world is None:
        azimuth = rng.uniform(-math.pi, math.pi)
        goals = spawn + goal_distance_m * np.array([[math.cos(azimuth), math.sin(azimuth)]])
    else:
        goals = np.atleast_2d(np.asarray(goal_world, np.float64))
    if goals.ndim != 2 or goals.shape[1] != 2 or len(goals) == 0 or not np.all(np.isfinite(goals)):
        raise ValueError(f"waypoints must be finite and (2,) or (k, 2), got shape {goals.shape}")
    return Course(spawn, spawn_clear_m(followers), goals)
