"""The five places where the paper's swarm flew for real, rebuilt from what the paper tells.

It tells little: names and captions of the figures (indoor cluttered blocks and wall; outdoor pillars,
display tower and short forest), that indoor space was confined, that the short forest was dense vegetation
and the hardest, and how far the nearest of five vehicles was from obstacles on average: 1.88, 4.25, 2.82,
5.82 and 1.57 m. Sizes here are choices that agree with those figures; positions vary with the generator, so
one site is many scenes of a kind. Every course starts at the origin and leads along x.
"""

import math

import numpy as np
from numpy.random import Generator

from companion.messages import FloatArray
from sitl.worlds.course import Course, spawn_clear_m
from sitl.worlds.open_country import horizon
from sitl.worlds.pillars import fill_with_pillars
from sitl.worlds.primitives import World
from sitl.worlds.surfaces import boxes, capsules, cylinders, ground, spheres, together

_HALL_X_M = (-9.0, 29.0)
_HALL_HALF_WIDTH_M = 10.0
_HALL_HEIGHT_M = 8.0
_INDOOR_GOAL_M = 20.0
_SHEET_M = 0.2

BLOCK_GAP_M = 4.0
OUTDOOR_PILLAR_GAP_M = 5.0
SHRUB_GAP_M = 3.2
PASSAGE_M = 5.0
"""Least room on either side of the indoor wall."""


def indoor_blocks(rng: Generator, followers: int) -> tuple[World, Course]:
    """Return a hall full of upright blocks, 4 m apart and from the walls."""
    course = _course(_INDOOR_GOAL_M, followers)
    rods = fill_with_pillars(
        rng,
        np.array([_HALL_X_M[0] + BLOCK_GAP_M, BLOCK_GAP_M - _HALL_HALF_WIDTH_M]),
        np.array([_HALL_X_M[1] - BLOCK_GAP_M, _HALL_HALF_WIDTH_M - BLOCK_GAP_M]),
        radius_m=(0.4, 0.8),
        height_m=1.0,
        free=course.free(),
        gap_m=BLOCK_GAP_M,
        failures_until_full=500,
    )
    count = len(rods)
    heights, angles = rng.uniform(2.2, 3.6, count), rng.uniform(0.6, 0.95, count)
    # A block with this diagonal stands inside its rod whichever way it is turned.
    sides = 2.0 * rods[:, 6:] * np.column_stack([np.cos(angles), np.sin(angles)])
    middles = np.column_stack([rods[:, :2], 0.5 * heights])
    blocks = boxes(
        middles, np.column_stack([sides, heights]), rng.uniform(-math.pi, math.pi, count),
        rng.uniform(0.2, 0.8, count),
    )  # fmt: skip
    return together(_hall(rng), blocks), course


def indoor_wall(rng: Generator, followers: int) -> tuple[World, Course]:
    """Return a hall with one high wall across the way; there is room at both its ends, more at one."""
    course = _course(_INDOOR_GOAL_M, followers)
    length, height = rng.uniform(5.0, 6.5), 4.2
    most = _HALL_HALF_WIDTH_M - 0.5 * length - PASSAGE_M
    middle = [rng.uniform(9.0, 11.0), rng.uniform(-most, most), 0.5 * height]
    wall = boxes([middle], [[0.3, length, height]], np.zeros(1), rng.uniform(0.3, 0.7, 1))
    return together(_hall(rng), wall), course


def outdoor_pillars(rng: Generator, followers: int) -> tuple[World, Course]:
    """Return upright pillars, 5 m apart, along a way in the open, with sheds and masts on the horizon."""
    course = _course(30.0, followers)
    rods = fill_with_pillars(
        rng,
        np.array([0.0, -8.0]),
        np.array([32.0, 8.0]),
        radius_m=(0.25, 0.45),
        height_m=4.5,
        free=course.free(),
        gap_m=OUTDOOR_PILLAR_GAP_M,
        failures_until_full=20,
    )
    shades = rng.uniform(0.3, 0.7, len(rods))
    standing = cylinders(rods[:, :3], rods[:, 3:6], rods[:, 6], shades)
    return together(_lawn(rng), standing, horizon(rng, course)), course


def display_tower(rng: Generator, followers: int) -> tuple[World, Course]:
    """Return one tower of screens on four legs across the way in the open."""
    course = _course(36.0, followers)
    x, y, yaw = 18.0 + rng.uniform(-1.0, 1.0), rng.uniform(-0.8, 0.8), rng.uniform(-math.pi, math.pi)
    half = rng.uniform(1.3, 1.7)
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    corners = half * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) @ turn.T + [x, y]
    legs = cylinders(_at(corners, 0.0), _at(corners, 6.5), 0.12, 0.5)
    sides = half * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]) @ turn.T + [x, y]
    screens = boxes(
        _at(sides, 3.4), [[0.15, 1.8 * half, 5.0]] * 4, yaw + 0.5 * math.pi * np.arange(4),
        rng.uniform(0.1, 0.4, 4),
    )  # fmt: skip
    plinth = boxes([[x, y, 0.3]], [[2.4 * half, 2.4 * half, 0.6]], np.array([yaw]), 0.5)
    roof = boxes([[x, y, 6.6]], [[2.4 * half, 2.4 * half, 0.2]], np.array([yaw]), 0.5)
    mast = cylinders([[x, y, 6.7]], [[x, y, 9.0]], 0.08, 0.5)
    return together(_lawn(rng), plinth, legs, screens, roof, mast, horizon(rng, course)), course


def short_forest(rng: Generator, followers: int) -> tuple[World, Course]:
    """Return dense shrubs and small trees, up to 3.2 m high, 3.2 m from leaf to leaf."""
    course = _course(24.0, followers)
    rods = fill_with_pillars(
        rng,
        np.array([-8.0, -10.0]),
        np.array([32.0, 10.0]),
        radius_m=(0.35, 0.9),
        height_m=1.0,
        free=course.free(),
        gap_m=SHRUB_GAP_M,
        failures_until_full=1000,
    )
    count, each = len(rods), 4
    tops = rng.uniform(1.6, 3.2, (count, 1))
    leaf = rods[:, 6:] * rng.uniform(0.45, 0.7, (count, each))
    away = (rods[:, 6:] - leaf) * np.sqrt(rng.random((count, each)))
    azimuths = rng.uniform(-math.pi, math.pi, (count, each))
    lowest = np.minimum(0.3 + leaf, tops - leaf)
    heights = lowest + (tops - leaf - lowest) * rng.random((count, each))
    heights[:, 0] = tops[:, 0] - leaf[:, 0]
    leaves = np.stack(
        [rods[:, :1] + away * np.cos(azimuths), rods[:, 1:2] + away * np.sin(azimuths), heights], axis=-1
    )
    # The stem ends in the topmost ball; twigs stand out of the others by a hand's breadth at most.
    stems = cylinders(rods[:, :3], leaves[:, 0] * [0, 0, 1] + rods[:, :3], 0.04, 0.3)
    feet = np.column_stack([rods[:, :2], np.full(count, 0.2)])
    twigs = capsules(feet, leaves[:, 1], 0.015, 0.3)
    shades = np.repeat(rng.uniform(0.3, 0.6, count), each)
    green = spheres(leaves.reshape(-1, 3), leaf.ravel(), shades)
    return together(_lawn(rng), stems, twigs, green, horizon(rng, course)), course


def _course(length_m: float, followers: int) -> Course:
    return Course(np.zeros(2), spawn_clear_m(followers), np.array([[length_m, 0.0]]))


def _hall(rng: Generator) -> World:
    """Return floor, four walls and ceiling of a hall."""
    (x0, x1), w, h = _HALL_X_M, _HALL_HALF_WIDTH_M, _HALL_HEIGHT_M
    middle, length, out = 0.5 * (x0 + x1), x1 - x0, 0.5 * _SHEET_M
    centres = [
        [middle, w + out, 0.5 * h],
        [middle, -w - out, 0.5 * h],
        [x0 - out, 0.0, 0.5 * h],
        [x1 + out, 0.0, 0.5 * h],
        [middle, 0.0, h + out],
    ]
    sizes = [
        [length, _SHEET_M, h],
        [length, _SHEET_M, h],
        [_SHEET_M, 2.0 * w, h],
        [_SHEET_M, 2.0 * w, h],
        [length, 2.0 * w, _SHEET_M],
    ]
    floor = ground(float(rng.uniform(0.2, 0.5)))
    return together(floor, boxes(centres, sizes, np.zeros(5), rng.uniform(0.3, 0.7, 5)))


def _lawn(rng: Generator) -> World:
    return ground(float(rng.uniform(0.15, 0.35)))


def _at(places: FloatArray, height_m: float) -> FloatArray:
    return np.column_stack([places, np.full(len(places), height_m)])
