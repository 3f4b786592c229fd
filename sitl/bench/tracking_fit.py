"""What a simulation without points needs to know of how neighbours are seen, from scored flights."""

from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from companion.messages import FloatArray
from sitl.bench.tracking_rows import BANDS_M, autocorrelation
from sitl.bench.tracking_score import CURRENT_S, FlightScore

_SCAN_S = 0.1
_LEAST_STEPS = 50
_FADED = float(np.exp(-1.0))


@dataclass(frozen=True, slots=True)
class Errors:
    """How a neighbour is seen.

    Attributes:
        range_m: mean true range of what this was found from.
        steps: neighbour-steps that could be seen.
        position_sigma_m: standard deviation of each axis of the relative position, its mean error included.
        velocity_sigma_mps: the same of the velocity in the map.
        detection_probability: chance that a neighbour is perceived at a scan, given that it could be seen.
        dropout: chance that a scan shows nothing of a neighbour that could be seen for a while.
    """

    range_m: float
    steps: int
    position_sigma_m: float
    velocity_sigma_mps: float
    detection_probability: float
    dropout: float


@dataclass(frozen=True, slots=True)
class PerceptionModel:
    """Errors of perception, all ranges together and by range.

    Attributes:
        overall: all ranges together.
        by_range: nearest first; bands seen too little are left out.
        position_correlation_s: after which an error of the position has faded to 1/e.
        velocity_correlation_s: the same of the velocity.
        latency_s: mean time from a scan's last packet until its tracks are known; transport is not in it.
        acquisition_s: mean time from coming into sight until perceived.
        own_velocity_sigma_mps: standard deviation of each axis of the own velocity.
    """

    overall: Errors
    by_range: tuple[Errors, ...]
    position_correlation_s: float
    velocity_correlation_s: float
    latency_s: float
    acquisition_s: float
    own_velocity_sigma_mps: float

    def settings(self, range_m: float = 10.0) -> dict[str, float | int]:
        """Return what the abstract swarm's perception is set to, to see as in these flights.

        Args:
            range_m: how far it sees.
        """
        far = np.array([errors.range_m for errors in self.by_range])
        weights = np.sqrt([errors.steps for errors in self.by_range])
        position = _line(far, np.array([errors.position_sigma_m for errors in self.by_range]), weights)
        velocity = _line(far, np.array([errors.velocity_sigma_mps for errors in self.by_range]), weights)
        missed = np.array([errors.dropout for errors in self.by_range])
        dropout, growth = _line((far / range_m) ** 2, missed, weights)
        return {
            "neighbour_delay_s": self.latency_s,
            "position_sigma_m": position[0],
            "position_sigma_per_m": position[1],
            "velocity_sigma_mps": velocity[0],
            "velocity_sigma_per_m": velocity[1],
            "ego_velocity_sigma_mps": self.own_velocity_sigma_mps,
            "range_m": range_m,
            "dropout": min(dropout, 0.99),
            "dropout_far": min(growth, 0.99 - min(dropout, 0.99)),
            "sightings": 1 + round(self.acquisition_s / _SCAN_S),
            "coast_s": CURRENT_S,
        }

    def as_dict(self) -> dict[str, object]:
        """Return it for YAML and JSON, the figures of all ranges at the top."""
        return {
            "position_sigma_m": self.overall.position_sigma_m,
            "velocity_sigma_mps": self.overall.velocity_sigma_mps,
            "detection_probability": self.overall.detection_probability,
            "latency_s": self.latency_s,
            "acquisition_s": self.acquisition_s,
            "position_correlation_s": self.position_correlation_s,
            "velocity_correlation_s": self.velocity_correlation_s,
            "own_velocity_sigma_mps": self.own_velocity_sigma_mps,
            "steps": self.overall.steps,
            "perception": self.settings(),
            "by_range": [asdict(errors) for errors in self.by_range],
        }


def fit(score: FlightScore) -> PerceptionModel | None:
    """Return the model of scored flights; None if too little was seen.

    Args:
        score: of all flights that should count, see `FlightScore.joined`.
    """
    sights = score.sights
    overall = _errors(sights)
    if overall is None:
        return None
    bands = [
        _errors(sights[(sights["range_m"] >= low) & (sights["range_m"] < high)])
        for low, high in pairwise(BANDS_M)
    ]
    matched = sights[sights["counted"] & sights["matched"]]
    return PerceptionModel(
        overall,
        tuple(errors for errors in bands if errors is not None),
        _faded_s(autocorrelation(matched, "error_p")),
        _faded_s(autocorrelation(matched, "error_v")),
        float(np.mean(score.scan_ms)) * 1e-3,
        float(np.mean(score.acquired_s)) if len(score.acquired_s) else 0.0,
        float(np.sqrt(np.mean((matched["error_v"] - matched["error_relative_v"]) ** 2))),
    )


def _errors(sights: NDArray[np.void]) -> Errors | None:
    visible = sights[sights["visible"]]
    matched = visible[visible["counted"] & visible["matched"]]
    if len(matched) < _LEAST_STEPS:
        return None
    return Errors(
        float(np.mean(visible["range_m"])),
        len(visible),
        float(np.sqrt(np.mean(matched["error_p"] ** 2))),
        float(np.sqrt(np.mean(matched["error_v"] ** 2))),
        float(np.mean(visible["matched"])),
        1.0 - float(np.mean(visible["fresh"][visible["counted"]])),
    )


def _line(x: FloatArray, y: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """Return the best a and b of y = a + b x, none of them negative."""
    columns = np.column_stack([np.ones_like(x), x]) * weights[:, None]
    (a, b), _ = nnls(columns, y * weights)
    return float(a), float(b)


def _faded_s(shares: FloatArray) -> float:
    """Return where an autocorrelation (k,) by scans falls below 1/e, between scans by a straight line."""
    curve = np.concatenate([[1.0], shares])
    below = np.flatnonzero(curve < _FADED)
    if not len(below):
        return _SCAN_S * (len(curve) - 1)
    k = int(below[0])
    return _SCAN_S * (k - 1 + float((curve[k - 1] - _FADED) / (curve[k - 1] - curve[k])))
