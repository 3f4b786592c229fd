"""The laws once more, slow and plain, in NumPy: what the kernels must agree with.

Every oracle returns the horizontal velocity (2,) that its law wants in the heading frame, before the limits
that all laws share; `Shared` adds those.
"""

from typing import Any

import numpy as np

from companion.control.followers.settings import CommandSettings
from companion.messages import FloatArray
from tests.control.followers.situations import AZIMUTH_CENTRES, ELEVATION_CENTRES, ELEVATION_EDGES


def turned(v: FloatArray, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]]) @ v[:2]


def present(neighbours: FloatArray) -> list[FloatArray]:
    return [row for row in neighbours if row[6] > 0.5]


def clipped(v: FloatArray, limit: float) -> FloatArray:
    size = float(np.linalg.norm(v))
    return v * limit / size if size > limit else v


def flat_columns(ranges: FloatArray, highest_deg: float = 20.0) -> FloatArray:
    """Nearest horizontal distance in each column, cells centred up to an elevation."""
    rows = np.radians(highest_deg) >= ELEVATION_CENTRES
    flat: FloatArray = ranges * np.cos(ELEVATION_CENTRES)
    return np.asarray(flat[:, rows].min(axis=1))


def band_columns(ranges: FloatArray, below: float, above: float) -> FloatArray:
    """Nearest horizontal distance in each column, cells that reach into a band of heights."""
    result = np.full(len(ranges), np.inf)
    for row, centre in enumerate(ELEVATION_CENTRES):
        lowest = ranges[:, row] * np.sin(ELEVATION_EDGES[row])
        highest = ranges[:, row] * np.sin(ELEVATION_EDGES[row + 1])
        hit = np.isfinite(ranges[:, row]) & (lowest <= above) & (highest >= -below)
        result[hit] = np.minimum(result[hit], ranges[hit, row] * np.cos(centre))
    return result


def directions() -> FloatArray:
    return np.column_stack([np.cos(AZIMUTH_CENTRES), np.sin(AZIMUTH_CENTRES)])


class Shared:
    """Height, limits of speed and acceleration, and the previous command in the map."""

    def __init__(self, settings: CommandSettings) -> None:
        self.settings = settings
        self.previous_map = np.zeros(3)

    def height(self, ego: FloatArray, neighbours: FloatArray) -> float:
        seen = present(neighbours)
        wanted = np.mean([row[2] for row in seen]) if seen else self.settings.recovery_height_m - ego[7]
        limit = self.settings.height_speed_mps
        return float(np.clip(self.settings.height_per_s * wanted, -limit, limit))

    def finish(self, ego: FloatArray, wish: FloatArray) -> FloatArray:
        command = wish.copy()
        command[2] = np.clip(
            wish[2], -self.settings.max_vertical_speed_mps, self.settings.max_vertical_speed_mps
        )
        command = clipped(command, self.settings.max_speed_mps)
        before = np.append(turned(self.previous_map, -ego[6]), self.previous_map[2])
        command = before + clipped(command - before, self.settings.max_acceleration_mps2 * ego[8])
        self.previous_map = np.append(turned(command, ego[6]), command[2])
        return command


class Reynolds:
    def __init__(self, gains: Any, command: CommandSettings) -> None:
        self.gains, self.limit = gains, command.max_speed_mps
        self.smooth_map = np.zeros(2)

    def __call__(self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray) -> FloatArray:
        g = self.gains
        v = np.zeros(2)
        seen = present(neighbours)
        for row in seen:
            r = row[:2]
            v += g.cohesion_per_s * r - g.separation_m2ps * r / (r @ r)
            v += g.alignment * (row[3:5] + ego[3:5])
        v /= max(len(seen), 1)
        share = 1.0 if g.low_pass_s == 0.0 else 1.0 - np.exp(-ego[8] / g.low_pass_s)
        self.smooth_map += share * (turned(v, ego[6]) - self.smooth_map)
        v = turned(self.smooth_map, -ego[6])
        columns = flat_columns(ranges)
        for sector in np.arange(72).reshape(12, 6):
            nearest = sector[np.argmin(columns[sector])]
            gap = max(columns[nearest] - g.body_radius_m, 0.05)
            if gap < g.obstacle_reach_m:
                size = g.obstacle_m3ps * (1.0 / gap - 1.0 / g.obstacle_reach_m) / gap**2
                v = v - min(size, self.limit) * directions()[nearest]
        return v


def visible(neighbours: FloatArray, radius: float) -> list[FloatArray]:
    """Neighbours whose middle no nearer one covers."""
    seen = present(neighbours)
    result = []
    for row in seen:
        hidden = False
        for other in seen:
            near, far = np.linalg.norm(other[:3]), np.linalg.norm(row[:3])
            if near < far:
                apart = np.arccos(np.clip(row[:3] @ other[:3] / near / far, -1.0, 1.0))
                hidden = hidden or bool(apart < np.arcsin(np.minimum(1.0, radius / near)))
        if not hidden:
            result.append(row)
    return result


def blobs(ranges: FloatArray, reach: float) -> FloatArray:
    """Sum over blobs of adjacent near columns of 2 sin(width / 2) times the direction of the middle."""
    near = flat_columns(ranges) < reach
    if near.all() or not near.any():
        return np.zeros(2)
    start = int(np.argmin(near))
    total = np.zeros(2)
    blob: list[int] = []
    for index in [*range(start, start + 72), start]:
        if near[index % 72] and index != start:
            blob.append(index)
        elif blob:
            middle = np.radians(5.0 * (np.mean(blob) + 0.5))
            total += 2.0 * np.sin(np.radians(2.5 * len(blob))) * np.array([np.cos(middle), np.sin(middle)])
            blob = []
    return total


def field_strength(half: float, edge: float) -> float:
    return float(2.0 * (edge * np.cos(half) - np.sin(half)))


class Vpf:
    def __init__(self, gains: Any, command: CommandSettings) -> None:
        self.gains = gains

    def __call__(self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray) -> FloatArray:
        g = self.gains
        v = np.zeros(2)
        seen = visible(neighbours, g.body_radius_m)
        for row in seen:
            distance = np.linalg.norm(row[:3])
            half = np.arcsin(min(1.0, g.body_radius_m / distance))
            v += g.gain_mps * field_strength(half, g.edge) * row[:2] / distance
        if seen:
            v += g.alignment * np.mean([row[3:5] + ego[3:5] for row in seen], axis=0)
        v -= g.obstacle_mps * blobs(ranges, g.obstacle_reach_m)
        return v


class VpfPolar:
    def __init__(self, gains: Any, command: CommandSettings) -> None:
        self.gains, self.limit = gains, command.max_speed_mps
        self.speed, self.course_map = 0.0, None

    def __call__(self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray) -> FloatArray:
        g = self.gains
        if self.course_map is None:
            self.course_map = ego[6]
        course = self.course_map - ego[6]
        faster = turn = 0.0
        for row in visible(neighbours, g.body_radius_m):
            distance = np.linalg.norm(row[:3])
            half = np.arcsin(min(1.0, g.body_radius_m / distance))
            along = turned(row[:2] / distance, -course)
            faster += field_strength(half, g.speed_edge) * along[0]
            turn += field_strength(half, g.turn_edge) * along[1]
        away = turned(blobs(ranges, g.obstacle_reach_m), -course)
        faster -= g.obstacle * away[0]
        turn -= g.obstacle * away[1]
        self.speed += ego[8] * g.relaxation_per_s * (g.cruise_mps - self.speed)
        self.speed = float(np.clip(self.speed + ego[8] * g.speed_gain_mps2 * faster, -self.limit, self.limit))
        course += ego[8] * g.turn_gain_per_s * turn
        self.course_map = course + ego[6]
        return self.speed * np.array([np.cos(course), np.sin(course)])


class Lloyd:
    def __init__(self, gains: Any, command: CommandSettings) -> None:
        self.gains = gains
        self.spread, self.turn = gains.spread_m, 0.0

    def __call__(self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray) -> FloatArray:
        g = self.gains
        planes: list[tuple[FloatArray, float]] = []
        goal = np.zeros(2)
        seen = present(neighbours)
        for row in seen:
            d = float(np.linalg.norm(row[:2]))
            planes.append((row[:2] / d, min(0.5 * d, d - g.spacing_m)))
            goal += (row[:2] + g.look_ahead_s * (row[3:5] + ego[3:5])) / len(seen)
        columns = flat_columns(ranges)
        for direction, distance in zip(directions(), columns, strict=True):
            if np.isfinite(distance):
                planes.append((direction, distance - g.obstacle_room_m))
        spread = self.spread
        c, whole = self._centroids(turned(goal, -self.turn), spread, planes)
        stuck = np.linalg.norm(c) < g.stuck_m and np.linalg.norm(c - whole) > g.hindered_m
        dt = ego[8]
        self.spread += dt * ((g.least_spread_m if stuck else g.spread_m) - self.spread)
        self.turn += dt * ((0.5 * np.pi if stuck else 0.0) - self.turn)
        if self.turn > 0.95 * 0.5 * np.pi:
            straight, _ = self._centroids(goal, spread, planes)
            if np.linalg.norm(c) > np.linalg.norm(straight):
                self.turn = 0.0
        v: FloatArray = g.gain_per_s * c
        for row in seen:
            d = float(np.linalg.norm(row[:2]))
            v = v - g.retreat_per_s * max(-min(0.5 * d, d - g.spacing_m), 0.0) * row[:2] / d
        nearest = int(np.argmin(columns))
        missing = max(g.obstacle_room_m - float(columns[nearest]), 0.0)
        v -= g.retreat_per_s * missing * directions()[nearest]
        return v

    def _centroids(
        self, goal: FloatArray, spread: float, planes: list[tuple[FloatArray, float]]
    ) -> tuple[FloatArray, FloatArray]:
        radius = self.gains.radius_m
        offset = max(np.linalg.norm(goal) - radius, 0.0)
        cell: list[FloatArray] = []
        disc: list[FloatArray] = []
        for angle in (np.arange(36) + 0.5) * 2.0 * np.pi / 36:
            ray = np.array([np.cos(angle), np.sin(angle)])
            limits = [max(b, 0.0) / (n @ ray) for n, b in planes if n @ ray > 0.0]
            for reach, into in ((min([radius, *limits]), cell), (radius, disc)):
                for r in (np.arange(8) + 0.5) / 8 * reach:
                    weight = r * reach * np.exp((offset - np.linalg.norm(r * ray - goal)) / spread)
                    into.append(np.array([weight, *(weight * r * ray)]))
        inside, outside = np.sum(cell, axis=0), np.sum(disc, axis=0)
        if inside[0] <= 1e-12:
            return np.zeros(2), np.zeros(2)
        return inside[1:] / inside[0], outside[1:] / outside[0]
