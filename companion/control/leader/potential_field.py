"""Potential field along the path: attraction to a point ahead, repulsion from what is near.

Source: O. Khatib, "Real-time obstacle avoidance for manipulators and mobile robots", 1986.
"""

import math

import numpy as np

from companion.control.leader import field_kernels
from companion.control.leader.obstacle_map import ClearanceField
from companion.control.leader.settings import PotentialFieldSettings
from companion.messages import FloatArray

_NO_DIRECTION = 1e-9


class PotentialField:
    """Turns a point ahead on the path into a horizontal velocity."""

    def __init__(self, settings: PotentialFieldSettings, vehicle_radius_m: float) -> None:
        self._settings = settings
        self._vehicle_radius = vehicle_radius_m
        self._sectors = np.zeros((settings.sectors, 3))
        self._side = 0.0

    def reset(self) -> None:
        """Forget on which side an obstacle was being passed."""
        self._side = 0.0

    def velocity(
        self,
        field: ClearanceField,
        p: FloatArray,
        ahead: FloatArray,
        beyond: FloatArray,
        speed: float,
        goal_distance: float,
        is_open: bool,
    ) -> FloatArray:
        """Return the horizontal velocity that follows the path and keeps away from obstacles.

        Args:
            field: what the map knows.
            p: (2,) position of the vehicle in the map, m.
            ahead: (2,) point of the path that attracts, m.
            beyond: (2,) point farther on, which settles the side on which to pass an obstacle, m.
            speed: greatest speed, m/s.
            goal_distance: horizontal distance to the waypoint, m.
            is_open: whether the straight line to `ahead` is free; obstacles beside it may then slow the
                vehicle down and push it sideways, but not stop it in front of a gate.

        Returns:
            (2,) m/s in the map, finite, never longer than `speed`.
        """
        settings = self._settings
        to_ahead = ahead - p
        left = math.hypot(to_ahead[0], to_ahead[1])
        direction = to_ahead / left if left > _NO_DIRECTION else np.zeros(2)
        push = self._repulsion(field, p)
        # Close to the goal obstacles must not hold the vehicle off it.
        push *= min(1.0, goal_distance / settings.repulsion_distance_m)
        force = settings.attraction * direction + push
        push_length = math.hypot(push[0], push[1])
        drive = float(force @ direction)
        if is_open:
            force = force + max(settings.least_drive - drive, 0.0) * direction
            self._side = 0.0
        elif push_length > _NO_DIRECTION and drive < settings.escape_threshold:
            tangent = np.array([-push[1], push[0]]) / push_length
            if self._side == 0.0:
                self._side = 1.0 if float(tangent @ (beyond - p)) >= 0.0 else -1.0
            force = force + self._side * tangent
        else:
            self._side = 0.0
        length = math.hypot(force[0], force[1])
        return speed / max(1.0, length) * force

    def speed_limit(self, field: ClearanceField, p: FloatArray, ahead: FloatArray) -> float:
        """Return the speed that the room at `p` and `ahead`, (2,) each, allows, m/s."""
        settings = self._settings
        clearance = min(field.clearance(p), field.clearance(ahead))
        room = clearance - self._vehicle_radius
        return max(settings.speed_per_room_per_s * room, settings.least_speed_mps)

    def _repulsion(self, field: ClearanceField, p: FloatArray) -> FloatArray:
        settings = self._settings
        reach = settings.repulsion_distance_m + self._vehicle_radius
        field_kernels.find_nearest(
            field.blocked, field.surface, field.first, field.cell_m, p[0], p[1], reach, self._sectors
        )
        return np.array(
            field_kernels.repulsion(
                self._sectors, self._vehicle_radius, settings.repulsion, settings.repulsion_distance_m,
                settings.max_repulsion,
            )
        )  # fmt: skip


class CommandFilter:
    """Smooths a commanded velocity: first-order low pass, then a limit on its change."""

    def __init__(self, low_pass_s: float) -> None:
        self._low_pass_s = low_pass_s
        self.v_map = np.zeros(3)
        """The last output, (3,) m/s."""

    def reset(self) -> None:
        """Start again from standstill."""
        self.v_map = np.zeros(3)

    def step(self, target_map: FloatArray, dt_s: float, max_acceleration: float) -> FloatArray:
        """Move the output towards `target_map` for `dt_s` seconds; (3,) m/s."""
        share = -math.expm1(-dt_s / self._low_pass_s) if self._low_pass_s > 0.0 else 1.0
        change = share * (target_map - self.v_map)
        length = float(np.linalg.norm(change))
        limit = max_acceleration * dt_s
        if length > limit:
            change *= limit / length
        self.v_map = self.v_map + change
        return self.v_map.copy()
