"""How well a swarm kept together and apart: FR, MS, AL, MDO, mission progress and success rate.

Pure functions on arrays, for flights of real vehicles and of emulated ones alike. Every vehicle counts, the
leader included. Series hold one value a sample; what a trial comes to is their mean.

Source: arXiv 2601.13657, section "Evaluation Metrics"; where its formulas leave something open, the
docstrings say what holds here.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from companion.errors import LogError
from companion.messages import FloatArray

STILL_MPS = 0.05
"""A vehicle slower than this has no direction, and its sample does not count for AL."""
DEFAULT_CAP_M = 4.0
"""Obstacles farther than this do not count for MDO in simulated trials, as in the paper's."""

_FULL_PERCENT = 100.0
_NO_DIRECTION = 1e-9


class UnusableFlightError(LogError):
    """No metric can be computed from what was given; the text says why in one sentence."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation of what was sampled.

    Attributes:
        mean: NaN if nothing was.
        sd: with n - 1 in the denominator; NaN for less than two samples.
        samples: how many.
    """

    mean: float
    sd: float
    samples: int


@dataclass(frozen=True, slots=True, eq=False)
class SwarmMetrics:
    """One flight of a swarm, over time and in numbers.

    Attributes:
        t: (T,) s.
        flock_radius_m: (T,) distance from the swarm's centre to the vehicle farthest from it.
        minimum_separation_m: (T,) distance of the closest pair.
        alignment: (T,) mean cosine between the vehicles' velocities and the swarm's; NaN where none moved.
        obstacle_distance_m: (T,) nearest obstacle to any vehicle; NaN where none was within the cap, or
            nothing is known about obstacles.
        cap_m: obstacles farther than this do not count; infinite if all do.
    """

    t: FloatArray
    flock_radius_m: FloatArray
    minimum_separation_m: FloatArray
    alignment: FloatArray
    obstacle_distance_m: FloatArray
    cap_m: float

    @property
    def FR(self) -> Spread:
        """Flock radius, m."""
        return spread(self.flock_radius_m)

    @property
    def MS(self) -> Spread:
        """Minimum separation, m."""
        return spread(self.minimum_separation_m)

    @property
    def AL(self) -> Spread:
        """Alignment."""
        return spread(self.alignment)

    @property
    def MDO(self) -> Spread:
        """Minimum distance to obstacles, m."""
        return spread(self.obstacle_distance_m)


def measure(
    t: ArrayLike,
    p: ArrayLike,
    v: ArrayLike,
    distances: ArrayLike | None = None,
    *,
    cap_m: float = DEFAULT_CAP_M,
) -> SwarmMetrics:
    """Compute all metrics of one flight.

    Args:
        t: (T,) rising times, s; at least two.
        p: (T, N, 3) positions in one frame, m; at least two vehicles.
        v: (T, N, 3) velocities in the same frame, m/s.
        distances: (T, N) from every vehicle's centre to the nearest surface, m; infinite where there is none
            in sight; None if nothing is known about obstacles.
        cap_m: samples without an obstacle nearer than this do not count for MDO.

    Raises:
        UnusableFlightError: if shapes differ, a number is missing, times do not rise, or there is nothing to
            measure.
    """
    times = np.asarray(t, dtype=np.float64)
    positions = _positions(p)
    velocities = _of_shape(v, positions.shape, "velocities")
    if times.ndim != 1 or len(times) != len(positions):
        raise UnusableFlightError(
            f"times of shape {times.shape} do not go with positions of shape {positions.shape}: "
            "one time a sample is needed"
        )
    if len(times) < 2:
        raise UnusableFlightError("the flight has zero length: at least two samples are needed")
    if not np.all(np.isfinite(times)):
        raise UnusableFlightError(f"the time of sample {_first(~np.isfinite(times))} is not a number")
    if np.any(np.diff(times) <= 0.0):
        number = _first(np.diff(times) <= 0.0) + 1
        raise UnusableFlightError(f"times do not rise: sample {number} does not come after the one before it")
    if distances is None:
        nearest = np.full(len(times), np.nan)
    else:
        nearest = obstacle_distance_m(_of_shape(distances, positions.shape[:2], "distances", far=True), cap_m)
    return SwarmMetrics(
        t=times,
        flock_radius_m=flock_radius_m(positions),
        minimum_separation_m=minimum_separation_m(positions),
        alignment=alignment(velocities),
        obstacle_distance_m=nearest,
        cap_m=float(cap_m),
    )


def flock_radius_m(p: ArrayLike) -> FloatArray:
    """Return the distance (T,) from the swarm's centre to the vehicle farthest from it.

    Args:
        p: (T, N, 3) positions, m.

    Raises:
        UnusableFlightError: if they are no positions of at least two vehicles.
    """
    positions = _positions(p)
    centre = positions.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.norm(positions - centre, axis=2).max(axis=1))


def minimum_separation_m(p: ArrayLike) -> FloatArray:
    """Return the distance (T,) of the closest pair.

    Args:
        p: (T, N, 3) positions, m.

    Raises:
        UnusableFlightError: if they are no positions of at least two vehicles.
    """
    positions = _positions(p)
    first, second = np.triu_indices(positions.shape[1], k=1)
    # One pair at a time: twenty vehicles over half an hour would not fit in memory at once.
    nearest = np.full(len(positions), np.inf)
    for i, j in zip(first, second, strict=True):
        np.minimum(nearest, np.linalg.norm(positions[:, i] - positions[:, j], axis=1), out=nearest)
    return nearest


def alignment(v: ArrayLike) -> FloatArray:
    """Return the mean cosine (T,) between the vehicles' velocities and their mean.

    Vehicles slower than `STILL_MPS` have no direction: they are left out of a sample's mean over vehicles,
    but not out of the mean velocity. NaN where all are still, or the mean velocity is zero.

    Args:
        v: (T, N, 3) velocities, m/s.

    Raises:
        UnusableFlightError: if they are no velocities of at least two vehicles.
    """
    velocities = _positions(v, "velocities")
    mean = velocities.mean(axis=1)
    mean_speed = np.linalg.norm(mean, axis=1)
    speeds = np.linalg.norm(velocities, axis=2)
    counts = (speeds >= STILL_MPS) & (mean_speed > _NO_DIRECTION)[:, None]
    scale = np.where(counts, speeds * mean_speed[:, None], 1.0)
    cosines = np.where(counts, np.einsum("tnk,tk->tn", velocities, mean) / scale, 0.0)
    number = counts.sum(axis=1)
    return np.where(number > 0, cosines.sum(axis=1) / np.maximum(number, 1), np.nan)


def obstacle_distance_m(distances: ArrayLike, cap_m: float = DEFAULT_CAP_M) -> FloatArray:
    """Return the distance (T,) of the nearest obstacle to any vehicle, NaN where none is within the cap.

    Args:
        distances: (T, N) from every vehicle to the nearest surface, m; infinite where there is none.
        cap_m: what is as far or farther does not count.

    Raises:
        UnusableFlightError: if they are no such distances, or the cap is not above 0.
    """
    if not cap_m > 0.0:
        raise UnusableFlightError(f"a cap of {cap_m:g} m leaves no obstacle: it must be above 0")
    values = np.asarray(distances, dtype=np.float64)
    if values.ndim != 2 or 0 in values.shape:
        raise UnusableFlightError(
            f"distances of shape {values.shape} are not one for every sample and vehicle: (T, N) is needed"
        )
    if np.any(np.isnan(values)):
        raise UnusableFlightError(f"a distance in sample {_first(np.isnan(values))} is not a number")
    nearest = values.min(axis=1)
    return np.where((nearest < cap_m) & np.isfinite(nearest), nearest, np.nan)


def mission_progress_percent(
    p_start: ArrayLike, p_goal: ArrayLike, p_end: ArrayLike, *, success: bool = False
) -> float:
    """Return how much of the way to the goal the leader has advanced, 0 to 100.

    Args:
        p_start: (3,) where the leader began, m.
        p_goal: (3,) the last waypoint.
        p_end: (3,) where it was when the trial ended.
        success: the trial succeeded: it is complete, though the leader stops within a tolerance of the goal.

    Raises:
        UnusableFlightError: if these are no three positions, or the way has zero length.
    """
    points = [np.asarray(point, dtype=np.float64) for point in (p_start, p_goal, p_end)]
    for name, point in zip(("start", "goal", "end"), points, strict=True):
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise UnusableFlightError(f"the {name} of the way is no position of three finite numbers")
    start, goal, end = points
    way_m = float(np.linalg.norm(start - goal))
    if way_m == 0.0:
        raise UnusableFlightError("the way from start to goal has zero length: there is no progress on it")
    if success:
        return _FULL_PERCENT
    progress = (1.0 - float(np.linalg.norm(end - goal)) / way_m) * _FULL_PERCENT
    return min(max(progress, 0.0), _FULL_PERCENT)


def success_rate_percent(successes: int, trials: int) -> float:
    """Return the share of trials that succeeded, in percent.

    Raises:
        UnusableFlightError: if there is no trial, or more successes than trials.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise UnusableFlightError(f"{successes} successes of {trials} trials make no success rate")
    return successes / trials * _FULL_PERCENT


def spread(values: FloatArray) -> Spread:
    """Return mean and standard deviation of what is finite in `values`."""
    known = values[np.isfinite(values)]
    mean = float(known.mean()) if len(known) else float("nan")
    sd = float(known.std(ddof=1)) if len(known) > 1 else float("nan")
    return Spread(mean, sd, len(known))


def _positions(p: ArrayLike, name: Literal["positions", "velocities"] = "positions") -> FloatArray:
    values = np.asarray(p, dtype=np.float64)
    if values.ndim != 3 or values.shape[2] != 3:
        raise UnusableFlightError(
            f"{name} of shape {values.shape} are not three numbers for every sample and vehicle: "
            "(T, N, 3) is needed"
        )
    if not len(values):
        raise UnusableFlightError(f"the flight has zero length: there are no {name}")
    if values.shape[1] < 2:
        raise UnusableFlightError(f"{values.shape[1]} UAV is no swarm: at least two are needed")
    if not np.all(np.isfinite(values)):
        sample, vehicle, _ = np.argwhere(~np.isfinite(values))[0]
        raise UnusableFlightError(f"{name} of UAV {vehicle} in sample {sample} are not finite numbers")
    return values


def _of_shape(values: ArrayLike, shape: tuple[int, ...], name: str, *, far: bool = False) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise UnusableFlightError(
            f"{name} of shape {array.shape} do not go with positions: {shape} is needed"
        )
    wrong = np.isnan(array) if far else ~np.isfinite(array)
    if np.any(wrong):
        raise UnusableFlightError(f"{name} in sample {_first(wrong)} are not numbers")
    return array


def _first(wrong: np.ndarray) -> int:
    """Return the first sample in which something is wrong."""
    return int(np.argwhere(wrong)[0][0])
