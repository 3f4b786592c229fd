"""The metrics once more: slow, readable, one loop for every sign in the formulas."""

import math
from collections.abc import Sequence

Vector = Sequence[float]
STILL_MPS = 0.05


def norm(a: Vector) -> float:
    return math.sqrt(sum(x * x for x in a))


def minus(a: Vector, b: Vector) -> list[float]:
    return [x - y for x, y in zip(a, b, strict=True)]


def mean_vector(vectors: Sequence[Vector]) -> list[float]:
    return [sum(v[axis] for v in vectors) / len(vectors) for axis in range(3)]


def flock_radius(p: Sequence[Sequence[Vector]]) -> float:
    total = 0.0
    for positions in p:
        centre = mean_vector(positions)
        farthest = 0.0
        for position in positions:
            farthest = max(farthest, norm(minus(position, centre)))
        total += farthest
    return total / len(p)


def minimum_separation(p: Sequence[Sequence[Vector]]) -> float:
    total = 0.0
    for positions in p:
        closest = math.inf
        for i, first in enumerate(positions):
            for j, second in enumerate(positions):
                if i != j:
                    closest = min(closest, norm(minus(first, second)))
        total += closest
    return total / len(p)


def alignment(v: Sequence[Sequence[Vector]]) -> float:
    total, steps = 0.0, 0
    for velocities in v:
        average = mean_vector(velocities)
        cosines = []
        for velocity in velocities:
            if norm(velocity) < STILL_MPS or norm(average) <= 1e-9:
                continue
            dot = sum(a * b for a, b in zip(velocity, average, strict=True))
            cosines.append(dot / (norm(velocity) * norm(average)))
        if cosines:
            total += sum(cosines) / len(cosines)
            steps += 1
    return total / steps if steps else math.nan


def obstacle_distance(p: Sequence[Sequence[Vector]], points: Sequence[Vector], cap_m: float) -> float:
    total, steps = 0.0, 0
    for positions in p:
        closest = math.inf
        for position in positions:
            for point in points:
                closest = min(closest, norm(minus(position, point)))
        if closest < cap_m:
            total += closest
            steps += 1
    return total / steps if steps else math.nan


def mission_progress(start: Vector, goal: Vector, ends: Sequence[Vector]) -> float:
    total = 0.0
    for end in ends:
        progress = (1.0 - norm(minus(end, goal)) / norm(minus(start, goal))) * 100.0
        total += max(0.0, min(100.0, progress))
    return total / len(ends)
