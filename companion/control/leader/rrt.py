"""Local path search: a rapidly-exploring random tree in the plane of flight.

Source: S. LaValle, "Rapidly-exploring random trees: a new tool for path planning", 1998.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from companion.control.leader import rrt_kernels
from companion.control.leader.obstacle_map import ClearanceField
from companion.control.leader.settings import RrtSettings
from companion.messages import FloatArray

_GRANTED_SLACK_M = 0.05
_SAMPLES_PER_NODE = 2
_CIRCLE_STEP = math.radians(5.0)
_STAND_IN_STEP_M = 0.2
_STAND_IN_ROOM_M = 0.2
_DETOUR_SHARE = 0.6
_MOST_TREES = 2
_COMPARED_AT_M = (1.0, 2.0, 3.0, 4.0, 5.0)
_CHANGE_OF_MIND = 0.3
_BEEN_THERE_M = 2.5
_BEEN_THERE_COST_M = 1.0


class SearchStatus(Enum):
    """What a search came to."""

    REACHED = "reached"
    DETOUR = "detour"
    NO_PATH = "no path"


@dataclass(frozen=True, slots=True, eq=False)
class LocalPath:
    """Outcome of one search.

    Attributes:
        status: whether the path ends at the goal, at another place from which to go on, or is none.
        points: (n, 2) polyline in the map from the start, m; (0, 2) without path.
        clearance: room that it keeps between the vehicle's centre and obstacles, m.
        ends: (2, 3) first and last point with the clearance found there, which may be less.
        nodes: size of the trees grown for it.
    """

    status: SearchStatus
    points: FloatArray
    clearance: float
    ends: FloatArray
    nodes: int


NO_PATH = LocalPath(SearchStatus.NO_PATH, np.zeros((0, 2)), 0.0, np.zeros((2, 3)), 0)


class RrtPlanner:
    """Finds local paths; equal generators and inputs give equal paths."""

    def __init__(self, settings: RrtSettings, vehicle_radius_m: float, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self.clearances = [vehicle_radius_m + settings.margin_m * share for share in settings.relaxations]
        """Clearances tried one after the other, m."""

    @property
    def least_clearance(self) -> float:
        """The clearance below which no place is considered, m."""
        return min(self.clearances)

    def reachable_goal(
        self, field: ClearanceField, start: FloatArray, waypoint: FloatArray, present: FloatArray
    ) -> FloatArray:
        """Return where to stop for a waypoint: itself, or a free point near it if it lies in an obstacle.

        A waypoint farther than the local radius, or without any free point near it, is returned as is.
        The `present` goal stays as long as it serves.
        """
        settings = self._settings
        away = float(np.hypot(*(waypoint - start)))
        if away > settings.local_radius_m or self.is_free(field, waypoint):
            return waypoint
        if np.hypot(*(waypoint - present)) <= settings.stand_in_distance_m and self.is_free(field, present):
            return present
        wanted = self.least_clearance + _STAND_IN_ROOM_M
        best, least = waypoint, math.inf
        for radius in np.arange(_STAND_IN_STEP_M, settings.stand_in_distance_m + 1e-9, _STAND_IN_STEP_M):
            for angle in np.arange(0.0, 2.0 * np.pi, min(0.5, _STAND_IN_STEP_M / radius)):
                point = waypoint + radius * np.array([math.cos(angle), math.sin(angle)])
                # Twice the offset: near the waypoint, and on this side of the obstacle when that is equal.
                cost = 2.0 * radius + float(np.hypot(*(point - start)))
                if cost < least and field.clearance(point) >= wanted:
                    best, least = point, cost
        return best

    def is_free(self, field: ClearanceField, point: FloatArray) -> bool:
        """Whether the vehicle may be at a point (2,) at all."""
        return field.clearance(point) >= self.least_clearance

    def local_goal(
        self,
        field: ClearanceField,
        start: FloatArray,
        goal: FloatArray,
        visited: FloatArray,
        previous: FloatArray | None,
    ) -> FloatArray:
        """Return the goal if it is near, else the best free point of the local circle.

        That is the one nearest to the goal; where the vehicle has been in vain counts as farther away, and
        so does a change of mind: points far from the `previous` local goal (2,), if any.
        """
        radius = self._settings.local_radius_m
        offset = goal - start
        if float(np.hypot(*offset)) <= radius:
            return goal
        angles = math.atan2(offset[1], offset[0]) + np.arange(0.0, 2.0 * np.pi, _CIRCLE_STEP)
        circle = start + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        rooms = np.array([field.clearance(point) for point in circle])
        cost = _cost_to_go(circle, goal, visited)
        if previous is not None:
            cost = cost + _CHANGE_OF_MIND * np.hypot(*(circle - previous).T)
        for wanted in (self.clearances[0], self.least_clearance):
            if np.any(rooms >= wanted):
                return np.asarray(circle[np.argmin(np.where(rooms >= wanted, cost, np.inf))])
        return np.asarray(circle[0])

    def search(
        self,
        field: ClearanceField,
        start: FloatArray,
        goal: FloatArray,
        visited: FloatArray,
        previous: FloatArray | None,
    ) -> LocalPath:
        """Find a path to a local goal, with ever less clearance if need be.

        Args:
            field: distances to obstacles.
            start: (2,) where the vehicle is, m.
            goal: (2,) local goal, m.
            visited: (k, 2) where the vehicle has been in vain: detours elsewhere are preferred.
            previous: (m, 2) path flown so far, if any: of several paths found, one that passes obstacles
                on the same side is preferred.

        Returns:
            A path to the goal; if none is found a path to the best place reached; or no path.
        """
        nodes = 0
        detour: LocalPath | None = None
        for clearance in self.clearances:
            ends = np.array([[*start, self._granted(field, start)], [*goal, self._granted(field, goal)]])
            if field.is_segment_free(start, goal, clearance, ends):
                points = np.stack([start, goal])
                return LocalPath(SearchStatus.REACHED, points, clearance, ends, nodes)
            tree, parents, reached = self._tree(field, clearance, ends)
            nodes += tree.shape[0]
            if reached >= 0:
                candidates = [self._shortened(field, _branch(tree, parents, reached), clearance, ends)]
                for _ in range(self._settings.extra_trees):
                    if nodes > _MOST_TREES * self._settings.max_nodes:
                        break
                    tree, parents, reached = self._tree(field, clearance, ends)
                    nodes += tree.shape[0]
                    if reached >= 0:
                        branch = _branch(tree, parents, reached)
                        candidates.append(self._shortened(field, branch, clearance, ends))
                points = min(candidates, key=lambda path: length_of(path) + _side_change(path, previous))
                return LocalPath(SearchStatus.REACHED, points, clearance, ends, nodes)
            if detour is None:
                leaf = self._best_leaf(tree, goal, visited)
                if leaf > 0:
                    ends[1] = [*tree[leaf], clearance]
                    points = self._shortened(field, _branch(tree, parents, leaf), clearance, ends)
                    detour = LocalPath(SearchStatus.DETOUR, points, clearance, ends, nodes)
        if detour is not None:
            return detour
        return replace(NO_PATH, nodes=nodes)

    def nearest_reachable(
        self, field: ClearanceField, start: FloatArray, goal: FloatArray
    ) -> FloatArray | None:
        """Return the place nearest to a goal (2,) that a tree reaches; None if that is too far from it."""
        ends = np.array([[*start, self._granted(field, start)], [*goal, np.inf]])
        for clearance in self.clearances:
            tree, _, _ = self._tree(field, clearance, ends)
            gaps = np.hypot(*(tree - goal).T)
            nearest = int(np.argmin(gaps))
            if gaps[nearest] <= self._settings.stand_in_distance_m:
                return np.asarray(tree[nearest])
        return None

    def _granted(self, field: ClearanceField, point: FloatArray) -> float:
        return field.clearance(point) - _GRANTED_SLACK_M

    def _tree(
        self, field: ClearanceField, clearance: float, ends: FloatArray
    ) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.int64]], int]:
        settings = self._settings
        nodes = np.zeros((settings.max_nodes, 2))
        parents = np.zeros(settings.max_nodes, np.int64)
        samples = self._rng.random((_SAMPLES_PER_NODE * settings.max_nodes, 3))
        count, reached = rrt_kernels.grow_tree(
            field.distance, field.corner_map[0], field.corner_map[1], field.cell_m, clearance, ends, samples,
            settings.local_radius_m + settings.sample_margin_m, settings.goal_bias, settings.step_m,
            nodes, parents,
        )  # fmt: skip
        return nodes[:count], parents[:count], reached

    def _best_leaf(self, tree: FloatArray, goal: FloatArray, visited: FloatArray) -> int:
        """Return the node well away from the start that is best to go on from, 0 if there is none."""
        away = np.hypot(*(tree - tree[0]).T)
        candidates = np.flatnonzero(away >= _DETOUR_SHARE * self._settings.local_radius_m)
        if candidates.size == 0:
            return 0
        return int(candidates[np.argmin(_cost_to_go(tree[candidates], goal, visited))])

    def _shortened(
        self, field: ClearanceField, path: FloatArray, clearance: float, ends: FloatArray
    ) -> FloatArray:
        picks = self._rng.random((self._settings.shortcuts, 2))
        rows = np.zeros((path.shape[0] + 2 * picks.shape[0], 2))
        rows[: path.shape[0]] = path
        count = rrt_kernels.cut_corners(
            field.distance, field.corner_map[0], field.corner_map[1], field.cell_m, clearance, ends, picks,
            rows, path.shape[0],
        )  # fmt: skip
        return rows[:count].copy()


def length_of(points: FloatArray) -> float:
    """Return the length of a polyline (n, 2), m."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _side_change(points: FloatArray, previous: FloatArray | None) -> float:
    """Return how far the first metres of a path lead away from the path flown so far, m."""
    if previous is None:
        return 0.0
    gaps = [
        rrt_kernels.locate(previous, *rrt_kernels.point_at(points, s), 0.0, math.inf)[1]
        for s in _COMPARED_AT_M
    ]
    return max(gaps)


def _branch(tree: FloatArray, parents: np.ndarray[tuple[int], np.dtype[np.int64]], leaf: int) -> FloatArray:
    order = [leaf]
    while parents[order[-1]] >= 0:
        order.append(int(parents[order[-1]]))
    return tree[order[::-1]].copy()


def _cost_to_go(points: FloatArray, goal: FloatArray, visited: FloatArray) -> FloatArray:
    """Distances (n,) to the goal, plus a metre for every time the vehicle has been near a point in vain."""
    gaps = np.hypot(*(points[:, None, :] - visited[None, :, :]).transpose(2, 0, 1))
    visits = np.count_nonzero(gaps < _BEEN_THERE_M, axis=1)
    return np.asarray(np.hypot(*(points - goal).T) + _BEEN_THERE_COST_M * visits)
