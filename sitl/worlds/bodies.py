"""Rigid bodies that move through a world: other UAVs, people.

A body is a set of primitives in its own frame. `Bodies` places many of them at once, each step anew.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from companion.messages import FloatArray
from sitl.worlds.casting_kernels import turn_rods
from sitl.worlds.primitives import Primitive, World
from sitl.worlds.raycast_kernels import BOX, CAPSULE, CYLINDER, PLANE, SPHERE

_AXIS = slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Primitives in the frame of one rigid body.

    Attributes:
        parts: the primitives.
        radius_m: of a sphere about the body's origin that encloses them all.
        spinning: indices of level rods that turn about the body's z axis through their own middle
            (rotor blades).
    """

    parts: World
    radius_m: float
    spinning: tuple[int, ...]

    @classmethod
    def of(cls, primitives: Iterable[Primitive], spinning: Iterable[int] = ()) -> "Body":
        """Build a body of primitives in its own frame.

        Raises:
            ValueError: if it has no part, a ground plane, or a spinning part that is no level rod.
        """
        parts = World.of(primitives)
        spinning = tuple(spinning)
        if len(parts) == 0 or np.any(parts.kinds == PLANE):
            raise ValueError("a body needs at least one part, and a ground plane cannot be one")
        for k in spinning:
            if parts.kinds[k] not in (CYLINDER, CAPSULE) or abs(parts.rows[k, 5]) > 1e-9:
                raise ValueError(f"part {k} cannot spin: only level rods can")
        return cls(
            parts, max(_reach(kind, row) for kind, row in zip(parts.kinds, parts.rows, strict=True)), spinning
        )


def _reach(kind: int, row: FloatArray) -> float:
    """Return how far a primitive extends from the origin, or a little more."""
    if kind == SPHERE:
        return float(np.linalg.norm(row[:3]) + row[7])
    if kind == BOX:
        return float(np.linalg.norm(row[:3]) + np.linalg.norm(row[3:6]))
    ends = np.stack([row[:3], row[:3] + row[6] * row[_AXIS]])
    return float(np.linalg.norm(ends, axis=1).max() + row[7])


class Bodies:
    """Bodies in a world of fixed primitives."""

    def __init__(self, world: World, bodies: Sequence[Body]) -> None:
        """Prepare everything that does not change from step to step.

        Args:
            world: what does not move.
            bodies: what does; body k keeps number k.

        Raises:
            ValueError: if there are bodies in the world already.
        """
        if len(world.bodies):
            raise ValueError("bodies must enter a world together")
        self._world = world
        self._number = len(bodies)
        parts = [body.parts for body in bodies]
        self._kinds = np.concatenate([world.kinds, *(part.kinds for part in parts)])
        self._rows = np.concatenate([world.rows, *(part.rows for part in parts)])
        self._reflectivity = np.concatenate([world.reflectivity, *(part.reflectivity for part in parts)])
        self._retro = np.concatenate([world.retro_reflective, *(part.retro_reflective for part in parts)])
        ends = len(world) + np.cumsum([0, *(len(part) for part in parts)])
        self._parts = np.stack([ends[:-1], ends[1:]], axis=1).astype(np.int32)
        self._radii = np.array([body.radius_m for body in bodies])
        spinning = [(b, int(ends[b]) + k) for b, body in enumerate(bodies) for k in body.spinning]
        self._spinning_body = np.array([b for b, _ in spinning], np.intp)
        self._spinning = np.array([k for _, k in spinning], np.intp)
        rods = self._rows[self._spinning]
        self._half = 0.5 * rods[:, 6]
        self._hubs = rods[:, :3] + self._half[:, None] * rods[:, _AXIS]
        self._headings = np.arctan2(rods[:, 4], rods[:, 3])

    def __len__(self) -> int:
        """Return the number of bodies."""
        return self._number

    def at(self, p_world: ArrayLike, q_world_body: ArrayLike, turns: ArrayLike | None = None) -> World:
        """Return the world with the bodies in place.

        Sensors that measure during a step see bodies as if they stood still meanwhile, so their poses
        should be those at the step's middle.

        Args:
            p_world: (b, 3) positions, m.
            q_world_body: (b, 4) attitudes.
            turns: (b,) angles of the spinning parts about body z, rad; not turned by default.

        Raises:
            ValueError: if the shapes do not fit.
        """
        p, q = np.asarray(p_world, np.float64), np.asarray(q_world_body, np.float64)
        if p.shape != (self._number, 3) or q.shape != (self._number, 4):
            raise ValueError(f"{self._number} bodies need (b, 3) and (b, 4), got {p.shape} and {q.shape}")
        rows = self._rows
        if turns is not None and len(self._spinning):
            rows = self._turned(np.asarray(turns, np.float64))
        poses = np.empty((self._number, 8))
        poses[:, :3], poses[:, 3:7], poses[:, 7] = p, q, self._radii
        return World(
            self._kinds, rows, self._world.discs, self._reflectivity, self._retro, self._parts, poses
        )

    def _turned(self, turns: FloatArray) -> FloatArray:
        angles = self._headings + turns.take(self._spinning_body)
        rows = self._rows.copy()
        turn_rods(self._spinning, self._hubs, self._half, np.cos(angles), np.sin(angles), rows)
        return rows


def poses_midway(
    p_start: FloatArray, q_start: FloatArray, p_end: FloatArray, q_end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return positions (b, 3) and attitudes (b, 4) in the middle of a short step."""
    sign = np.where(np.sum(q_start * q_end, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    q = q_start + sign * q_end
    return 0.5 * (p_start + p_end), q / np.linalg.norm(q, axis=-1, keepdims=True)
