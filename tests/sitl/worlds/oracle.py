"""Slow, readable geometry: signed distances from definitions, and rays followed until the sign changes."""

import math

import numpy as np
from numpy.typing import ArrayLike

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Sphere

AnyPrimitive = Ground | Sphere | Cylinder | Capsule | Box

_STEP_M = 0.01


def signed_distance(primitive: AnyPrimitive, points: ArrayLike) -> FloatArray:
    """Return distances (n,) of points (n, 3), negative inside."""
    distances: FloatArray = _signed_distance(primitive, np.asarray(points, dtype=np.float64))
    return distances


def _length(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _signed_distance(primitive: AnyPrimitive, p: FloatArray) -> FloatArray:
    if isinstance(primitive, Ground):
        return p[:, 2] - primitive.height_m
    if isinstance(primitive, Sphere):
        return _length(p - np.array(primitive.centre_world_m)) - primitive.radius_m
    if isinstance(primitive, Box):
        q_box_world = rotation.from_yaw(-math.radians(primitive.yaw_deg))
        excess = (
            np.abs(rotation.rotate(q_box_world, p - primitive.centre_world_m))
            - np.array(primitive.size_m) / 2
        )
        outside = _length(np.maximum(excess, 0.0))
        depth: FloatArray = np.minimum(excess.max(axis=1), 0.0)
        return outside + depth
    start, end = np.array(primitive.start_world_m), np.array(primitive.end_world_m)
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    axial = (p - start) @ axis
    if isinstance(primitive, Capsule):
        foot = start + np.clip(axial, 0.0, length)[:, None] * axis
        return _length(p - foot) - primitive.radius_m
    radial = _length(p - start - axial[:, None] * axis) - primitive.radius_m
    beyond = np.maximum(-axial, axial - length)
    outside = np.hypot(np.maximum(radial, 0.0), np.maximum(beyond, 0.0))
    distance: FloatArray = outside + np.minimum(np.maximum(radial, beyond), 0.0)
    return distance


def follow_ray(
    primitive: AnyPrimitive, origin: FloatArray, direction: FloatArray, max_range: float
) -> tuple[float, float]:
    """Return (range of the first change of sign or infinity, least distance seen before it).

    A ray that touches without crossing a whole step is told by the small second number.
    """
    t = np.arange(0.0, max_range + _STEP_M, _STEP_M)
    distances = signed_distance(primitive, origin + t[:, None] * direction)
    changes = np.flatnonzero(np.signbit(distances[1:]) != np.signbit(distances[:-1]))
    if len(changes) == 0:
        return math.inf, float(np.abs(distances).min())
    low, high = float(t[changes[0]]), float(t[changes[0] + 1])
    before = np.signbit(distances[changes[0]])
    for _ in range(50):
        middle = 0.5 * (low + high)
        inside = np.signbit(signed_distance(primitive, (origin + middle * direction)[None])[0])
        low, high = (middle, high) if inside == before else (low, middle)
    return 0.5 * (low + high), float(np.abs(distances[: changes[0]]).min(initial=math.inf))


def normal_at(primitive: AnyPrimitive, point: FloatArray) -> FloatArray:
    """Return the gradient (3,) of the signed distance."""
    offsets = 1e-6 * np.eye(3)
    rise = signed_distance(primitive, point + offsets) - signed_distance(primitive, point - offsets)
    return rise / _length(rise)


def random_directions(rng: np.random.Generator, n: int) -> FloatArray:
    """Return n unit vectors, uniform on the sphere."""
    vectors = rng.standard_normal((n, 3))
    return vectors / _length(vectors)[:, None]


def random_primitives(rng: np.random.Generator, n: int, extent: float) -> list[AnyPrimitive]:
    """Return the ground below everything and n bodies of all kinds."""

    def place() -> tuple[float, float, float]:
        x, y, z = rng.uniform(-extent, extent, 3).tolist()
        return x, y, z

    bodies: list[AnyPrimitive] = [Ground(height_m=-extent - 2.0)]
    for k in range(n):
        a, radius = place(), float(rng.uniform(0.2, 1.2))
        turned = np.array(a) + random_directions(rng, 1)[0] * rng.uniform(0.5, 4.0)
        b = (float(turned[0]), float(turned[1]), float(turned[2]))
        size = (float(rng.uniform(0.3, 3)), float(rng.uniform(0.3, 3)), float(rng.uniform(0.3, 3)))
        kinds: list[AnyPrimitive] = [
            Sphere(centre_world_m=a, radius_m=radius),
            Cylinder(start_world_m=a, end_world_m=b, radius_m=radius),
            Capsule(start_world_m=a, end_world_m=b, radius_m=radius),
            Box(centre_world_m=a, size_m=size, yaw_deg=float(rng.uniform(-180, 180))),
            Cylinder(start_world_m=a, end_world_m=(a[0], a[1], a[2] + 3.0), radius_m=radius),
        ]
        bodies.append(kinds[k % 5])
    return bodies


def centre_of(primitive: AnyPrimitive) -> FloatArray:
    """Return a point (3,) in the middle of a body, or on the ground."""
    if isinstance(primitive, Ground):
        return np.array([0.0, 0.0, primitive.height_m])
    if isinstance(primitive, Sphere | Box):
        return np.array(primitive.centre_world_m)
    middle: FloatArray = 0.5 * (np.array(primitive.start_world_m) + np.array(primitive.end_world_m))
    return middle
