"""The leader's path search over the true obstacles of a site, from the start to the last waypoint."""

import numpy as np

from companion.control.leader.obstacle_map import ClearanceField
from companion.control.leader.rrt import RrtPlanner
from companion.control.leader.settings import RrtSettings
from companion.messages import FloatArray
from sitl.worlds.primitives import World
from sitl.worlds.sites import Site

VEHICLE_RADIUS_M = 0.2
HEIGHTS_M = (1.3, 1.75, 2.2)
_CELL_M = 0.4
_ADVANCE_M = 4.0
_SEARCHES = 60


def field_of(obstacles: World, low: FloatArray, high: FloatArray) -> ClearanceField:
    """Distances to what stands at flying height in the square round an area."""
    side = int(np.ceil((high - low).max() / _CELL_M)) + 1
    first = np.array([*np.floor(low / _CELL_M), 0], np.int64)
    axis = (np.arange(side) + 0.5) * _CELL_M
    x, y = np.meshgrid(first[0] * _CELL_M + axis, first[1] * _CELL_M + axis, indexing="ij")
    distance = np.full(x.shape, 3.0)
    for z in HEIGHTS_M:
        distance = np.minimum(distance, obstacles.clearance(np.stack([x, y, np.full_like(x, z)], axis=-1)))
    distance = np.maximum(distance, 0.0)
    return ClearanceField(
        corner_map=np.asarray(first[:2] * _CELL_M, np.float64),
        cell_m=_CELL_M,
        distance=distance.astype(np.float32),
        blocked=(distance < 0.5 * _CELL_M).astype(np.uint8),
        surface=np.zeros((side, side, 2), np.float32),
        first=first,
    )


def leaders_way(site: Site, rng: np.random.Generator) -> FloatArray | None:
    """Return the path (n, 2) found by one local search after the other, None if the leader gets stuck."""
    points = np.vstack([site.spawn_world, site.waypoints_world])
    field = field_of(site.world.obstacles(), points.min(axis=0) - 9.0, points.max(axis=0) + 9.0)
    planner = RrtPlanner(RrtSettings(extra_trees=0), VEHICLE_RADIUS_M, rng)
    way, visited = [site.spawn_world], np.zeros((0, 2))
    for waypoint in site.waypoints_world:
        for _ in range(_SEARCHES):
            if np.hypot(*(waypoint - way[-1])) < 0.5:
                break
            local_goal = planner.local_goal(field, way[-1], waypoint, visited, None)
            path = planner.search(field, way[-1], local_goal, visited, None).points
            if len(path) == 0:
                return None
            visited = np.vstack([visited, way[-1]])
            way += list(_beginning(path, _ADVANCE_M))
        else:
            return None
    return np.array(way)


def _beginning(path: FloatArray, length_m: float) -> FloatArray:
    """Return the corners of the first metres of a polyline, without its start."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    end = min(length_m, float(along[-1]))
    last = np.array([np.interp(end, along, path[:, 0]), np.interp(end, along, path[:, 1])])
    return np.vstack([path[1:][along[1:] < end], last])


def densely(way: FloatArray, spacing_m: float = 0.1) -> FloatArray:
    """Return points (m, 2) along a polyline."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    s = np.linspace(0.0, along[-1], int(along[-1] / spacing_m) + 2)
    return np.column_stack([np.interp(s, along, way[:, 0]), np.interp(s, along, way[:, 1])])
