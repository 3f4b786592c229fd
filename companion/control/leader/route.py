"""The present local path: when to search anew, when to keep the old one, where on it the vehicle is."""

import math
from dataclasses import replace

import numpy as np

from companion.clock import seconds_to_ns
from companion.control.leader import rrt_kernels
from companion.control.leader.obstacle_map import ClearanceField
from companion.control.leader.rrt import NO_PATH, LocalPath, RrtPlanner, SearchStatus, length_of
from companion.control.leader.settings import RrtSettings
from companion.messages import FloatArray

_CLEARANCE_SLACK_M = 0.15
_BACKWARD_M = 0.5
_FORWARD_M = 3.0
_NEARLY_OVER_M = 1.0
_WINDING = 1.5
_MUCH_SHORTER = 0.5
_SAME_PLACE_M = 1.5
_TRAIL_SPACING_M = 1.0
_TRAIL_POINTS = 100
_PROGRESS_M = 1.0
_LEAST_LOOK_AHEAD_M = 0.4


class Route:
    """Holds the leader's local path and replaces it for a reason only."""

    def __init__(self, settings: RrtSettings, vehicle_radius_m: float, rng: np.random.Generator) -> None:
        self._settings = settings
        self._planner = RrtPlanner(settings, vehicle_radius_m, rng)
        self.path: LocalPath | None = None
        """The path being followed, None without one."""
        self.status = ""
        """Outcome of the last search: "planned", "kept" or "no path"; empty before the first."""
        self.goal = np.full(2, np.nan)
        """Where to stop for the waypoint, (2,) m."""
        self.nodes = 0
        """Size of the trees of the last search."""
        self.reset()

    def reset(self) -> None:
        """Drop the path."""
        self.path = None
        self.status = ""
        self.nodes = 0
        self._waypoint = np.full(2, np.nan)
        self._s = 0.0
        self._searched_ns: int | None = None
        self._field: ClearanceField | None = None
        self._blocked = False
        self._winding = False
        self._trail = np.zeros((0, 2))
        self._least_distance = math.inf
        self._progress_ns = 0
        self._stand_in: FloatArray | None = None

    def update(self, field: ClearanceField, p: FloatArray, waypoint: FloatArray, t_ns: int) -> bool:
        """Follow the vehicle along the path and search anew when due.

        Args:
            field: what the map knows.
            p: (2,) position of the vehicle in the map, m.
            waypoint: (2,) horizontal position of the waypoint, m.
            t_ns: host time.

        Returns:
            Whether a search was made.
        """
        cross_track = self._locate(p)
        if field is not self._field:
            self._field = field
            self._blocked = not self._is_free(field, self._settings.blocked_horizon_m)
        if np.array_equal(waypoint, self._waypoint):
            if not self._is_due(t_ns, cross_track):
                return False
        else:
            self._waypoint = waypoint.copy()
            self._trail = np.zeros((0, 2))
            self._least_distance = math.inf
            self._stand_in = None
            self.goal = waypoint.copy()
            self.path = None
        self._searched_ns = t_ns
        self._note_progress(p, t_ns)
        self.goal = self._reachable_goal(field, p, t_ns)
        previous = None if self.path is None else self.path.points
        end = None if previous is None else previous[-1]
        local_goal = self._planner.local_goal(field, p, self.goal, self._trail, end)
        found = self._planner.search(field, p, local_goal, self._trail, previous)
        self.nodes = found.nodes
        # Even a path to the goal is vain when following such paths brought it no nearer for that long.
        if self._is_hopeless(t_ns, 2) or (self._is_hopeless(t_ns) and not _ends_at(found, self.goal)):
            found = NO_PATH
            self.path = None
        kept = self._kept(field, found, cross_track)
        if kept is not None:
            self._adopt(kept, "kept", p)
        elif found.status is SearchStatus.NO_PATH:
            self.path = None
            self.status = "no path"
        else:
            self._adopt(found, "planned", p)
            # The way out of a dead end looks worse than staying in it, so it is flown to its end.
            chord = float(np.hypot(*(found.points[-1] - found.points[0])))
            self._winding = length_of(found.points) > _WINDING * chord
        self._blocked = False
        return True

    def ahead(self, field: ClearanceField, p: FloatArray, look_ahead: float) -> tuple[FloatArray, bool]:
        """Return the point of the path to head for, (2,), and whether the straight line to it is free.

        It lies `look_ahead` metres on, and nearer where the straight line would cut a corner.
        """
        path = self._present()
        ends = np.array([[p[0], p[1], field.clearance(p) - _CLEARANCE_SLACK_M], path.ends[1]])
        wanted = path.clearance - _CLEARANCE_SLACK_M
        while True:
            point = np.array(rrt_kernels.point_at(path.points, self._s + look_ahead))
            is_open = field.is_segment_free(p, point, wanted, ends)
            if is_open or look_ahead <= _LEAST_LOOK_AHEAD_M:
                return point, is_open
            look_ahead = max(0.75 * look_ahead, _LEAST_LOOK_AHEAD_M)

    def beyond(self, distance: float) -> FloatArray:
        """Return the point of the path `distance` metres farther on than the vehicle, (2,)."""
        return np.array(rrt_kernels.point_at(self._present().points, self._s + distance))

    def remaining(self, p: FloatArray) -> FloatArray:
        """Return the path still to be flown as a polyline (n, 2) from the vehicle at `p`, (0, 2) without."""
        if self.path is None:
            return np.zeros((0, 2))
        return np.concatenate([p[None, :], self._rest(self.path.points)[1:]])

    def _present(self) -> LocalPath:
        if self.path is None:
            raise ValueError("there is no path to follow")
        return self.path

    def _locate(self, p: FloatArray) -> float:
        if self.path is None:
            return 0.0
        self._s, cross_track, _ = rrt_kernels.locate(
            self.path.points, p[0], p[1], self._s - _BACKWARD_M, self._s + _FORWARD_M
        )
        return cross_track

    def _is_due(self, t_ns: int, cross_track: float) -> bool:
        if self._searched_ns is None:
            return True
        settings = self._settings
        wrong = self.path is None or self._blocked or cross_track > settings.max_cross_track_m
        period = settings.retry_period_s if wrong else settings.replan_period_s
        return t_ns - self._searched_ns >= seconds_to_ns(period)

    def _adopt(self, path: LocalPath, status: str, p: FloatArray) -> None:
        self.path = path
        self.status = status
        self._s = 0.0
        self._locate(p)

    def _kept(self, field: ClearanceField, found: LocalPath, cross_track: float) -> LocalPath | None:
        """Return the present path, continued to the new local goal, if it is worth keeping."""
        path = self.path
        if path is None or cross_track > self._settings.max_cross_track_m:
            return None
        if not self._is_free(field, math.inf):
            return None
        rest = self._rest(path.points)
        if self._winding and length_of(rest) > _NEARLY_OVER_M and not self._is_much_shorter(found, rest):
            return replace(path, points=rest)
        if found.status is not SearchStatus.REACHED:
            return replace(path, points=rest) if length_of(rest) > _NEARLY_OVER_M else None
        if path.status is not SearchStatus.REACHED or path.clearance < found.clearance:
            return None
        goal = found.points[-1]
        ends = np.stack([path.ends[0], found.ends[1]])
        wanted = path.clearance - _CLEARANCE_SLACK_M
        candidate = np.concatenate([rest, goal[None, :]])
        # The old end need not be visited when the new goal can be seen from the point before it.
        if rest.shape[0] >= 2 and field.is_segment_free(rest[-2], goal, wanted, ends):
            candidate = np.concatenate([rest[:-1], goal[None, :]])
        elif not field.is_segment_free(rest[-1], goal, wanted, ends):
            return None
        if length_of(candidate) > self._settings.keep_ratio * length_of(found.points):
            return None
        return replace(path, points=candidate, ends=ends)

    def _is_much_shorter(self, found: LocalPath, rest: FloatArray) -> bool:
        if found.status is not SearchStatus.REACHED:
            return False
        # A shorter way to the same place is simply better; one to another place may end where we came from.
        same_place = np.hypot(*(found.points[-1] - rest[-1])) < _SAME_PLACE_M
        share = 1.0 / self._settings.keep_ratio if same_place else _MUCH_SHORTER
        return length_of(found.points) < share * length_of(rest)

    def _rest(self, points: FloatArray) -> FloatArray:
        """Return the part of the path past the vehicle's nearest point, that point first."""
        start = np.array(rrt_kernels.point_at(points, self._s))
        reached = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        later = points[reached > self._s + 1e-6]
        return np.concatenate([start[None, :], later])

    def _is_free(self, field: ClearanceField, horizon: float) -> bool:
        path = self.path
        if path is None:
            return True
        s_to = min(self._s + horizon, length_of(path.points))
        walked = rrt_kernels.free_length(
            field.distance, field.corner_map[0], field.corner_map[1], field.cell_m,
            path.clearance - _CLEARANCE_SLACK_M, path.ends, path.points, self._s, s_to,
        )  # fmt: skip
        return walked >= s_to - self._s - 1e-6

    def _reachable_goal(self, field: ClearanceField, p: FloatArray, t_ns: int) -> FloatArray:
        """Return where to stop for the waypoint, after long vain attempts the nearest place reachable."""
        if self._stand_in is not None and not self._planner.is_free(field, self._stand_in):
            self._stand_in = None
        if self._stand_in is None and self._is_hopeless(t_ns):
            self._stand_in = self._planner.nearest_reachable(field, p, self._waypoint)
        if self._stand_in is not None:
            return self._stand_in
        return self._planner.reachable_goal(field, p, self._waypoint, self.goal)

    def _is_hopeless(self, t_ns: int, times: int = 1) -> bool:
        return t_ns - self._progress_ns > times * seconds_to_ns(self._settings.patience_s)

    def _note_progress(self, p: FloatArray, t_ns: int) -> None:
        """Remember where the vehicle has been since it last came nearer to the waypoint."""
        distance = float(np.hypot(*(self._waypoint - p)))
        if distance < self._least_distance - _PROGRESS_M:
            self._least_distance = distance
            self._progress_ns = t_ns
            self._trail = np.zeros((0, 2))
        if self._trail.shape[0] == 0 or np.hypot(*(self._trail[-1] - p)) > _TRAIL_SPACING_M:
            self._trail = np.concatenate([self._trail[-_TRAIL_POINTS + 1 :], p[None, :]])


def _ends_at(path: LocalPath, goal: FloatArray) -> bool:
    return path.status is SearchStatus.REACHED and np.array_equal(path.points[-1], goal)
