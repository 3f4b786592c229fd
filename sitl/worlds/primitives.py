"""Worlds as sets of primitives: what rays hit and what vehicles collide with.

World frame: z up, metres. The same models read a YAML list of primitives and are built by generators.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, Strict, model_validator

from companion.messages import ByteArray, FloatArray
from companion.settings import Settings
from sitl.array_layout import laid_out
from sitl.worlds.casting_kernels import cast_rays
from sitl.worlds.clearance_kernels import find_contacts, measure_clearances
from sitl.worlds.raycast_kernels import BOX, CAPSULE, CYLINDER, PLANE, SPHERE

Vector = Annotated[tuple[float, float, float], Strict(False)]
Row = tuple[float, float, float, float, float, float, float, float]
Disc = tuple[float, float, float]

_CONTACT_TOLERANCE_M = 1e-3


class Surface(Settings):
    """How any primitive reflects."""

    reflectivity: float = Field(default=0.3, ge=0.0, le=1.0)
    """Diffuse reflectivity at 905 nm; for a retro-reflector, the strength of its return."""

    retro_reflective: bool = False
    """The surface sends light straight back (tape, a road sign)."""


class Ground(Surface):
    """Endless horizontal plane."""

    shape: Literal["ground"] = "ground"
    height_m: float = 0.0
    """z of the plane."""


class Sphere(Surface):
    """Ball."""

    shape: Literal["sphere"] = "sphere"
    centre_world_m: Vector
    """Its centre."""
    radius_m: float = Field(gt=0.0)
    """Its radius."""


class _Rod(Surface):
    start_world_m: Vector
    """Centre of one end (a pillar's foot)."""
    end_world_m: Vector
    """Centre of the other end."""
    radius_m: float = Field(gt=0.0)
    """Radius of the cross-section."""

    @model_validator(mode="after")
    def _has_length(self) -> "_Rod":
        if math.dist(self.start_world_m, self.end_world_m) < 1e-6:
            raise ValueError("start_world_m and end_world_m must differ")
        return self


class Cylinder(_Rod):
    """Upright or tilted cylinder with flat caps."""

    shape: Literal["cylinder"] = "cylinder"


class Capsule(_Rod):
    """Cylinder with hemispherical ends, which lie beyond `start_world_m` and `end_world_m`."""

    shape: Literal["capsule"] = "capsule"


class Box(Surface):
    """Cuboid, turned about the vertical only."""

    shape: Literal["box"] = "box"
    centre_world_m: Vector
    """Its centre."""
    size_m: Annotated[
        tuple[
            Annotated[float, Field(gt=0.0)], Annotated[float, Field(gt=0.0)], Annotated[float, Field(gt=0.0)]
        ],
        Strict(False),
    ]
    """Full length, width and height."""
    yaw_deg: float = 0.0
    """Heading of its length axis, counter-clockwise from world x."""


Primitive = Annotated[Ground | Sphere | Cylinder | Capsule | Box, Field(discriminator="shape")]
"""One entry of a world's YAML list, told apart by its key ``shape``."""


def _row_of(primitive: Ground | Sphere | Cylinder | Capsule | Box) -> tuple[int, Row, Disc]:
    if isinstance(primitive, Ground):
        return PLANE, (0.0, 0.0, primitive.height_m, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, math.inf)
    if isinstance(primitive, Sphere):
        x, y, z = primitive.centre_world_m
        return SPHERE, (x, y, z, 0.0, 0.0, 0.0, 0.0, primitive.radius_m), (x, y, primitive.radius_m)
    if isinstance(primitive, Box):
        x, y, z = primitive.centre_world_m
        half_x, half_y, half_z = (0.5 * size for size in primitive.size_m)
        yaw = math.radians(primitive.yaw_deg)
        row = (x, y, z, half_x, half_y, half_z, math.cos(yaw), math.sin(yaw))
        return BOX, row, (x, y, math.hypot(half_x, half_y))
    start, end = np.array(primitive.start_world_m), np.array(primitive.end_world_m)
    length = float(np.linalg.norm(end - start))
    ux, uy, uz = ((end - start) / length).tolist()
    x, y, z = start.tolist()
    mx, my, _ = (0.5 * (start + end)).tolist()
    reach = 0.5 * length * math.hypot(ux, uy) + primitive.radius_m
    kind = CAPSULE if isinstance(primitive, Capsule) else CYLINDER
    return kind, (x, y, z, ux, uy, uz, length, primitive.radius_m), (mx, my, reach)


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Nearest hits of n rays.

    Attributes:
        ranges: (n,) metres, infinity where nothing was hit.
        indices: (n,) primitive hit, -1 where nothing was hit.
        cosines: (n,) absolute cosine of the angle of incidence.
    """

    ranges: FloatArray
    indices: NDArray[np.int32]
    cosines: FloatArray


def _no_bodies() -> NDArray[np.int32]:
    return np.empty((0, 2), np.int32)


def _no_poses() -> FloatArray:
    return np.empty((0, 8))


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Primitives as contiguous arrays, ready for kernels: fixed ones, then the parts of moving bodies.

    Bodies join a world through `sitl.worlds.bodies.Bodies`.

    Attributes:
        kinds: (m,) kind of each primitive (see `sitl.worlds.raycast_kernels`).
        rows: (m, 8) its shape; of a body's part in the body's frame.
        discs: (f, 3) x, y, radius of a vertical cylinder around each of the f fixed primitives; the
            radius of a plane is infinite.
        reflectivity: (m,) 0 to 1.
        retro_reflective: (m,) 1 for a retro-reflector.
        bodies: (b, 2) first part of each body and one past its last.
        poses: (b, 8) position, attitude and radius of an enclosing sphere of each body.
    """

    kinds: NDArray[np.int32]
    rows: FloatArray
    discs: FloatArray
    reflectivity: FloatArray
    retro_reflective: ByteArray
    bodies: NDArray[np.int32] = field(default_factory=_no_bodies)
    poses: FloatArray = field(default_factory=_no_poses)

    @classmethod
    def of(cls, primitives: Iterable[Ground | Sphere | Cylinder | Capsule | Box]) -> "World":
        """Build a world of primitives; an empty one is allowed."""
        entries = list(primitives)
        described = [_row_of(primitive) for primitive in entries]
        return cls(
            kinds=np.array([kind for kind, _, _ in described], np.int32),
            rows=np.array([row for _, row, _ in described], np.float64).reshape(-1, 8),
            discs=np.array([disc for _, _, disc in described], np.float64).reshape(-1, 3),
            reflectivity=np.array([entry.reflectivity for entry in entries], np.float64),
            retro_reflective=np.array([entry.retro_reflective for entry in entries], np.uint8),
        )

    def __len__(self) -> int:
        """Return the number of primitives, parts of bodies included."""
        return len(self.kinds)

    def joined(self, other: "World") -> "World":
        """Return the fixed primitives of both worlds in one.

        Raises:
            ValueError: if there are bodies in either.
        """
        if len(self.bodies) or len(other.bodies):
            raise ValueError("worlds can be joined only before bodies enter them")
        return World(
            kinds=np.concatenate([self.kinds, other.kinds]),
            rows=np.concatenate([self.rows, other.rows]),
            discs=np.concatenate([self.discs, other.discs]),
            reflectivity=np.concatenate([self.reflectivity, other.reflectivity]),
            retro_reflective=np.concatenate([self.retro_reflective, other.retro_reflective]),
        )

    def obstacles(self) -> "World":
        """Return the same world without its ground planes."""
        keep = self.kinds != PLANE
        return World(
            kinds=self.kinds[keep],
            rows=self.rows[keep],
            discs=self.discs[keep[: len(self.discs)]],
            reflectivity=self.reflectivity[keep],
            retro_reflective=self.retro_reflective[keep],
            bodies=(self.bodies - np.count_nonzero(~keep)).astype(np.int32),
            poses=self.poses,
        )

    def bodies_of(self, indices: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the number of the body to which primitives (n,) belong, -1 for fixed ones and for -1."""
        return np.searchsorted(self.bodies[:, 0], indices, side="right") - 1

    def bounds_xy(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and greatest x, y (2,) of all bounded fixed primitives.

        Raises:
            ValueError: if there is none.
        """
        discs = self.discs[np.isfinite(self.discs[:, 2])]
        if len(discs) == 0:
            raise ValueError("a world without bounded primitives has no bounds")
        return (discs[:, :2] - discs[:, 2:]).min(axis=0), (discs[:, :2] + discs[:, 2:]).max(axis=0)

    def cast(self, origins_world: ArrayLike, directions_world: ArrayLike, max_range_m: float) -> Hits:
        """Return the nearest hits of rays from origins (n, 3) along unit directions (n, 3)."""
        origins = laid_out(origins_world)
        directions = laid_out(directions_world)
        if origins.shape != directions.shape or origins.ndim != 2 or origins.shape[1] != 3:
            raise ValueError(f"origins {origins.shape} and directions {directions.shape} must both be (n, 3)")
        hits = Hits(np.empty(len(origins)), np.empty(len(origins), np.int32), np.empty(len(origins)))
        cast_rays(
            origins, directions, self.kinds, self.rows, self.discs, self.bodies, self.poses,
            float(max_range_m), hits.ranges, hits.indices, hits.cosines,
        )  # fmt: skip
        return hits

    def clearance(self, points_world: ArrayLike) -> FloatArray:
        """Return the signed distance (...) from points (..., 3) to the nearest surface, negative inside."""
        points = np.asarray(points_world, dtype=np.float64)
        flat = laid_out(points.reshape(-1, 3))
        distances, indices = np.empty(len(flat)), np.empty(len(flat), np.int32)
        measure_clearances(
            flat, self.kinds, self.rows, self.discs, self.bodies, self.poses, distances, indices
        )
        return distances.reshape(points.shape[:-1])

    def first_contact(self, starts_world: ArrayLike, ends_world: ArrayLike, radius_m: float) -> FloatArray:
        """Return where along segments (..., 3) a sphere first touches a surface.

        Returns:
            Fractions (...) of the segment from 0 to 1, infinity where the sphere passes freely. Contacts
            shallower than a millimetre may be missed.
        """
        starts, ends = np.broadcast_arrays(
            np.asarray(starts_world, dtype=np.float64), np.asarray(ends_world, dtype=np.float64)
        )
        fractions = np.empty(starts[..., 0].size)
        find_contacts(
            laid_out(starts.reshape(-1, 3)), laid_out(ends.reshape(-1, 3)),
            float(radius_m), _CONTACT_TOLERANCE_M, self.kinds, self.rows, self.discs,
            self.bodies, self.poses, fractions,
        )  # fmt: skip
        return fractions.reshape(starts.shape[:-1])
