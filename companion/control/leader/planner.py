"""The leader: sees obstacles, finds a path to the next waypoint and says how to fly along it."""

from dataclasses import dataclass

import numpy as np

from companion.clock import ns_to_seconds
from companion.control.leader.companions import without_companions
from companion.control.leader.mission import Mission, Phase
from companion.control.leader.obstacle_map import ObstacleMap
from companion.control.leader.potential_field import CommandFilter, PotentialField
from companion.control.leader.route import Route
from companion.control.leader.settings import LeaderSettings
from companion.messages import (
    FloatArray,
    NeighbourTracks,
    Odometry,
    OdometryStatus,
    PlanUpdate,
    RegisteredScan,
    StatusText,
    VelocityCommand,
)

_LONGEST_EXTRAPOLATION_S = 0.3
_LONGEST_STEP_S = 0.1
_BEYOND_M = 3.0
_NOTHING_GRANTED = np.full((2, 3), np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class LeaderDecision:
    """What the leader wants now.

    Attributes:
        command: velocity to fly, true as of the odometry it rests on.
        plan: the local path if it changed, otherwise None.
        finished: whether the mission is over, so that the vehicle may land if the mission says so.
    """

    command: VelocityCommand
    plan: PlanUpdate | None
    finished: bool
    remarks: tuple[StatusText, ...] = ()


class LeaderPlanner:
    """Flies waypoints round obstacles that only the LiDAR knows.

    Every input arrives through `observe` and `decide`; equal inputs and generators give equal commands.
    """

    def __init__(self, settings: LeaderSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._map = ObstacleMap(settings.obstacle_map)
        self._route = Route(settings.rrt, settings.vehicle_radius_m, rng)
        self._field = PotentialField(settings.potential_field, settings.vehicle_radius_m)
        self._filter = CommandFilter(settings.potential_field.low_pass_s)
        self._mission = Mission(settings.mission)
        self._companions: NeighbourTracks | None = None
        self._reset_counter: int | None = None
        self._decided_ns: int | None = None
        self._plan_key: tuple[int, str] | None = None

    def reset(self, odometry: Odometry) -> None:
        """Start afresh from the present pose: control was taken, or taken again.

        What the map knows stays unless the map frame has jumped; waypoints once reached stay reached.
        """
        if odometry.reset_counter != self._reset_counter:
            self._map.clear()
        self._reset_counter = odometry.reset_counter
        self._route.reset()
        self._field.reset()
        self._filter.reset()
        self._decided_ns = None
        self._plan_key = None

    def meet(self, tracks: NeighbourTracks) -> None:
        """Learn where the followers are, so that they are not taken for obstacles."""
        self._companions = None if self._settings.avoid_followers else tracks

    def observe(self, scan: RegisteredScan) -> None:
        """Take in one scan; scans without a trustworthy pose are passed over."""
        if not _usable(scan.odometry):
            return
        if self._reset_counter is not None and scan.odometry.reset_counter != self._reset_counter:
            self.reset(scan.odometry)
        elif self._reset_counter is None:
            self._reset_counter = scan.odometry.reset_counter
        scan = without_companions(scan, self._companions, self._settings.follower_radius_m)
        z = float(scan.odometry.p_map[2])
        z_goal = self._mission.height(z)
        settings = self._settings.obstacle_map
        self._map.add(scan, min(z, z_goal) - settings.band_below_m, max(z, z_goal) + settings.band_above_m)

    @property
    def counters(self) -> None:
        """Nothing is counted."""
        return None

    def decide(self, odometry: Odometry, t_ns: int) -> LeaderDecision:
        """Say how to fly now.

        Args:
            odometry: the newest own motion.
            t_ns: host time; never goes backwards.

        Returns:
            A finite command; zero at first after `reset`, and braking while there is no path or no
            trustworthy odometry.
        """
        if _usable(odometry) and odometry.reset_counter != self._reset_counter:
            self.reset(odometry)
        dt_s = 0.0
        if self._decided_ns is not None:
            dt_s = min(max(ns_to_seconds(t_ns - self._decided_ns), 0.0), _LONGEST_STEP_S)
        elif _usable(odometry):
            self._mission.start(odometry.p_map, t_ns)
        else:
            return self._decision(odometry, np.zeros(3), None)
        self._decided_ns = t_ns
        if not _usable(odometry):
            return self._decision(odometry, self._brake(dt_s), None)
        age_s = min(max(ns_to_seconds(t_ns - odometry.t_ns), 0.0), _LONGEST_EXTRAPOLATION_S)
        p_map = odometry.p_map + age_s * odometry.v_map
        p_soon = self._soon(p_map, odometry.v_map)
        searched = self._follow_mission(p_map, p_soon, t_ns)
        v_map = self._velocity(p_map, p_soon, dt_s, t_ns)
        return self._decision(odometry, v_map, self._plan(searched, p_map, t_ns))

    def _soon(self, p_map: FloatArray, v_map: FloatArray) -> FloatArray:
        """Return where the vehicle will be before a new command takes effect, (3,) m.

        Never beyond an obstacle: a path from behind a wall would lead on from there.
        """
        p_soon = p_map + self._settings.potential_field.prediction_s * v_map
        room = self._settings.vehicle_radius_m
        if self._map.field.is_segment_free(p_map[:2], p_soon[:2], room, _NOTHING_GRANTED):
            return p_soon
        return p_map

    def _follow_mission(self, p_map: FloatArray, p_soon: FloatArray, t_ns: int) -> bool:
        mission = self._mission
        field = self._map.field
        searched = False
        if mission.phase in (Phase.WAITING, Phase.FLYING):
            searched = self._route.update(field, p_soon[:2], mission.waypoint_map[:2], t_ns)
        index = mission.index
        mission.update(p_map, self._goal(), t_ns)
        if mission.index != index:
            searched = self._route.update(field, p_soon[:2], mission.waypoint_map[:2], t_ns)
        return searched

    def _goal(self) -> FloatArray:
        return np.array([*self._route.goal, self._mission.waypoint_map[2]])

    def _velocity(self, p_map: FloatArray, p_soon: FloatArray, dt_s: float, t_ns: int) -> FloatArray:
        settings = self._settings.potential_field
        mission = self._mission
        if mission.phase is Phase.WAITING:
            return self._filter.step(np.zeros(3), dt_s, settings.max_acceleration_mps2)
        to_goal = self._goal() - p_soon
        distance = float(np.hypot(to_goal[0], to_goal[1]))
        speed = mission.speed(distance, t_ns)
        target = np.zeros(3)
        target[2] = mission.climb_rate(to_goal[2])
        if mission.phase is not Phase.FLYING:
            scale = min(1.0, speed / distance) if distance > 0.0 else 0.0
            target[:2] = scale * to_goal[:2]
        elif self._route.path is None:
            return self._brake(dt_s)
        else:
            field = self._map.field
            p = p_soon[:2]
            ahead, is_open = self._route.ahead(field, p, settings.look_ahead_m)
            speed = min(speed, self._field.speed_limit(field, p, ahead))
            beyond = self._route.beyond(settings.look_ahead_m + _BEYOND_M)
            target[:2] = self._field.velocity(field, p, ahead, beyond, speed, distance, is_open)
        size = float(np.linalg.norm(target))
        limit = self._settings.mission.max_speed_mps
        if size > limit:
            target *= limit / size
        return self._filter.step(target, dt_s, settings.max_acceleration_mps2)

    def _brake(self, dt_s: float) -> FloatArray:
        return self._filter.step(np.zeros(3), dt_s, self._settings.potential_field.max_braking_mps2)

    def _plan(self, searched: bool, p_map: FloatArray, t_ns: int) -> PlanUpdate | None:
        mission = self._mission
        if mission.phase is Phase.FINISHED:
            status = "arrived"
        elif mission.phase is Phase.PAUSING:
            status = "holding"
        else:
            status = self._route.status
        key = (mission.index, status)
        if not searched and key == self._plan_key:
            return None
        self._plan_key = key
        path = np.zeros((0, 3))
        if mission.phase in (Phase.WAITING, Phase.FLYING):
            flat = self._route.remaining(p_map[:2])
            path = np.column_stack([flat, np.full(flat.shape[0], mission.waypoint_map[2])])
        return PlanUpdate(t_ns, path, mission.waypoint_map.copy(), mission.index, status)

    def _decision(self, odometry: Odometry, v_map: FloatArray, plan: PlanUpdate | None) -> LeaderDecision:
        command = VelocityCommand(odometry.t_ns, v_map, 0.0)
        return LeaderDecision(command, plan, self._mission.phase is Phase.FINISHED)


def _usable(odometry: Odometry) -> bool:
    return (
        odometry.status in (OdometryStatus.TRACKING, OdometryStatus.DEGRADED)
        and bool(np.all(np.isfinite(odometry.p_map)))
        and bool(np.all(np.isfinite(odometry.v_map)))
    )
