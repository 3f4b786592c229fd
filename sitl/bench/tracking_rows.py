"""Figures of scored flights, by case and by band of range."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from companion.messages import FloatArray
from sitl.bench.tracking_score import FlightScore

BANDS_M = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0)
"""Edges of the bands of range, one row each."""

ALL = "all"
"""Name of the band of a row that takes all ranges together."""

_STEPS_PER_S = 10
_Z_95 = 1.959964
_LONGEST_LAG = 30
_UNCORRELATED = 0.05

TOGETHER = "together"
"""Name of the scene of a row that takes several cases together."""

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Row:
    """Figures of one case in one band of range; None where there is nothing to tell.

    Attributes:
        scene: its name, with the range where that was chosen.
        tape: whether the neighbours wear it.
        distractors: whether other reflective things stand about.
        windy: whether it blows harder than usual.
        neighbours: number of them; None where several cases are taken together.
        band_m: band of range, or `ALL`.
        range_m: mean range of the counted neighbours.
        flights: number of them.
        counted: neighbour-steps that count for the detection rate.
        track_steps: validated track-steps that count for the precision.
        missed: of the former, those without a track.
        false_steps: of the latter, those that are nobody's, or a second track of one neighbour.
        false_tracks: number of tracks with any such step.
        detection_rate: share of the counted neighbour-steps with a validated track.
        detection_ci95: its Wilson interval, see `rate_interval`.
        detection_rate_at_once: the same from the first scan in which a neighbour could be seen.
        precision: share of validated track-steps at a true neighbour.
        precision_ci95: its Wilson interval.
        position_rmse_m: length of the error of matched tracks, all three axes together.
        velocity_rmse_mps: the same of the velocity in the map.
        velocity_rmse_steady_mps: the same where the neighbour hardly accelerated.
        relative_velocity_rmse_mps: of the velocity as seen from the own vehicle, its own error included.
        position_rmse_axes_m: along the line of sight, across it and upwards.
        velocity_rmse_axes_mps: the same.
        position_nees: mean squared error by covariance and degree of freedom; 1 if the covariance is true.
        position_nees_samples: independent samples in that mean, as the errors' own correlation tells.
        position_nees_bounds: where that mean lies in 95 % of all runs, if the covariance is true.
        velocity_nees: the same as for the position...
        velocity_nees_samples: ...with its samples...
        velocity_nees_bounds: ...and bounds.
        id_switches: changes of a neighbour's track number, at all ranges.
        id_switches_per_min: the same by minute of flight of the whole swarm.
        id_switches_per_uav_min: the same by minute and neighbour.
        minutes: of flight.
        acquired_s: median time from coming into sight until validated.
        latency_ms: median processor time of the tracker for one scan.
        latency_p99_ms: its 99th percentile.
    """

    scene: str
    tape: bool
    distractors: bool
    windy: bool
    neighbours: int | None
    band_m: str
    range_m: float | None
    flights: int
    counted: int
    track_steps: int
    missed: int
    false_steps: int
    false_tracks: int
    detection_rate: float | None
    detection_ci95: Interval | None
    detection_rate_at_once: float | None
    precision: float | None
    precision_ci95: Interval | None
    position_rmse_m: float | None
    velocity_rmse_mps: float | None
    velocity_rmse_steady_mps: float | None
    relative_velocity_rmse_mps: float | None
    position_rmse_axes_m: tuple[float, ...] | None
    velocity_rmse_axes_mps: tuple[float, ...] | None
    position_nees: float | None
    position_nees_samples: int
    position_nees_bounds: Interval | None
    velocity_nees: float | None
    velocity_nees_samples: int
    velocity_nees_bounds: Interval | None
    id_switches: int
    id_switches_per_min: float
    id_switches_per_uav_min: float
    minutes: float
    acquired_s: float | None
    latency_ms: float | None
    latency_p99_ms: float | None

    def as_dict(self) -> dict[str, object]:
        """Return the row for JSON."""
        return asdict(self)


def rows(
    score: FlightScore,
    scene: str,
    neighbours: int | None,
    *,
    tape: bool = True,
    distractors: bool = False,
    windy: bool = False,
) -> list[Row]:
    """Return the figures of all ranges together, then of each band that anything was seen in.

    Args:
        score: all flights of one case.
        scene: see `Row`, as the rest.
        neighbours: see there.
        tape: see there.
        distractors: see there.
        windy: see there.
    """
    sights, steps = score.sights, score.steps
    matched = sights["counted"] & sights["matched"]
    spread = correlated_steps(sights[matched], "white_p"), correlated_steps(sights[matched], "white_v")
    minutes = max(score.flown_s / 60.0, 1e-9)
    found: list[Row] = []
    limits = [
        (ALL, 0.0, math.inf),
        *((f"{low:g}-{high:g}", low, high) for low, high in itertools.pairwise(BANDS_M)),
    ]
    for name, low, high in limits:
        here = sights[(sights["range_m"] >= low) & (sights["range_m"] < high)]
        counted = here[here["counted"]]
        good = counted[counted["matched"]]
        tracked = steps[(steps["range_m"] >= low) & (steps["range_m"] < high)]
        false = tracked[~tracked["true"]]
        if name != ALL and not len(counted) and not len(tracked):
            continue
        samples = [int(len(good) / steps_each) for steps_each in spread]
        found.append(
            Row(
                scene=scene,
                tape=tape,
                distractors=distractors,
                windy=windy,
                neighbours=neighbours,
                band_m=name,
                range_m=_mean(counted["range_m"]),
                flights=len(np.unique(sights["flight"])),
                counted=len(counted),
                track_steps=len(tracked),
                missed=len(counted) - len(good),
                false_steps=len(false),
                false_tracks=len(np.unique(false[["flight", "track"]])),
                detection_rate=_mean(counted["matched"]),
                detection_ci95=rate_interval(counted, "neighbour", "matched"),
                detection_rate_at_once=_mean(here["matched"][here["visible"]]),
                precision=_mean(tracked["true"]),
                precision_ci95=rate_interval(tracked, "track", "true"),
                position_rmse_m=_rmse(good["error_p"]),
                velocity_rmse_mps=_rmse(good["error_v"]),
                velocity_rmse_steady_mps=_rmse(good["error_v"][good["steady"]]),
                relative_velocity_rmse_mps=_rmse(good["error_relative_v"]),
                position_rmse_axes_m=_rmse_axes(good["error_p"]),
                velocity_rmse_axes_mps=_rmse_axes(good["error_v"]),
                position_nees=_mean(good["white_p"] ** 2),
                position_nees_samples=samples[0],
                position_nees_bounds=nees_bounds(samples[0]),
                velocity_nees=_mean(good["white_v"] ** 2),
                velocity_nees_samples=samples[1],
                velocity_nees_bounds=nees_bounds(samples[1]),
                id_switches=score.switches,
                id_switches_per_min=score.switches / minutes,
                id_switches_per_uav_min=score.switches / max(score.uav_s / 60.0, 1e-9),
                minutes=score.flown_s / 60.0,
                acquired_s=_at(score.acquired_s, 50.0),
                latency_ms=_at(score.tracker_ms, 50.0),
                latency_p99_ms=_at(score.tracker_ms, 99.0),
            )
        )
    return found


def together(
    scores: Sequence[tuple[FlightScore, bool, bool]],
) -> list[Row]:
    """Return the figures of all cases that agree in tape and distractors, where there are several.

    Args:
        scores: of each case, with its tape and distractors.
    """
    found: list[Row] = []
    for tape, distractors in itertools.product((True, False), repeat=2):
        group = [score for score, *looks in scores if looks == [tape, distractors]]
        if len(group) > 1:
            joined = FlightScore.joined(group)
            found += rows(joined, TOGETHER, None, tape=tape, distractors=distractors)
    return found


def rate_interval(steps: NDArray[np.void], who: str, good: str) -> Interval | None:
    """Return the 95 % interval of a share of steps; None without any step.

    Steps that follow each other tell little new: as many count as independent as there are seconds, or
    fewer, if failures last longer than that.

    Args:
        steps: of `tracking_score.SIGHT` or `STEP`.
        who: field that tells whom a step is about.
        good: field that tells whether it succeeded.
    """
    if not len(steps):
        return None
    lengths = _bursts(steps[~steps[good]], who)
    burst = float(np.sum(lengths**2) / np.sum(lengths)) if len(lengths) else 1.0
    return wilson(float(np.mean(steps[good])), len(steps) / max(_STEPS_PER_S, burst))


def _bursts(steps: NDArray[np.void], who: str) -> FloatArray:
    """Return how many scans (b,) each run of consecutive steps of the same track or neighbour lasts."""
    if not len(steps):
        return np.zeros(0)
    ordered = steps[np.lexsort((steps["scan"], steps[who], steps["flight"]))]
    same = (np.diff(ordered["flight"]) == 0) & (np.diff(ordered[who]) == 0) & (np.diff(ordered["scan"]) == 1)
    return np.bincount(np.concatenate([[0], np.cumsum(~same)])).astype(np.float64)


def wilson(share: float, samples: float) -> Interval:
    """Return the 95 % interval of a probability of which `samples` independent trials show a share.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
    """
    square = _Z_95**2 / samples
    middle = (share + 0.5 * square) / (1.0 + square)
    half = math.sqrt(square * (share * (1.0 - share) + 0.25 * square)) / (1.0 + square)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def correlated_steps(sights: NDArray[np.void], field: str) -> float:
    """Return how many steps tell as much about a mean square as one independent step, at least 1.

    That is one and twice the sum of the squared autocorrelation of the errors, up to where it has faded.

    Args:
        sights: matched ones, of `tracking_score.SIGHT`.
        field: of vectors (3,) of errors.
    """
    total = 1.0
    for share in autocorrelation(sights, field):
        if share < _UNCORRELATED:
            break
        total += 2.0 * share**2
    return total


def autocorrelation(sights: NDArray[np.void], field: str) -> FloatArray:
    """Return the autocorrelation (30,) of errors one, two, ... scans apart; see `correlated_steps`."""
    ordered = sights[np.lexsort((sights["scan"], sights["neighbour"], sights["flight"]))]
    values = ordered[field]
    found = np.zeros(_LONGEST_LAG)
    for lag in range(1, min(_LONGEST_LAG + 1, len(ordered))):
        early, late = ordered[:-lag], ordered[lag:]
        pair = (early["flight"] == late["flight"]) & (early["neighbour"] == late["neighbour"])
        pair &= late["scan"] - early["scan"] == lag
        a, b = values[:-lag][pair], values[lag:][pair]
        power = math.sqrt(float(np.sum(a**2)) * float(np.sum(b**2)))
        found[lag - 1] = float(np.sum(a * b)) / power if power > 0.0 else 0.0
    return found


def nees_bounds(samples: int) -> Interval | None:
    """Return the 95 % bounds of the mean of independent normalised squares of three axes each."""
    freedom = 3 * samples
    if not freedom:
        return None
    return float(chdtri(freedom, 0.975) / freedom), float(chdtri(freedom, 0.025) / freedom)


def _mean(values: NDArray[np.generic]) -> float | None:
    return float(np.mean(np.asarray(values, np.float64))) if len(values) else None


def _rmse(errors: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else None


def _rmse_axes(errors: FloatArray) -> tuple[float, ...] | None:
    return tuple(np.sqrt(np.mean(errors**2, axis=0)).tolist()) if len(errors) else None


def _at(values: FloatArray, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None
