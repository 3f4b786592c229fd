"""The `flock` law with its memory in dictionaries and lists, slow and plain, in NumPy."""

from dataclasses import dataclass

import numpy as np

from companion.control.followers.flock_settings import FlockSettings
from companion.control.followers.settings import CommandSettings
from companion.messages import FloatArray
from tests.control.followers.oracles import band_columns, clipped, directions, present, turned

_SLOTS = 12
_POINTS = 48
_FLOW_COLUMNS = 9.0


@dataclass
class Known:
    """A neighbour in the map; `usual` is its velocity, smoothed over 0.3 s."""

    number: int
    age: float
    p: FloatArray
    v: FloatArray
    usual: FloatArray

    @property
    def ahead(self) -> float:
        """How far it is carried on with its velocity, s."""
        return float(np.clip(self.age, 0.0, 1.0))


@dataclass
class Seen:
    """A neighbour relative to the own body, heading frame; `trust` is less for those out of sight."""

    r: FloatArray
    z: float
    v: FloatArray
    a: FloatArray
    trust: float


@dataclass
class Plane:
    """v.n <= bound, because of what will be at `r` when a command takes effect, heading frame."""

    n: FloatArray
    bound: float
    r: FloatArray

    def is_passed(self, direction: FloatArray, clear: float) -> bool:
        """Whether nothing of it comes within `clear` of a straight flight that goes on for ever."""
        nearest = max(float(self.r @ direction), 0.0) * direction
        return float(np.linalg.norm(self.r - nearest)) >= clear


class Flock:
    """Write the wish (3,) of one vehicle, step by step."""

    def __init__(self, gains: FlockSettings, command: CommandSettings) -> None:
        self.g, self.command = gains, command
        self.slots: list[Known | None] = [None] * _SLOTS
        self.points: list[tuple[float, FloatArray]] = [(0.0, np.zeros(3))] * _POINTS
        self.wish_map = np.zeros(2)

    def __call__(self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray) -> FloatArray:
        self._remember(ego, neighbours)
        columns = band_columns(ranges, self.g.band_below_m, self.g.band_above_m)
        self._remember_obstacles(ego, columns)
        seen = self._recall(ego)
        v, rise = self._together(ego, seen)
        v = v + self._close_gaps(ego[3:5], seen)
        v = v + self._flow(columns)
        v = clipped(v, self.command.max_speed_mps)
        planes = self._obstacle_planes(ego, columns)
        v = self._detour(ego, planes, v)
        planes = [self._turned_aside(plane, v) for plane in planes] + self._neighbour_planes(ego, seen)
        for _ in range(6):
            for plane in reversed(planes):
                v = v - max(float(v @ plane.n) - plane.bound, 0.0) * plane.n
        self.wish_map = turned(v, ego[6])
        return np.append(v, rise)

    def _remember(self, ego: FloatArray, neighbours: FloatArray) -> None:
        for index, known in enumerate(self.slots):
            if known is not None:
                known.age += ego[8]
                if known.age > self.g.neighbour_memory_s:
                    self.slots[index] = None
        for row in present(neighbours):
            p = ego[:3] + np.append(turned(row, ego[6]), row[2])
            v = np.append(turned(row[3:5] + ego[3:5], ego[6]), row[5] + ego[5])
            index = self._slot(int(row[7]), p)
            before = self.slots[index]
            usual = v[:2] if before is None or before.number != int(row[7]) else before.usual
            usual = usual + ego[8] / (0.3 + ego[8]) * (v[:2] - usual)
            self.slots[index] = Known(int(row[7]), 0.0, p, v, usual)

    def _slot(self, number: int, p: FloatArray) -> int:
        for index, known in enumerate(self.slots):
            if known is not None and known.number == number:
                return index
        lost = [
            index
            for index, known in enumerate(self.slots)
            if known is not None
            and known.age > 0.0
            and np.linalg.norm(known.p + known.ahead * known.v - p) < 0.8
        ]
        if lost:
            return lost[-1]
        if None in self.slots:
            return self.slots.index(None)
        return int(np.argmax([known.age for known in self.slots if known is not None]))

    def _remember_obstacles(self, ego: FloatArray, columns: FloatArray) -> None:
        self.points = [(max(left - ego[8], 0.0), p) for left, p in self.points]
        if self.g.obstacle_memory_s <= 0.0:
            return
        for direction, distance in zip(directions(), columns, strict=True):
            if not distance < 2.0:
                continue
            there = turned(distance * direction - self.g.scan_delay_s * ego[3:5], ego[6])
            p = np.append(ego[:2] + there, ego[2])
            close = [
                index
                for index, (left, q) in enumerate(self.points)
                if left > 0.0 and np.linalg.norm(q[:2] - p[:2]) < 0.15
            ]
            index = close[0] if close else int(np.argmin([left for left, _ in self.points]))
            self.points[index] = (self.g.obstacle_memory_s, p)

    def _recall(self, ego: FloatArray) -> list[Seen]:
        seen = []
        for known in self.slots:
            if known is not None:
                r = known.p + known.ahead * known.v - ego[:3]
                trust = max(1.0 - known.age / self.g.neighbour_memory_s, 0.0)
                a = turned(known.v[:2] - known.usual, -ego[6]) / 0.3
                seen.append(Seen(turned(r, -ego[6]), r[2], turned(known.v, -ego[6]), a, trust))
        return seen

    def _together(self, ego: FloatArray, seen: list[Seen]) -> tuple[FloatArray, float]:
        g = self.g
        if sum(other.trust for other in seen) <= 0.0:
            rise: float = self.command.recovery_height_m - ego[7] if ego[9] > 1.0 else 0.0
            return float(np.exp(-ego[8] / g.coast_s)) * turned(self.wish_map, -ego[6]), rise
        push = np.zeros(2)
        velocities = [ego[3:5], *(other.v for other in seen)]
        pulls, flows = [], []
        for other in seen:
            w = other.v - ego[3:5]
            push += other.trust * self._aside(ego, other, (np.sum(velocities, axis=0) - other.v) / len(seen))
            r = other.r + g.lead_s * w
            d = float(np.linalg.norm(r))
            away = float(np.clip(np.minimum(w @ r, other.v @ r) / d, 0.0, None))
            far = max(d / g.separation_m - 1.0, 0.0)
            pulls.append((other.trust * (1.0 + g.pursuit_s_per_m * away) * (1.0 + g.far_weight * far), r))
            flows.append((other.trust * (1.0 + g.heed_s_per_m * away), other.v))
            if d < g.separation_m:
                size = g.separation_m2ps * (1.0 - d / g.separation_m) / max(d - 0.35, 0.1)
                push -= other.trust * size * r / d
        cohesion = g.cohesion_per_s * sum(w * r for w, r in pulls) / (sum(w for w, _ in pulls) + 1.0)
        follow = g.feed_forward * sum(w * v for w, v in flows) / sum(w for w, _ in flows)
        mean = sum(other.trust * other.z for other in seen) / sum(other.trust for other in seen)
        highest = max(other.z for other in seen)
        rise = (1.0 - g.top_weight) * mean + g.top_weight * highest - g.below_m
        return cohesion + follow + push, g.height_per_s * rise

    def _aside(self, ego: FloatArray, other: Seen, rest: FloatArray) -> FloatArray:
        g, r = self.g, other.r
        v = other.v + g.foresight_s * other.a
        w = v - ego[3:5]
        if r @ w >= 0.0 or w @ w < 0.01 or g.dodge_time_s <= 0.0:
            return np.zeros(2)
        soon = -(r @ w) / (w @ w)
        size = float(np.linalg.norm(r + soon * w))
        if soon >= g.dodge_time_s or size >= g.dodge_room_m:
            return np.zeros(2)
        against = -float((v - rest) @ r) / float(np.linalg.norm(r))
        fast = float(np.clip(against / g.dodge_full_mps, 0.0, 1.0))
        share = max(2.0 * fast - 1.0, 0.5 * fast**2)
        left = turned(w, np.pi / 2.0) / np.linalg.norm(w)
        s = v - turned(self.wish_map, -ego[6])
        side = left if r[0] * s[1] - r[1] * s[0] > 0.05 * np.linalg.norm(s) else -left
        return g.dodge_mps * share * (1.0 - size / g.dodge_room_m) * (1.0 - soon / g.dodge_time_s) * side

    def _close_gaps(self, own: FloatArray, seen: list[Seen]) -> FloatArray:
        total = np.zeros(2)
        for other in seen:
            d = float(np.linalg.norm(other.r))
            between = [
                third
                for third in seen
                if third is not other
                and np.linalg.norm(third.r) < d
                and np.linalg.norm(third.r - other.r) < d
            ]
            if d > self.g.link_m and not between:
                part = np.clip(1.0 + self.g.link_behind_s_per_m * (own @ other.r) / d, 0.1, 1.0)
                total += other.trust * self.g.link_per_s * part * (d - self.g.link_m) * other.r / d
        return total

    def _flow(self, columns: FloatArray) -> FloatArray:
        g = self.g
        total = np.zeros(2)
        for n, distance in zip(directions(), columns, strict=True):
            room = max(float(distance) - g.body_radius_m, 0.1)
            if room < g.flow_reach_m:
                total -= g.flow_m2ps * (1.0 / room - 1.0 / g.flow_reach_m) / _FLOW_COLUMNS * n
        return total

    def _obstacle_planes(self, ego: FloatArray, columns: FloatArray) -> list[Plane]:
        g = self.g
        found = [
            (n, float(d), g.stop_s + g.scan_delay_s)
            for n, d in zip(directions(), columns, strict=True)
            if np.isfinite(d)
        ]
        for left, p in self.points:
            rise = ego[2] - p[2]
            r = turned(p[:2] - ego[:2], -ego[6])
            d = float(np.linalg.norm(r))
            if left > 0.0 and d > 1e-6 and -g.band_below_m <= rise <= g.band_above_m:
                found.append((r / d, d, g.stop_s))
        planes = []
        for n, d, ahead in found:
            gap = d - g.obstacle_margin_m - g.body_radius_m - ahead * float(n @ ego[3:5])
            if g.obstacle_per_s * gap < self.command.max_speed_mps:
                planes.append(Plane(n, max(g.obstacle_per_s * gap, -1.0), d * n - ahead * ego[3:5]))
        return planes

    def _neighbour_planes(self, ego: FloatArray, seen: list[Seen]) -> list[Plane]:
        g = self.g
        planes = []
        for other in seen:
            r = other.r + g.neighbour_stop_s * (other.v - ego[3:5])
            d = float(np.linalg.norm(r))
            away = float(other.v @ r) / d + min(g.foresight_s * float(other.a @ r) / d, 0.0)
            bound = g.neighbour_per_s * (d - g.neighbour_margin_m)
            bound += away if away > 0.0 else g.neighbour_share * away
            planes.append(Plane(r / d, max(float(bound), -g.retreat_mps), r))
        return planes

    @property
    def _clear(self) -> float:
        return self.g.body_radius_m + self.g.obstacle_margin_m + self.g.pass_m

    def _turned_aside(self, plane: Plane, v: FloatArray) -> Plane:
        speed, d = float(np.linalg.norm(v)), float(np.linalg.norm(plane.r))
        if speed < 1e-6 or d <= self._clear or not plane.is_passed(v / speed, self._clear):
            return plane
        side = 1.0 if plane.r[0] * v[1] >= plane.r[1] * v[0] else -1.0
        tangent = turned(plane.r / d, side * np.arcsin(self._clear / d))
        inward = turned(tangent, -side * np.pi / 2.0)
        return Plane(inward, max(plane.bound * self._clear / d, 0.0), plane.r)

    def _detour(self, ego: FloatArray, planes: list[Plane], v: FloatArray) -> FloatArray:
        speed = float(np.linalg.norm(v))
        if not planes or self.g.detour <= 0.0 or speed < 1e-6:
            return v

        def allowed(direction: FloatArray) -> float:
            result = speed
            for plane in planes:
                along = float(plane.n @ direction)
                if along * result > plane.bound and not plane.is_passed(direction, self._clear):
                    result = max(plane.bound, 0.0) / along if along > 0.0 else 0.0
            return result

        u = v / speed
        straight = allowed(u)
        if straight >= speed:
            return v
        before = turned(self.wish_map, -ego[6])
        favoured = 1.0 if u[0] * before[1] - u[1] * before[0] >= 0.0 else -1.0
        best, chosen = straight * (1.0 + self.g.detour), v
        for turn in range(1, 12):
            for side in (1.0, -1.0):
                direction = turned(u, side * np.radians(10.0 * turn))
                worth = np.cos(np.radians(10.0 * turn)) + self.g.detour + (0.1 if side == favoured else 0.0)
                value = worth * allowed(direction)
                if value > best:
                    best, chosen = value, allowed(direction) * direction
        return chosen
