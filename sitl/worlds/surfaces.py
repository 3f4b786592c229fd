"""Many primitives of one kind at once, from arrays: what generators use instead of one model a body."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.messages import FloatArray
from sitl.worlds.primitives import World
from sitl.worlds.raycast_kernels import BOX, CAPSULE, CYLINDER, PLANE, SPHERE


def ground(reflectivity: float = 0.3, height_m: float = 0.0) -> World:
    """Return an endless horizontal plane."""
    row = np.array([[0.0, 0.0, height_m, 0.0, 0.0, 0.0, 0.0, 0.0]])
    return _world(PLANE, row, np.array([[0.0, 0.0, np.inf]]), reflectivity)


def spheres(centres_world: ArrayLike, radii_m: ArrayLike, reflectivity: ArrayLike) -> World:
    """Return n balls.

    Args:
        centres_world: (n, 3) m.
        radii_m: (n,) or one for all.
        reflectivity: (n,) or one for all, 0 to 1.
    """
    centres = np.asarray(centres_world, np.float64).reshape(-1, 3)
    rows = np.zeros((len(centres), 8))
    rows[:, :3], rows[:, 7] = centres, radii_m
    return _world(SPHERE, rows, rows[:, [0, 1, 7]].copy(), reflectivity)


def cylinders(
    starts_world: ArrayLike, ends_world: ArrayLike, radii_m: ArrayLike, reflectivity: ArrayLike
) -> World:
    """Return n cylinders with flat caps between starts and ends (n, 3), m."""
    return _rods(CYLINDER, starts_world, ends_world, radii_m, reflectivity)


def capsules(
    starts_world: ArrayLike, ends_world: ArrayLike, radii_m: ArrayLike, reflectivity: ArrayLike
) -> World:
    """Return n capsules; their round ends lie beyond starts and ends (n, 3), m."""
    return _rods(CAPSULE, starts_world, ends_world, radii_m, reflectivity)


def boxes(centres_world: ArrayLike, sizes_m: ArrayLike, yaws: ArrayLike, reflectivity: ArrayLike) -> World:
    """Return n cuboids.

    Args:
        centres_world: (n, 3) m.
        sizes_m: (n, 3) full length, width and height.
        yaws: (n,) heading of the length axis, rad, or one for all.
        reflectivity: (n,) or one for all, 0 to 1.
    """
    centres = np.asarray(centres_world, np.float64).reshape(-1, 3)
    rows = np.empty((len(centres), 8))
    rows[:, :3], rows[:, 3:6] = centres, 0.5 * np.asarray(sizes_m, np.float64).reshape(-1, 3)
    rows[:, 6], rows[:, 7] = np.cos(yaws), np.sin(yaws)
    discs = np.column_stack([centres[:, :2], np.hypot(rows[:, 3], rows[:, 4])])
    return _world(BOX, rows, discs, reflectivity)


def together(*worlds: World) -> World:
    """Return the fixed primitives of all worlds in one, in order.

    Raises:
        ValueError: if there are bodies in any.
    """
    if any(len(world.bodies) for world in worlds):
        raise ValueError("worlds can be joined only before bodies enter them")
    return World(
        kinds=np.concatenate([world.kinds for world in worlds]),
        rows=np.concatenate([world.rows for world in worlds]),
        discs=np.concatenate([world.discs for world in worlds]),
        reflectivity=np.concatenate([world.reflectivity for world in worlds]),
        retro_reflective=np.concatenate([world.retro_reflective for world in worlds]),
    )


def _rods(
    kind: int, starts_world: ArrayLike, ends_world: ArrayLike, radii_m: ArrayLike, reflectivity: ArrayLike
) -> World:
    starts = np.asarray(starts_world, np.float64).reshape(-1, 3)
    ends = np.asarray(ends_world, np.float64).reshape(-1, 3)
    along = ends - starts
    lengths = np.sqrt(np.sum(along * along, axis=1))
    rows = np.empty((len(starts), 8))
    rows[:, :3], rows[:, 3:6] = starts, along / lengths[:, None]
    rows[:, 6], rows[:, 7] = lengths, radii_m
    middles = 0.5 * (starts + ends)
    reach = 0.5 * lengths * np.hypot(rows[:, 3], rows[:, 4]) + rows[:, 7]
    return _world(kind, rows, np.column_stack([middles[:, :2], reach]), reflectivity)


def _world(kind: int, rows: FloatArray, discs: FloatArray, reflectivity: ArrayLike) -> World:
    kinds: NDArray[np.int32] = np.full(len(rows), kind, np.int32)
    shades = np.empty(len(rows))
    shades[:] = reflectivity
    return World(kinds, rows, discs, shades, np.zeros(len(rows), np.uint8))
