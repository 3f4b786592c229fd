"""The role of a follower: what it perceives goes into its law or policy, and a velocity comes out."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.clock import ns_to_seconds, seconds_to_ns
from companion.control.action import Pilot, PolicyCounters
from companion.control.followers.laws_kernels import steer
from companion.control.followers.layout_kernels import (
    EGO_ALONE,
    EGO_DT,
    EGO_HEIGHT,
    EGO_P,
    EGO_SIZE,
    EGO_V,
    EGO_YAW,
    MEMORY_SIZE,
    METHOD_IDS,
    NEIGHBOUR_SIZE,
    ROW_ID,
    ROW_PRESENT,
)
from companion.control.followers.learned import LearnedFollower
from companion.control.followers.settings import FollowerSettings
from companion.geometry import rotation
from companion.messages import (
    FloatArray,
    Neighbours,
    NeighbourTracks,
    Odometry,
    OdometryStatus,
    RegisteredScan,
    StatusText,
    Surroundings,
    VelocityCommand,
)

_LONGEST_STEP_S = 0.1
# A policy has learned to decide 20 times a second; ticks come oftener and not quite evenly.
_POLICY_STEP_NS = seconds_to_ns(0.035)
_UP = np.array([0.0, 0.0, 1.0])


class NeighbourSource(Protocol):
    """Keeps the newest tracks and tells where the others are now."""

    def observe(self, tracks: NeighbourTracks, odometry: Odometry) -> None:
        """Take the tracks after a scan and the own motion at its end."""
        ...

    def at(self, odometry: Odometry, t_ns: int) -> Neighbours:
        """Return the nearest neighbours at host time `t_ns`."""
        ...

    def clear(self) -> None:
        """Forget everybody."""
        ...


class RangeSource(Protocol):
    """Makes obstacle grids from scans."""

    def ranges(
        self, scan: RegisteredScan, tracks: NeighbourTracks | None, p_map: FloatArray, yaw: float
    ) -> FloatArray:
        """Return the nearest range in every cell about `p_map`, infinity where nothing is."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FollowerDecision:
    """What the follower wants now; it has no path of its own and never ends the flight."""

    command: VelocityCommand
    plan: None = None
    finished: bool = False
    remarks: tuple[StatusText | Surroundings, ...] = ()


class FollowerRole:
    """Flies with the others by one of the laws, or by a learned policy with a law beside it.

    Every input arrives through `meet`, `observe` and `decide`; equal inputs give equal commands.
    """

    def __init__(
        self,
        settings: FollowerSettings,
        neighbours: NeighbourSource,
        grid: RangeSource,
        free: FloatArray,
        pilot: Pilot | None = None,
    ) -> None:
        """Take all memory at once.

        Args:
            settings: the law and its gains.
            neighbours: where the others are.
            grid: where the obstacles are.
            free: (azimuths, elevations) ranges of an obstacle grid without any obstacle.
            pilot: asks the policy that flies, None where the law does.
        """
        self._method = METHOD_IDS[settings.method]
        self._parameters = settings.packed()
        self._learned = None if pilot is None else LearnedFollower(pilot, self._parameters)
        self._view = neighbours
        self._grid = grid
        self._free = np.ascontiguousarray(free, dtype=np.float64)
        self._ranges = self._free
        self._ego = np.zeros(EGO_SIZE)
        self._memory = np.zeros(MEMORY_SIZE)
        self._tracks: NeighbourTracks | None = None
        self._reset_counter: int | None = None
        self._decided_ns: int | None = None
        self._alone_since_ns = 0
        self._up = np.zeros(3)
        self._seen_scan: tuple[int, float] | None = None
        self._held: FollowerDecision | None = None

    @property
    def counters(self) -> PolicyCounters | None:
        """What has become of the policy's velocities; None where none flies."""
        return None if self._learned is None else self._learned.counters

    def reset(self, odometry: Odometry) -> None:
        """Start afresh from standstill: control was taken, or taken again.

        What is in view stays so unless the map has jumped.
        """
        if odometry.reset_counter != self._reset_counter:
            self._forget_surroundings()
        self._reset_counter = odometry.reset_counter
        self._memory[:] = 0.0
        self._decided_ns = None

    def meet(self, tracks: NeighbourTracks) -> None:
        """Learn where the others are; the scan that shows them follows."""
        self._tracks = tracks

    def observe(self, scan: RegisteredScan) -> None:
        """Take in one scan; scans without a trustworthy pose are passed over."""
        tracks, self._tracks = self._tracks, None
        odometry = scan.odometry
        if not _usable(odometry):
            return
        if odometry.reset_counter != self._reset_counter:
            self.reset(odometry)
        if tracks is not None and tracks.sequence == scan.sequence:
            self._view.observe(tracks, odometry)
        else:
            tracks = None
        yaw = float(rotation.yaw_of(odometry.q_map_body))
        self._ranges = self._grid.ranges(scan, tracks, odometry.p_map, yaw)
        self._seen_scan = (scan.t_ns, yaw)

    def decide(self, odometry: Odometry, t_ns: int) -> FollowerDecision:
        """Say how to fly now.

        Args:
            odometry: the newest own motion.
            t_ns: host time; never goes backwards.

        Returns:
            A finite command that holds the heading; zero without a trustworthy odometry, and at first after
            `reset`. The first after each scan tells what the law was given.
        """
        if not _usable(odometry):
            # What follows starts from standstill, as after `reset`: that is what is commanded now.
            self._memory[:] = 0.0
            self._decided_ns = None
            return _decision(odometry, np.zeros(3))
        if odometry.reset_counter != self._reset_counter:
            self.reset(odometry)
        if (
            self._learned is not None
            and self._held is not None
            and self._decided_ns is not None
            and t_ns - self._decided_ns < _POLICY_STEP_NS
        ):
            return self._held
        if self._decided_ns is None:
            self._decided_ns = self._alone_since_ns = t_ns
        seen = self._view.at(odometry, t_ns)
        rows = _rows(seen)
        if rows[:, ROW_PRESENT].any():
            self._alone_since_ns = t_ns
        yaw = self._describe_self(odometry, t_ns)
        v_heading = np.zeros(3)
        remarks: tuple[StatusText | Surroundings, ...] = ()
        if self._learned is not None:
            self._learned.begin(self._memory)
        steer(self._method, self._ego, rows, self._ranges, self._memory, self._parameters, v_heading)
        if self._learned is not None:
            self._learned.overrule(self._ego, self._up, rows, self._ranges, self._memory, v_heading, t_ns)
            remarks = self._learned.remarks()
        if self._seen_scan is not None:
            remarks = (*remarks, Surroundings(t_ns, seen, *self._seen_scan, self._ranges.copy()))
            self._seen_scan = None
        self._decided_ns = t_ns
        decision = _decision(
            odometry, np.asarray(rotation.rotate(rotation.from_yaw(yaw), v_heading)), remarks
        )
        self._held = FollowerDecision(decision.command)
        return decision

    def _describe_self(self, odometry: Odometry, t_ns: int) -> float:
        """Write the own state at `t_ns` for the law; return the heading."""
        assert self._decided_ns is not None
        age_s = ns_to_seconds(t_ns - odometry.t_ns)
        turned = rotation.exp(odometry.omega_body * age_s)
        q_map_body = rotation.multiply(odometry.q_map_body, turned)
        yaw = float(rotation.yaw_of(q_map_body))
        q_heading_body = rotation.multiply(rotation.from_yaw(-yaw), q_map_body)
        self._up[:] = rotation.rotate(q_heading_body, _UP)
        ego = self._ego
        ego[EGO_P : EGO_P + 3] = odometry.p_map + age_s * odometry.v_map
        ego[EGO_V : EGO_V + 3] = rotation.rotate(rotation.from_yaw(-yaw), odometry.v_map)
        ego[EGO_YAW] = yaw
        # The map begins at the start, on the ground.
        ego[EGO_HEIGHT] = ego[EGO_P + 2]
        ego[EGO_DT] = min(max(ns_to_seconds(t_ns - self._decided_ns), 0.0), _LONGEST_STEP_S)
        ego[EGO_ALONE] = ns_to_seconds(t_ns - self._alone_since_ns)
        return yaw

    def _forget_surroundings(self) -> None:
        self._view.clear()
        self._tracks = None
        self._ranges = self._free
        self._seen_scan = None


def _rows(seen: Neighbours) -> FloatArray:
    rows = np.zeros((len(seen.track_ids), NEIGHBOUR_SIZE))
    rows[:, :ROW_ID] = seen.states_heading
    present = rows[:, ROW_PRESENT] > 0.0
    rows[present, ROW_ID] = seen.track_ids[present]
    return rows


def _usable(odometry: Odometry) -> bool:
    return (
        odometry.status in (OdometryStatus.TRACKING, OdometryStatus.DEGRADED)
        and bool(np.all(np.isfinite(odometry.p_map)))
        and bool(np.all(np.isfinite(odometry.v_map)))
        and bool(np.all(np.isfinite(odometry.q_map_body)))
        and bool(np.all(np.isfinite(odometry.omega_body)))
    )


def _decision(
    odometry: Odometry, v_map: FloatArray, remarks: tuple[StatusText | Surroundings, ...] = ()
) -> FollowerDecision:
    return FollowerDecision(VelocityCommand(odometry.t_ns, v_map, 0.0), remarks=remarks)
