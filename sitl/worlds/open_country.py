"""Flat open country: nothing at all to fly round, pillars, and what stands on the horizon."""

import math

import numpy as np
from numpy.random import Generator

from companion.messages import FloatArray
from sitl.worlds.course import GOAL_DISTANCE_M, Course
from sitl.worlds.pillars import fill_with_pillars
from sitl.worlds.primitives import World
from sitl.worlds.surfaces import boxes, cylinders, ground, together

PILLAR_RADIUS_M = (0.2, 0.5)
PILLAR_HEIGHT_M = 5.0
FIELD_MARGIN_M = 10.0
HORIZON_M = (15.0, 25.0)
"""Least and greatest distance between the course and what stands on the horizon."""
_FAILURES_UNTIL_FULL = 2000
_SPACING_M = 9.0
_GROUND_SHADES = (0.15, 0.35)


def nothing(rng: Generator, course: Course) -> World:
    """Return a world without obstacles.

    On the ground alone a LiDAR's odometry knows its height and tilt but neither x, y nor heading, so a flight
    in full fidelity would fail for want of anything to measure. Real open fields have an edge; here it
    stands 15 to 25 m beside the course. That is farther than followers perceive (10 m), than distances to
    obstacles count (4 m) and than the leader plans (10 m), so nothing there affects the swarm.
    """
    return together(ground(_ground_shade(rng)), horizon(rng, course))


def horizon(rng: Generator, course: Course) -> World:
    """Return sheds and masts all round a course, every surface at least 15 m from it."""
    places, outward = _outline(course, 0.5 * (HORIZON_M[0] + HORIZON_M[1]))
    count = len(places)
    offsets = rng.uniform(-1.0, 1.0, count)
    is_shed = rng.random(count) < 0.6
    sizes = rng.uniform([2.0, 2.0, 3.0], [6.0, 5.0, 8.0], (count, 3))
    yaws, shades = rng.uniform(-math.pi, math.pi, count), rng.uniform(0.15, 0.7, count)
    radii, heights = rng.uniform(0.2, 0.6, count), rng.uniform(5.0, 9.0, count)
    feet = np.column_stack([places + offsets[:, None] * outward, np.zeros(count)])
    tops = feet + np.column_stack([np.zeros((count, 2)), heights])
    middles = feet + np.column_stack([np.zeros((count, 2)), 0.5 * sizes[:, 2]])
    sheds, masts = np.flatnonzero(is_shed), np.flatnonzero(~is_shed)
    return together(
        boxes(middles[sheds], sizes[sheds], yaws[sheds], shades[sheds]),
        cylinders(feet[masts], tops[masts], radii[masts], shades[masts]),
    )


def _outline(course: Course, away_m: float) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 2) spread round a course at one distance, and the directions (n, 2) away from it."""
    centre = course.points_world.mean(axis=0)
    reach = float(np.hypot(*(course.points_world - centre).T).max()) + away_m
    azimuths = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    directions = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    near, far = np.zeros(len(azimuths)), np.full(len(azimuths), reach)
    # Along a way out from the middle the distance may rise and fall more than once. Halving finds one place
    # where it passes `away_m`, or stays in the middle if that is farther away already.
    for _ in range(40):
        middle = 0.5 * (near + far)
        inside = course.distance(centre + middle[:, None] * directions) < away_m
        near, far = np.where(inside, middle, near), np.where(inside, far, middle)
    line = centre + far[:, None] * directions
    steps = np.hypot(*(np.roll(line, -1, axis=0) - line).T)
    along = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    count = max(8, round(float(steps.sum()) / _SPACING_M))
    picks = np.searchsorted(along, np.linspace(0.0, float(steps.sum()), count, endpoint=False))
    return line[picks], directions[picks]


def pillars(rng: Generator, course: Course, gap_m: float) -> World:
    """Return a square full of upright pillars round the start that reaches 10 m beyond the farthest waypoint.

    Args:
        rng: source of chance.
        course: kept free at its ends.
        gap_m: least distance between the surfaces of any two pillars.
    """
    low, high = square_around(course)
    rods = fill_with_pillars(
        rng,
        low,
        high,
        radius_m=PILLAR_RADIUS_M,
        height_m=PILLAR_HEIGHT_M,
        free=course.free(),
        gap_m=gap_m,
        failures_until_full=_FAILURES_UNTIL_FULL,
    )
    shades = rng.uniform(0.1, 0.8, len(rods))
    return together(ground(_ground_shade(rng)), cylinders(rods[:, :3], rods[:, 3:6], rods[:, 6], shades))


def square_around(course: Course) -> tuple[FloatArray, FloatArray]:
    """Return the corners (2,) of the square round the start in which obstacles of open country stand.

    It reaches 10 m beyond the farthest waypoint, and beyond the usual distance of a goal in any case.
    """
    farthest = float(np.hypot(*(course.waypoints_world - course.spawn_world).T).max())
    reach = max(farthest, GOAL_DISTANCE_M) + FIELD_MARGIN_M
    return course.spawn_world - reach, course.spawn_world + reach


def _ground_shade(rng: Generator) -> float:
    return float(rng.uniform(*_GROUND_SHADES))
