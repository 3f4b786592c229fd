"""The `pacnav` law with paths as lists, slow and plain."""

from itertools import pairwise
from typing import Any

import numpy as np

from companion.control.followers.settings import CommandSettings
from companion.messages import FloatArray
from tests.control.followers.oracles import clipped, directions, flat_columns, present, turned

Path = list[tuple[int, FloatArray]]


def steps(path: Path, still: float) -> dict[int, FloatArray]:
    """Unit step from each beat of a path to the next; none where it is no longer than noise."""
    result = {}
    for (beat, here), (_, there) in pairwise(path):
        size = np.linalg.norm(there - here)
        result[beat] = (there - here) / size if size > still else np.zeros(2)
    return result


def persistence(path: Path, still: float) -> float:
    u = list(steps(path, still).values())
    return float(np.mean([a @ b for a, b in pairwise(u)])) if len(path) > 2 else -1.0


def similarity(path: Path, other: Path, still: float) -> float:
    u, w = steps(path, still), steps(other, still)
    both = sorted(u.keys() & w.keys())
    return float(np.mean([u[beat] @ w[beat] for beat in both])) if both else -1.0


class Pacnav:
    def __init__(self, gains: Any, command: CommandSettings) -> None:
        self.gains = gains
        self.paths: dict[int, Path] = {}
        self.last: dict[int, FloatArray] = {}
        self.age: dict[int, float] = {}
        self.beat, self.since = 0, 0.0
        self.target: int | None = None
        self.places: list[int | None] = []

    def __call__(
        self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray, previous_map: FloatArray
    ) -> FloatArray:
        self._remember(ego, neighbours)
        self._choose(ego)
        n = self._navigation(ego)
        previous = turned(previous_map, -ego[6])
        g = self.gains
        v = g.navigation_per_s * n
        columns = flat_columns(ranges)
        forces = []
        index = 0
        while index < 72:
            if columns[index] < g.obstacle_reach_m + g.body_radius_m:
                o = columns[index] * directions()[index]
                forces.append(self._force(o, g.obstacle_mps, g.obstacle_reach_m, previous))
                index += 3
            else:
                index += 1
        v = v + (np.mean(forces, axis=0) if forces else 0.0)
        reach = g.force_reach_m + g.body_radius_m
        near = [r for r in self._held(ego) if np.linalg.norm(r) - g.body_radius_m <= reach]
        if near:
            v = v + np.mean([self._force(r, g.force_mps, reach, previous) for r in near], axis=0)
        return clipped(v, g.max_speed_mps)

    def _remember(self, ego: FloatArray, neighbours: FloatArray) -> None:
        g = self.gains
        for number in self.age:
            self.age[number] += ego[8]
        for row in present(neighbours):
            number = int(row[7])
            self.last[number] = ego[:2] + turned(row, ego[6])
            self.age[number] = 0.0
            if number not in self.paths:
                self.paths[number] = [(self.beat, self.last[number])]
                free = self.places.index(None) if None in self.places else len(self.places)
                self.places[free : free + 1] = [number]
        self.since += ego[8]
        if self.since < g.beat_s - 1e-6:
            return
        self.since = max(self.since - g.beat_s, 0.0)
        self.beat += 1
        for number in list(self.paths):
            path = self.paths[number]
            if self.age[number] <= g.hold_s:
                if path[-1][0] < self.beat - 1:
                    path.clear()
                path.append((self.beat, self.last[number]))
            oldest = self.beat - min(round(g.history_s / g.beat_s), 23)
            path[:] = [sample for sample in path if sample[0] >= oldest]
            if not path:
                del self.paths[number]
                self.places[self.places.index(number)] = None

    def _held(self, ego: FloatArray) -> list[FloatArray]:
        """Where those are who are seen, or were until just now, in the order of their places."""
        known = [j for j in self.places if j is not None and self.age[j] <= self.gains.hold_s]
        return [turned(self.last[j] - ego[:2], -ego[6]) for j in known]

    def _score(self, number: int) -> float:
        others = [j for j in self.paths if j != number and self.age[j] <= self.gains.hold_s]
        path = self.paths[number]
        still = self.gains.still_m
        return persistence(path, still) + sum(similarity(path, self.paths[j], still) for j in others)

    def _choose(self, ego: FloatArray) -> None:
        watched = self.beat * self.gains.beat_s
        if watched < self.gains.settle_s - 1e-6 or not self._held(ego):
            self.target = None
            return
        away = {j: float(np.linalg.norm(self.last[j] - ego[:2])) for j in self.paths}
        # In the order of their places in the memory, which decides between several.
        known = [j for j in self.places if j is not None]
        candidates = [j for j in known if away[j] > self.gains.flock_radius_m]
        if self.target not in self.paths:
            self.target = min(candidates, key=lambda j: away[j]) if candidates else None
        for j in candidates:
            if self.target is None or j == self.target:
                continue
            goal = self.last[self.target]
            new, old = self.paths[j][-1][1], self.paths[j][0][1]
            converging = np.linalg.norm(new - goal) < np.linalg.norm(old - goal)
            if not converging and self._score(j) > self._score(self.target):
                self.target = j

    def _navigation(self, ego: FloatArray) -> FloatArray:
        g = self.gains
        if self.target is None:
            return np.zeros(2)
        n = turned(self.last[self.target] - ego[:2], -ego[6])
        for r in self._held(ego):
            e = r / np.linalg.norm(r)
            gap = max(np.linalg.norm(r) - g.body_radius_m, 0.01)
            s = 1.0 if gap > g.flock_radius_m else (gap / g.flock_radius_m) ** 8
            if n @ e > 0.0:
                n = (n - (n @ e) * e) + s * (n @ e) * e
        return n

    def _force(self, o: FloatArray, strength: float, reach: float, previous: FloatArray) -> FloatArray:
        g = self.gains
        gap = max(np.linalg.norm(o) - g.body_radius_m, 0.01)
        if gap > reach:
            return np.zeros(2)
        size = strength * (1.0 / np.sqrt(gap) - 1.0 / np.sqrt(reach))
        back: FloatArray = -size * o / np.linalg.norm(o)
        if np.linalg.norm(previous) < 0.017:
            return back
        phi = 0.5 * np.pi * gap / reach
        return max((turned(back, phi), turned(back, -phi)), key=lambda f: float(f @ previous))
