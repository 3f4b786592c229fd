"""Forests: leaning trunks and rocks, with crowns and branches if wanted.

The guaranteed gap is that between the feet of stems and rocks, as a forester would measure it. Trunks lean,
so aloft two may come nearer to each other, or be farther apart. Crowns and branches reach into the gaps too;
that is what makes the forest harder than its simplified form at the same gap. They end `CROWN_REACH_M` from
their stem's axis.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from companion.messages import FloatArray
from sitl.worlds.course import Course
from sitl.worlds.open_country import square_around
from sitl.worlds.placing import FreeDisc, fill
from sitl.worlds.primitives import World
from sitl.worlds.surfaces import capsules, cylinders, ground, spheres, together

GAP_M = 5.0
CROWN_REACH_M = 2.0
"""Leaves and branches end this far from the stem's axis."""
CROWN_FLOOR_M = 1.5
"""No leaf hangs lower."""
_FAILURES_UNTIL_FULL = 2000
_BELOW_GROUND_M = 0.3
_LEAVES_EACH = 6
_BRANCHES_EACH = 2


@dataclass(frozen=True, slots=True)
class _Wood:
    """What stands in a forest; ranges are least and greatest.

    Attributes:
        trunk_radius_m: of the stems.
        trunk_length_m: from foot to top.
        greatest_lean_deg: from the vertical.
        rock_radius_m: of the balls that rocks are; up to half of one is buried.
        rock_share: of rocks among all that stands.
    """

    trunk_radius_m: tuple[float, float]
    trunk_length_m: tuple[float, float]
    greatest_lean_deg: float
    rock_radius_m: tuple[float, float]
    rock_share: float


_SIMPLIFIED = _Wood((0.2, 0.5), (4.5, 6.0), 20.0, (0.5, 1.4), 0.3)
_GROWN = _Wood((0.12, 0.3), (5.5, 8.0), 10.0, (0.4, 1.2), 0.2)


def simplified_forest(rng: Generator, course: Course) -> World:
    """Return leaning trunks without leaves, and rocks, their feet at least 5 m apart."""
    trunks, rocks = _stand(rng, course, _SIMPLIFIED, 0.0)
    return together(_floor(rng), _bark(rng, trunks), _stone(rng, rocks))


def forest(rng: Generator, course: Course) -> World:
    """Return trees with crowns from 1.5 m up and thin branches, and rocks; feet at least 5 m apart."""
    trunks, rocks = _stand(rng, course, _GROWN, CROWN_REACH_M)
    return together(
        _floor(rng), _bark(rng, trunks), _stone(rng, rocks), _crowns(rng, trunks), _branches(rng, trunks)
    )


def _stand(rng: Generator, course: Course, wood: _Wood, reach_m: float) -> tuple[FloatArray, FloatArray]:
    """Return trunks and rocks as rods (n, 7), with `reach_m` of room for leaves at the places kept free."""
    low, high = square_around(course)

    def upright_rods_of(numbers: FloatArray) -> FloatArray:
        is_rock = numbers[:, 0] < wood.rock_share
        radii = np.where(
            is_rock, _between(wood.rock_radius_m, numbers[:, 1]), _between(wood.trunk_radius_m, numbers[:, 1])
        )
        rods = np.empty((len(numbers), 7))
        rods[:, :2] = low + (high - low) * numbers[:, 2:4]
        rods[:, 2] = np.where(is_rock, 0.5 * radii * numbers[:, 4], -_BELOW_GROUND_M)
        rods[:, 3:5] = rods[:, :2]
        rods[:, 5] = rods[:, 2] + np.where(is_rock, 0.0, _between(wood.trunk_length_m, numbers[:, 4]))
        rods[:, 6] = radii
        return rods

    free = course.free(reach_m)
    rods, numbers = fill(
        rng, 7, upright_rods_of, free=free, gap_m=GAP_M, failures_until_full=_FAILURES_UNTIL_FULL
    )
    is_rock = numbers[:, 0] < wood.rock_share
    rocks, trunks = rods[is_rock], rods[~is_rock]
    leans = math.radians(wood.greatest_lean_deg) * numbers[~is_rock, 5]
    azimuths = 2.0 * math.pi * numbers[~is_rock, 6]
    lengths = trunks[:, 5] - trunks[:, 2]
    trunks[:, 3] += lengths * np.sin(leans) * np.cos(azimuths)
    trunks[:, 4] += lengths * np.sin(leans) * np.sin(azimuths)
    trunks[:, 5] = trunks[:, 2] + lengths * np.cos(leans)
    return trunks[_outside(trunks, free)], rocks


def _outside(trunks: FloatArray, free: list[FreeDisc]) -> NDArray[np.bool_]:
    """Return which trunks (n, 7) lean into none of the places kept free."""
    foot, along = trunks[:, :2], trunks[:, 3:5] - trunks[:, :2]
    squared = np.maximum(np.sum(along * along, axis=1), 1e-12)
    keep = np.ones(len(trunks), bool)
    for x, y, radius in free:
        share = np.clip(np.sum((np.array([x, y]) - foot) * along, axis=1) / squared, 0.0, 1.0)
        nearest = np.hypot(*(foot + share[:, None] * along - [x, y]).T)
        keep &= nearest >= radius + trunks[:, 6]
    return keep


def _crowns(rng: Generator, trunks: FloatArray) -> World:
    """Return some balls of leaves round the upper part of every trunk."""
    count = (len(trunks), _LEAVES_EACH)
    radii = rng.uniform(0.5, 0.9, count)
    bottoms = rng.uniform(CROWN_FLOOR_M, CROWN_FLOOR_M + 0.3, (len(trunks), 1))
    heights = bottoms + radii + rng.uniform(0.0, 1.2, count)
    centres = _beside(trunks, heights, (CROWN_REACH_M - radii) * np.sqrt(rng.random(count)), rng)
    shades = np.repeat(rng.uniform(0.3, 0.6, len(trunks)), _LEAVES_EACH)
    return spheres(centres.reshape(-1, 3), radii.ravel(), shades)


def _branches(rng: Generator, trunks: FloatArray) -> World:
    """Return some thin rods that rise from every trunk, most of them below its leaves."""
    count = (len(trunks), _BRANCHES_EACH)
    radii = rng.uniform(0.015, 0.04, count)
    starts = _axis_at(trunks, rng.uniform(0.8, 2.5, count))
    lengths, azimuths = rng.uniform(0.6, CROWN_REACH_M - 0.4, count), rng.uniform(-math.pi, math.pi, count)
    # A trunk that leans carries its branches with it; level lengths are held inside the crown's reach.
    rise = lengths * np.tan(np.radians(rng.uniform(5.0, 45.0, count)))
    ends = starts + np.stack([lengths * np.cos(azimuths), lengths * np.sin(azimuths), rise], axis=-1)
    shades = rng.uniform(0.15, 0.4, count)
    return capsules(starts.reshape(-1, 3), ends.reshape(-1, 3), radii.ravel(), shades.ravel())


def _axis_at(trunks: FloatArray, heights: FloatArray) -> FloatArray:
    """Return the points (n, k, 3) at heights (n, k) on the axes of trunks (n, 7)."""
    feet, tops = trunks[:, None, :3], trunks[:, None, 3:6]
    share = (heights - feet[..., 2]) / (tops[..., 2] - feet[..., 2])
    return np.asarray(feet + share[..., None] * (tops - feet))


def _beside(trunks: FloatArray, heights: FloatArray, away: FloatArray, rng: Generator) -> FloatArray:
    """Return points (n, k, 3) at heights (n, k), `away` (n, k) from the axes in random directions."""
    azimuths = rng.uniform(-math.pi, math.pi, heights.shape)
    points = _axis_at(trunks, heights)
    points[..., 0] += away * np.cos(azimuths)
    points[..., 1] += away * np.sin(azimuths)
    return points


def _between(limits: tuple[float, float], share: FloatArray) -> FloatArray:
    return limits[0] + (limits[1] - limits[0]) * share


def _floor(rng: Generator) -> World:
    return ground(float(rng.uniform(0.15, 0.35)))


def _bark(rng: Generator, trunks: FloatArray) -> World:
    shades = rng.uniform(0.15, 0.4, len(trunks))
    return cylinders(trunks[:, :3], trunks[:, 3:6], trunks[:, 6], shades)


def _stone(rng: Generator, rocks: FloatArray) -> World:
    return spheres(rocks[:, :3], rocks[:, 6], rng.uniform(0.2, 0.6, len(rocks)))
