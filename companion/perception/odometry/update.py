"""Correcting the predicted state with one scan: the iterated point-to-plane update."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray
from companion.perception.odometry import matching_kernels
from companion.perception.odometry.degeneracy import Observability, keep_observed
from companion.perception.odometry.preprocessing import MOST_POINTS
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState, P
from companion.perception.odometry.voxel_map import VoxelMap

_SMALL_STEP_M = 5e-4
_SEARCH_AGAIN_CELLS = 0.1  # of a fine cell: planes found farther away than this are searched anew


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What one scan did to the state.

    Attributes:
        state: the corrected state (the prediction itself when not accepted).
        accepted: whether enough points matched to correct it.
        matched: points with a plane whose residual passed the gate.
        offered: points that were tried.
        residual_rms_m: weighted root mean square of the residuals.
        normalised_rms: the same in standard deviations.
        observability: how the six directions were observed, None when not accepted.
        iterations: Gauss-Newton steps taken.
        searches: how often planes were searched.
    """

    state: NavigationState
    accepted: bool
    matched: int
    offered: int
    residual_rms_m: float
    normalised_rms: float
    observability: Observability | None
    iterations: int
    searches: int


class ScanMatcher:
    """Finds the state that explains both the prediction and a scan's points."""

    def __init__(self, settings: OdometrySettings, fine: VoxelMap, coarse: VoxelMap) -> None:
        """Match against two maps of different cell sizes."""
        self._settings = settings
        self._fine, self._coarse = fine, coarse
        self._planes = np.zeros((MOST_POINTS, matching_kernels.PLANE_WIDTH))
        self._information = np.zeros((6, 6))
        self._gradient = np.zeros(6)
        self._statistics = np.zeros(4)

    def correct(
        self, predicted: NavigationState, points_imu: FloatArray, chosen: NDArray[np.int64]
    ) -> Correction:
        """Run the iterated update.

        With A = H' W H and b = -H' W r at the present iterate, whose error from the prediction is e,
        the next error is P E (I + A E'P E)^-1 (b + A E'e), where E selects the pose; the 18 x 18 prior
        is never inverted. Source: W. Xu et al., "FAST-LIO2", 2022, equation 19, by the matrix
        inversion lemma.

        Args:
            predicted: state and covariance at the scan's end.
            points_imu: (n, 3) de-skewed points.
            chosen: (m,) indices of the points to match.
        """
        prior = predicted.covariance
        pose_prior = np.ascontiguousarray(prior[:6, :6])
        state, error = predicted, np.zeros(18)
        searched_at: NavigationState | None = None
        observability: Observability | None = None
        matched = iterations = searches = 0
        A, b = self._information, self._gradient
        reach_m = self._settings.fine_cell_m * _SEARCH_AGAIN_CELLS
        for iteration in range(self._settings.max_iterations):
            if searched_at is None or _displacement(searched_at, state, 10.0) > reach_m:
                self._find_planes(state, points_imu, chosen)
                searched_at = state
                searches += 1
            matched = self._accumulate(state, points_imu, chosen, pose_prior)
            if matched < self._settings.min_effective_points:
                return self._refused(predicted, matched, len(chosen), iteration, searches)
            A, b, observability = keep_observed(
                self._information,
                self._gradient,
                float(self._statistics[1]),
                float(self._statistics[2]),
                self._settings.degenerate_fraction,
            )
            error = prior[:, :6] @ np.linalg.solve(np.eye(6) + A @ pose_prior, b + A @ error[:6])
            previous, state = state, predicted.plus(error)
            iterations = iteration + 1
            if _displacement(previous, state, 10.0) < _SMALL_STEP_M:
                break
        gain = np.linalg.solve(np.eye(6) + A @ pose_prior, A)
        posterior = prior - prior[:, :6] @ gain @ prior[:6, :]
        state.covariance[:] = 0.5 * (posterior + posterior.T)
        weight = float(self._statistics[1])
        return Correction(
            state,
            True,
            matched,
            len(chosen),
            float(np.sqrt(self._statistics[0] / weight)),
            float(np.sqrt(self._statistics[3] / matched)),
            observability,
            iterations,
            searches,
        )

    def _find_planes(self, state: NavigationState, points_imu: FloatArray, chosen: NDArray[np.int64]) -> None:
        matching_kernels.find_planes(
            points_imu,
            chosen,
            state.vector,
            self._fine.table_keys,
            self._fine.table_blocks,
            self._fine.cells,
            self._fine.cell_m,
            self._coarse.table_keys,
            self._coarse.table_blocks,
            self._coarse.cells,
            self._coarse.cell_m,
            self._settings.plane_thickness_m,
            self._planes,
        )

    def _accumulate(
        self,
        state: NavigationState,
        points_imu: FloatArray,
        chosen: NDArray[np.int64],
        pose_prior: FloatArray,
    ) -> int:
        return matching_kernels.accumulate(
            points_imu,
            chosen,
            self._planes,
            state.vector,
            pose_prior,
            self._settings.range_sigma_m**2,
            float(np.radians(self._settings.angle_sigma_deg)) ** 2,
            self._settings.map_sigma_m**2,
            self._information,
            self._gradient,
            self._statistics,
        )

    @staticmethod
    def _refused(
        predicted: NavigationState, matched: int, offered: int, iterations: int, searches: int
    ) -> Correction:
        return Correction(predicted, False, matched, offered, 0.0, 0.0, None, iterations, searches)


def _displacement(before: NavigationState, after: NavigationState, lever_m: float) -> float:
    """Return how far a point at `lever_m` may have moved between two states, metres."""
    turn = before.R_map_imu.T @ after.R_map_imu
    angle = float(np.linalg.norm(turn - np.eye(3))) / np.sqrt(2.0)
    return float(np.linalg.norm(after.vector[P] - before.vector[P])) + lever_m * float(angle)
