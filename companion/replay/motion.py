"""The vehicle's motion in a replay: its path, how far it lies from the recorded one, and from the truth."""

import contextlib
import math
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from companion.clock import NANOSECONDS_PER_SECOND, ns_to_seconds, seconds_to_ns
from companion.errors import LogError
from companion.geometry import rotation, trajectory_error
from companion.geometry.rotation import FloatArray
from companion.geometry.trajectory import Trajectory
from companion.geometry.trajectory_comparison import compare
from companion.logs import channels
from companion.logs.reader import EncodedEntry, FlightRecording
from companion.logs.records import StampedPose
from companion.messages import Odometry, OdometryStatus, PerceptionUpdate, RegisteredScan

TrajectorySource = Literal["odometry", "truth"]

RPE_DISTANCE_M = 5.0
_USABLE = (OdometryStatus.TRACKING, OdometryStatus.DEGRADED)
_SPACING_NS = seconds_to_ns(0.02)
_MAX_POSES = 1_000_000


class PosePath:
    """Poses as they come, in order of time; what goes back in time is left out."""

    def __init__(self, spacing_ns: int = 1) -> None:
        """Keep poses at least `spacing_ns` apart."""
        self._spacing_ns = spacing_ns
        self._t = array("q")
        self._map = array("q")
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._t)

    def add(self, t_ns: int, p: FloatArray, q: FloatArray, map_number: int = 0) -> None:
        """Add a pose; `map_number` grows when the frame of the positions jumps."""
        follows = not self._t or t_ns >= self._t[-1] + self._spacing_ns
        if follows and len(self._t) < _MAX_POSES:
            self._t.append(t_ns)
            self._map.append(map_number)
            self._values.extend(p.tolist())
            self._values.extend(q.tolist())

    def add_odometry(self, odometry: Odometry) -> None:
        """Add an estimate, if it is usable."""
        if odometry.status in _USABLE:
            self.add(odometry.t_ns, odometry.p_map, odometry.q_map_body, odometry.reset_counter)

    def trajectory(self) -> Trajectory:
        """Return all poses."""
        values = np.array(self._values, dtype=np.float64).reshape(-1, 7)
        return Trajectory(np.array(self._t, dtype=np.int64), values[:, :3].copy(), values[:, 3:].copy())

    def longest_stretch(self) -> Trajectory:
        """Return the poses in the one frame in which most of them are."""
        whole, maps = self.trajectory(), np.array(self._map, dtype=np.int64)
        if not len(maps):
            return whole
        numbers, counts = np.unique(maps, return_counts=True)
        chosen = maps == numbers[np.argmax(counts)]
        return Trajectory(whole.t_ns[chosen], whole.p[chosen], whole.q[chosen])


def odometry_path() -> PosePath:
    """Return an empty path for odometry at its output rate: kept at 50 Hz at most."""
    return PosePath(_SPACING_NS)


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How far odometry was from the truth.

    Attributes:
        ape_rmse_m: absolute position error after the best rigid alignment.
        rpe_rmse_m: position error over every `RPE_DISTANCE_M` of true path, None on a shorter one.
        drift_percent: end error over path length, None if nothing moved.
        map_tilt_deg: angle between the map's vertical and the true one.
    """

    ape_rmse_m: float
    rpe_rmse_m: float | None
    drift_percent: float | None
    map_tilt_deg: float


def accuracy(estimate: Trajectory, truth: Trajectory) -> Accuracy | None:
    """Return an estimate's errors, None if too little of it lies within the truth's time."""
    inside = truth.covers(estimate.t_ns)
    if np.count_nonzero(inside) < 3:
        return None
    t_ns, p, q = estimate.t_ns[inside], estimate.p[inside], estimate.q[inside]
    found = compare(_seconds(t_ns), p, q, _seconds(truth.t_ns), truth.p, truth.q)
    if found is None:
        return None
    true = truth.at(t_ns)
    try:
        rpe = trajectory_error.relative_error(p, q, true.p, true.q, RPE_DISTANCE_M).rmse_m
    except ValueError:
        rpe = None
    return Accuracy(found.ape_rmse_m, rpe, found.drift_percent, math.degrees(found.map_tilt))


def _seconds(t_ns: NDArray[np.int64]) -> FloatArray:
    return np.asarray(t_ns / NANOSECONDS_PER_SECOND, dtype=np.float64)


def recorded_trajectory(path: Path, source: TrajectorySource) -> Trajectory:
    """Return the path that a flight log holds: the odometry's, where it was usable, or the simulator's truth.

    Raises:
        LogError: if the log cannot be read or holds no such pose.
    """
    poses = PosePath()
    channel = channels.ODOMETRY if source == "odometry" else channels.TRUTH
    for entry in FlightRecording(path).messages(channel):
        if isinstance(entry.message, Odometry):
            poses.add_odometry(entry.message)
        elif isinstance(entry.message, StampedPose):
            poses.add(entry.message.t_ns, entry.message.p, entry.message.q)
    if not len(poses):
        raise LogError(f"{path}: no usable pose on {channel.topic}")
    return poses.trajectory()


class LargestDifference:
    """How far replayed estimates lie from recorded ones, at most.

    Attributes:
        found: there was any pair that is not equal.
        position_m, attitude_deg: the largest differences between two estimates for one instant.
        t_ns: host time of the estimate with the largest difference in position.
    """

    def __init__(self) -> None:
        """Start without any."""
        self.found = False
        self.position_m = 0.0
        self.attitude_deg = 0.0
        self.t_ns = 0

    def take(self, recorded: object, replayed: object) -> None:
        """Take one pair that is not equal."""
        if not (isinstance(recorded, Odometry) and isinstance(replayed, Odometry)):
            return
        self.found = True
        distance = float(np.linalg.norm(recorded.p_map - replayed.p_map))
        if distance > self.position_m:
            self.position_m, self.t_ns = distance, recorded.t_ns
        try:
            q = rotation.normalize(np.stack([recorded.q_map_body, replayed.q_map_body]))
        except ValueError:
            return
        self.attitude_deg = max(self.attitude_deg, math.degrees(rotation.angle_between(q[0], q[1])))

    def as_dict(self) -> dict[str, float]:
        """Return plain values for JSON."""
        return {
            "position_m": self.position_m,
            "attitude_deg": self.attitude_deg,
            "t_s": ns_to_seconds(self.t_ns),
        }


@dataclass(slots=True)
class Paths:
    """Where the vehicle was, by all who say so."""

    replayed_scans: PosePath = field(default_factory=PosePath)
    replayed: PosePath = field(default_factory=odometry_path)
    recorded: PosePath = field(default_factory=odometry_path)
    truth: PosePath = field(default_factory=PosePath)

    def take_update(self, update: PerceptionUpdate) -> None:
        """Take a replayed estimate."""
        if isinstance(update, RegisteredScan):
            self.replayed_scans.add_odometry(update.odometry)
        elif isinstance(update, Odometry):
            self.replayed.add_odometry(update)

    def take_entry(self, entry: EncodedEntry) -> None:
        """Take a recorded message."""
        if entry.channel not in (channels.ODOMETRY, channels.TRUTH):
            return
        with contextlib.suppress(ValueError):
            message = entry.message()
            if isinstance(message, Odometry):
                self.recorded.add_odometry(message)
            elif isinstance(message, StampedPose):
                self.truth.add(message.t_ns, message.p, message.q)

    def said(self) -> str:
        """Say in one sentence how much there is."""
        if not len(self.replayed_scans):
            return "no scan could be registered: the vehicle has to rest at the start, and not be moved"
        length_m = self.replayed_scans.trajectory().length_m
        return f"{len(self.replayed_scans)} scans registered along {length_m:.1f} m"

    def accuracies(self) -> tuple[Accuracy | None, Accuracy | None]:
        """Return how far recorded and replayed odometry were from the truth."""
        if not len(self.truth):
            return None, None
        truth = self.truth.trajectory()
        return (
            accuracy(self.recorded.longest_stretch(), truth),
            accuracy(self.replayed.longest_stretch(), truth),
        )
