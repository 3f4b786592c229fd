"""The leader's route through a known world: one path to each waypoint, found before the trial.

The search is that of `companion.control.leader.rrt`, with the same clearances, but over the true obstacles
and all the way to the waypoint.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from companion.control.leader.map_kernels import measure_distances
from companion.control.leader.obstacle_map import ClearanceField
from companion.control.leader.rrt import LocalPath, RrtPlanner, SearchStatus
from companion.control.leader.settings import LeaderSettings
from companion.messages import FloatArray
from sitl.abstract.field_kernels import block_columns
from sitl.abstract.leader_kernels import N_LEADER_PARAMETERS
from sitl.swarm.scene import SwarmScene

_MARGIN_M = 12.0
_LEAST_SIDE, _GREATEST_SIDE = 128, 1024
_CLEARANCE_CAP_M = 3.0
_NODES = (600, 5000)
_LONGEST_SEARCH_M = 20.0
_NOWHERE: FloatArray = np.zeros((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What the leader's kernel flies by.

    Attributes:
        field: the flight plane.
        legs: (k, r, 2) path to each waypoint, the last point repeated.
        ends: (k, 2, 3) its first and last point with the clearance found there.
        clearances: (k,) room that it keeps, m.
        rules: the leader's settings in the order of `leader_kernels`.
        reached: (k,) whether a path to the waypoint was found.
    """

    field: ClearanceField
    legs: FloatArray
    ends: FloatArray
    clearances: FloatArray
    rules: FloatArray
    reached: NDArray[np.bool_]


def plan_course(scene: SwarmScene, settings: LeaderSettings, rng: Generator) -> Course:
    """Find the leader's route.

    Args:
        scene: the world and the way.
        settings: of the leader; its mission is the scene's.
        rng: draws the trees.
    """
    field = flight_plane(scene, settings)
    paths = []
    start = scene.starts_world[0, :2]
    for waypoint in scene.waypoints_world[:, :2]:
        path = _path(field, start, waypoint, settings, rng)
        paths.append(path)
        start = waypoint
    legs = np.empty((len(paths), max(len(path.points) for path in paths), 2))
    for leg, path in zip(legs, paths, strict=True):
        leg[: len(path.points)] = path.points
        leg[len(path.points) :] = path.points[-1]
    return Course(
        field=field,
        legs=legs,
        ends=np.array([path.ends for path in paths]),
        clearances=np.array([path.clearance for path in paths]),
        rules=_rules(scene, settings, field),
        reached=np.array([path.status is SearchStatus.REACHED for path in paths]),
    )


def flight_plane(scene: SwarmScene, settings: LeaderSettings) -> ClearanceField:
    """Return the distances to obstacles at the leader's height, round the whole way."""
    map_settings = settings.obstacle_map
    points = np.vstack([scene.starts_world[:1, :2], scene.waypoints_world[:, :2]])
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    cell = map_settings.cell_m
    side = _LEAST_SIDE
    while side * cell < float((high - low).max()):
        if side < _GREATEST_SIDE:
            side *= 2
        else:
            cell *= 2.0
    # The corner lies on the lattice of cells, as that of the map which is made in flight.
    first = np.array([*np.floor((0.5 * (low + high) - 0.5 * side * cell) / cell), 0.0]).astype(np.int64)
    corner = np.asarray(first[:2] * cell, np.float64)
    heights = np.array([scene.starts_world[0, 2], *scene.waypoints_world[:, 2]])
    world = scene.world.obstacles()
    blocked = np.zeros((side, side), np.uint8)
    offsets = np.zeros((side, side, 2), np.float32)
    block_columns(
        world.kinds, world.rows, world.discs, float(heights.min() - map_settings.band_below_m),
        float(heights.max() + map_settings.band_above_m), corner[0], corner[1], cell, blocked, offsets,
    )  # fmt: skip
    distance = np.zeros((side, side), np.float32)
    measure_distances(
        blocked, cell, math.ceil(_CLEARANCE_CAP_M / cell), np.zeros((side, side), np.int32), distance
    )
    # The storage of offsets wraps, see `ClearanceField`.
    surface = np.ascontiguousarray(np.roll(offsets, (int(first[0] % side), int(first[1] % side)), (0, 1)))
    return ClearanceField(corner, cell, distance, blocked, surface, first)


def _path(
    field: ClearanceField, start: FloatArray, goal: FloatArray, settings: LeaderSettings, rng: Generator
) -> LocalPath:
    """Return a path to a goal; a straight line if there is none, for the potential field to do its best."""
    away = float(np.hypot(*(goal - start)))
    for nodes in _NODES:
        rrt = settings.rrt.model_copy(
            update={"local_radius_m": max(away, settings.rrt.local_radius_m), "max_nodes": nodes}
        )
        planner = RrtPlanner(rrt, settings.vehicle_radius_m, rng)
        path = planner.search(field, start, goal, _NOWHERE, None)
        if path.status is SearchStatus.REACHED:
            return path
    ends = np.array([[*start, field.clearance(start)], [*goal, field.clearance(goal)]])
    return LocalPath(SearchStatus.NO_PATH, np.stack([start, goal]), planner.least_clearance, ends, 0)


def _rules(scene: SwarmScene, settings: LeaderSettings, field: ClearanceField) -> FloatArray:
    mission, potential = settings.mission, settings.potential_field
    rules = np.array(
        [
            settings.vehicle_radius_m,
            scene.speed_mps,
            max(mission.max_speed_mps, scene.speed_mps),
            scene.wait_s,
            scene.ramp_s,
            mission.arrival_radius_m,
            mission.brake_gain_per_s,
            mission.vertical_gain_per_s,
            mission.max_vertical_speed_mps,
            potential.look_ahead_m,
            potential.attraction,
            potential.repulsion,
            potential.repulsion_distance_m,
            potential.max_repulsion,
            potential.escape_threshold,
            potential.least_drive,
            potential.speed_per_room_per_s,
            potential.least_speed_mps,
            potential.prediction_s,
            potential.low_pass_s,
            potential.max_acceleration_mps2,
            field.corner_map[0],
            field.corner_map[1],
            field.cell_m,
        ]
    )
    assert len(rules) == N_LEADER_PARAMETERS
    return rules
