"""After an outage: find the place again in the kept map, or refuse.

The prediction has grown uncertain, so starting points are laid over the region it allows and each is
matched with a few points, a few starting points a scan. A place is believed when one match explains the
scan clearly better than any other distinct one, all six directions are observed, and the scans that
follow confirm it, each at the place to which the IMU says it has moved.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.clock import NANOSECONDS_PER_SECOND
from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry.state import THETA, NavigationState, P, V
from companion.perception.odometry.update import Correction, ScanMatcher

STARTS_PER_SCAN = 3
CONFIRMATIONS = 4
"""Scans in a row that must agree before a place is believed."""
MOST_STARTS = 200
"""More starting points would take longer than the vehicle stays in the region they cover."""

_FEW_POINTS = 350
_SPACING_M = 0.6  # the coarse map draws a scan in from half of this and more
_YAW_SPACING = float(np.radians(10.0))
_SIGMAS = 2.5
_NEAR_SIGMA_M = 0.15  # how far a confirmed place may be off at the next scan
_NEAR_SIGMA = float(np.radians(1.5))
_LOOSE = 4.0
_LEAST_SHARE = 0.5  # of the points that a believed place must explain
_CLEARLY_BETTER = 0.85  # the second best place may explain this share of what the best does
_SAME_PLACE_M = 0.3
_SAME_PLACE = float(np.radians(5.0))
_STEADY_M = 0.1
_STEADY = float(np.radians(2.0))


@dataclass(frozen=True, slots=True, eq=False)
class Shift:
    """How a found pose differs from the predicted one, in map axes.

    Attributes:
        p_map: (3,) metres.
        turn_map: (3,) rotation vector, rad.
        v_map: (3,) m/s.
        share: of the tried points that the match explains.
    """

    p_map: FloatArray
    turn_map: FloatArray
    v_map: FloatArray
    share: float

    def after(self, passed_s: float) -> "Shift":
        """Return the shift some time later: the velocities differ too."""
        return replace(self, p_map=self.p_map + passed_s * self.v_map)

    def is_near(self, other: "Shift", distance_m: float, angle: float) -> bool:
        """Whether two shifts lead to the same place."""
        turn = rotation.log(
            rotation.multiply(rotation.exp(self.turn_map), rotation.conjugate(rotation.exp(other.turn_map)))
        )
        return bool(np.linalg.norm(self.p_map - other.p_map) < distance_m and np.linalg.norm(turn) < angle)


class Relocaliser:
    """Searches for the place of a vehicle whose prediction has become uncertain."""

    def __init__(self, matcher: ScanMatcher) -> None:
        """Search with a matcher and the maps it works on."""
        self._matcher = matcher
        self.forget()

    def forget(self) -> None:
        """Begin the next search anew."""
        self._starts: list[Shift] = []
        self._places: list[Shift] = []
        self._candidate: Shift | None = None
        self._confirmed = 0
        self._t_ns = 0
        self.reason = ""
        self.hopeless = False

    def consider(
        self, predicted: NavigationState, points_imu: FloatArray, chosen: NDArray[np.int64]
    ) -> Correction | None:
        """Use one scan; return the correction that ends the search, or None while there is none.

        Args:
            predicted: at the scan's end, from the IMU alone since the outage; its covariance is the
                region that is searched.
            points_imu: (n, 3) de-skewed points.
            chosen: (m,) indices of the points to match.
        """
        passed_s = (predicted.t_ns - self._t_ns) / NANOSECONDS_PER_SECOND
        self._t_ns = predicted.t_ns
        if self._candidate is not None:
            expected = self._candidate.after(passed_s)
            return self._confirm(expected, predicted, points_imu, chosen)
        self._starts = [start.after(passed_s) for start in self._starts]
        self._places = [place.after(passed_s) for place in self._places]
        if not self._starts:
            self._places = []
            self._starts = starting_points(predicted.covariance)
            if not self._starts:
                self.hopeless = True
                self.reason = "the place could be too far away to be searched"
                return None
        few = np.ascontiguousarray(chosen[:: max(1, len(chosen) // _FEW_POINTS)])
        for start in self._starts[:STARTS_PER_SCAN]:
            self._try(start, predicted, points_imu, few)
        del self._starts[:STARTS_PER_SCAN]
        if not self._starts:
            self._candidate = self._unambiguous()
            self._confirmed = 0
        return None

    def _try(
        self, start: Shift, predicted: NavigationState, points_imu: FloatArray, few: NDArray[np.int64]
    ) -> None:
        """Match from one starting point; remember the place it leads to."""
        guess = moved_to(predicted, start, 0.5 * _SPACING_M, 0.5 * _YAW_SPACING)
        correction = self._matcher.correct(guess, points_imu, few)
        if not _is_sound(correction):
            return
        found = shift_of(predicted, correction)
        for index, place in enumerate(self._places):
            if found.is_near(place, _SAME_PLACE_M, _SAME_PLACE):
                if found.share > place.share:
                    self._places[index] = found
                return
        self._places.append(found)

    def _unambiguous(self) -> Shift | None:
        """Return the best of all places if no other comes near it."""
        ranked = sorted(self._places, key=lambda place: -place.share)
        if not ranked:
            self.reason = "no place matches"
            return None
        if len(ranked) > 1 and ranked[1].share > _CLEARLY_BETTER * ranked[0].share:
            self.reason = f"{len(ranked)} places match alike"
            return None
        self.reason = "confirming the place"
        return ranked[0]

    def _confirm(
        self,
        expected: Shift,
        predicted: NavigationState,
        points_imu: FloatArray,
        chosen: NDArray[np.int64],
    ) -> Correction | None:
        """Match all points where the candidate must be by now; drop it if they disagree."""
        # Found among the first starting points, it may have drifted while the others were tried.
        loose = _LOOSE if self._confirmed == 0 else 1.0
        guess = moved_to(predicted, expected, loose * _NEAR_SIGMA_M, loose * _NEAR_SIGMA)
        correction = self._matcher.correct(guess, points_imu, chosen)
        found = shift_of(predicted, correction)
        if not _is_sound(correction) or not found.is_near(expected, loose * _STEADY_M, loose * _STEADY):
            self._candidate = None
            self.reason = "the next scan did not confirm the place"
            return None
        self._candidate = found
        self._confirmed += 1
        return correction if self._confirmed >= CONFIRMATIONS else None


def starting_points(covariance: FloatArray) -> list[Shift]:
    """Return starting points over the region that a covariance (18, 18) allows, the likeliest first.

    They lie on a grid in position and heading; what lies between, and tilt, the matcher bridges. The
    list is empty when the region is too large.
    """
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance[:6, :6]), 1e-12))
    heading = float(np.sqrt(max(np.trace(covariance[THETA, THETA]) / 3.0, 1e-12)))
    spread = np.append(sigmas[:3], heading)
    spacing = np.array([_SPACING_M] * 3 + [_YAW_SPACING])
    reach = np.floor(_SIGMAS * spread / spacing + 0.5).astype(int)
    if np.prod(2.0 * reach + 1.0) > 20.0 * MOST_STARTS:
        return []
    axes = [spacing[axis] * np.arange(-reach[axis], reach[axis] + 1) for axis in range(4)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 4)
    # A node stands for its surroundings of half a spacing.
    beyond = np.maximum(np.abs(grid) - 0.5 * spacing, 0.0) / spread
    distance = np.einsum("ij,ij->i", beyond, beyond)
    likely = np.nonzero(distance <= _SIGMAS**2)[0]
    if len(likely) > MOST_STARTS:
        return []
    nearness = np.einsum("ij,ij->i", grid / spread, grid / spread)
    order = likely[np.argsort(nearness[likely], kind="stable")]
    # Whoever is that far off by now has been off in velocity.
    drift = np.linalg.solve(covariance[P, P] + 1e-9 * np.eye(3), covariance[P, V]).T
    return [
        Shift(grid[i, :3].copy(), np.array([0.0, 0.0, grid[i, 3]]), drift @ grid[i, :3], 0.0) for i in order
    ]


def moved_to(predicted: NavigationState, shift: Shift, sigma_m: float, sigma: float) -> NavigationState:
    """Return a prediction under the assumption that its pose is shifted, known to given deviations.

    Velocity, biases and gravity follow as far as the covariance ties them to the pose: with G = P E'
    (E P E')^-1, where E selects the pose, the error is G e and the covariance P + G (S - E P E') G'.
    """
    pose = np.concatenate([shift.p_map, predicted.R_map_imu.T @ shift.turn_map])
    prior = predicted.covariance
    gain = np.linalg.solve(prior[:6, :6] + 1e-12 * np.eye(6), prior[:6, :]).T
    moved = predicted.plus(gain @ pose)
    S = np.diag([sigma_m**2] * 3 + [sigma**2] * 3)
    covariance = prior + gain @ (S - prior[:6, :6]) @ gain.T
    moved.covariance[:] = 0.5 * (covariance + covariance.T)
    return moved


def shift_of(predicted: NavigationState, correction: Correction) -> Shift:
    """Return how a correction's result differs from a prediction."""
    state = correction.state
    turn = rotation.log(rotation.from_matrix(state.R_map_imu @ predicted.R_map_imu.T))
    return Shift(
        state.vector[P] - predicted.vector[P],
        turn,
        state.v_map - predicted.v_map,
        correction.matched / max(1, correction.offered),
    )


def _is_sound(correction: Correction) -> bool:
    """Whether a match stands on enough points and fixes every direction."""
    return (
        correction.accepted
        and correction.matched >= _LEAST_SHARE * correction.offered
        and correction.observability is not None
        and correction.observability.degenerate == 0
    )
