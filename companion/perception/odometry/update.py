"""Correcting the predicted state with one scan: the iterated point-to-plane update."""

from dataclasses import dataclass, replace

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
_LEVER_M = 10.0  # distance of a typical point, to speak of rotations in metres
_WORST_NORMALISED_RMS = 2.5
_COARSE_ITERATIONS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What one scan did to the state.

    Attributes:
        state: the corrected state (the prediction itself when not accepted).
        accepted: whether enough points matched, and consistently, to correct it.
        offered: points that were tried.
        found: points that found a plane.
        matched: points whose distance from their plane passed the gate.
        residual_rms_m: weighted root mean square of the residuals.
        normalised_rms: the same in standard deviations.
        observability: how the six directions were observed, None when too few points matched.
        wide: whether the prediction was contradicted and a wider search found the place.
        iterations: Gauss-Newton steps taken.
        searches: how often planes were searched.
    """

    state: NavigationState
    accepted: bool
    offered: int
    found: int
    matched: int
    residual_rms_m: float
    normalised_rms: float
    observability: Observability | None
    wide: bool
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
        """Correct a prediction; if the points contradict it, search once more and more widely.

        Args:
            predicted: state and covariance at the scan's end.
            points_imu: (n, 3) de-skewed points.
            chosen: (m,) indices of the points to match.
        """
        correction = self._iterate(predicted, points_imu, chosen)
        if correction.accepted or correction.offered < self._settings.min_effective_points:
            return correction
        wide = self._iterate(self.widened(predicted), points_imu, chosen)
        return replace(wide, wide=True) if wide.accepted else correction

    def widened(self, predicted: NavigationState) -> NavigationState:
        """Return a prediction that admits to be off by more than it believes."""
        settings = self._settings
        wide = predicted.copy()
        sigmas = [settings.wide_position_sigma_m] * 3
        sigmas += [float(np.radians(settings.wide_rotation_sigma_deg))] * 3
        sigmas += [settings.wide_velocity_sigma] * 3
        wide.covariance[range(9), range(9)] += np.square(sigmas)
        return wide

    def share_by_birth(
        self,
        state: NavigationState,
        points_imu: FloatArray,
        chosen: NDArray[np.int64],
        starts: NDArray[np.int64],
        count: int,
        information: FloatArray,
        weights: FloatArray,
    ) -> None:
        """Split what corrected a state by when the ground it rests on was first seen.

        Args:
            state: as the newest `correct` returned it.
            points_imu: as given to it.
            chosen: as given to it.
            starts: (>= count,) first birth of each period, ascending.
            count: number of periods.
            information: (>= count, 6, 6) receives H' W H of each period.
            weights: (>= count,) receives the sum of weights of each period.
        """
        matching_kernels.share_by_birth(
            points_imu, chosen, self._planes, state.vector, starts, count, information, weights
        )

    def _iterate(
        self, predicted: NavigationState, points_imu: FloatArray, chosen: NDArray[np.int64]
    ) -> Correction:
        """Run the iterated update.

        With A = H' W H and b = -H' W r at the present iterate, whose error from the prediction is e,
        the next error is P E (I + A E'P E)^-1 (b + A E'e), where E selects the pose; the 18 x 18 prior
        is never inverted. Source: W. Xu et al., "FAST-LIO2", 2022, equation 19, by the matrix
        inversion lemma.
        """
        prior = predicted.covariance
        pose_prior = np.ascontiguousarray(prior[:6, :6])
        state, error = predicted, np.zeros(18)
        searched_at: NavigationState | None = None
        # A prediction less certain than a fine cell would find the wrong ones of its planes, so coarse
        # ones come first; what they bring near enough is then gated as narrowly as if it had been near.
        spread = _spread_m(pose_prior) / self._settings.fine_cell_m
        fine = spread < 1.0
        gate = pose_prior
        observability: Observability | None = None
        found = matched = iterations = searches = 0
        A = self._information
        reach_m = self._settings.fine_cell_m * _SEARCH_AGAIN_CELLS
        while iterations < self._settings.max_iterations:
            if searched_at is None or _displacement_m(searched_at, state) > reach_m:
                found = self._find_planes(state, points_imu, chosen, fine)
                searched_at = state
                searches += 1
            matched = self._accumulate(state, points_imu, chosen, gate)
            if matched < self._settings.min_effective_points:
                break
            A, b, observability = keep_observed(
                self._information,
                self._gradient,
                float(self._statistics[1]),
                float(self._statistics[2]),
                self._settings.degenerate_fraction,
            )
            error = prior[:, :6] @ np.linalg.solve(np.eye(6) + A @ pose_prior, b + A @ error[:6])
            previous, state = state, predicted.plus(error)
            iterations += 1
            settled = _displacement_m(previous, state) < _SMALL_STEP_M
            if fine and settled:
                break
            if not fine and (settled or iterations >= _COARSE_ITERATIONS):
                fine, searched_at, gate = True, None, pose_prior / spread**2
        enough = matched >= self._settings.min_effective_points
        weight = max(float(self._statistics[1]), 1e-12)
        normalised_rms = float(np.sqrt(self._statistics[3] / max(matched, 1)))
        consistent = (
            matched >= self._settings.consistent_share * found and normalised_rms < _WORST_NORMALISED_RMS
        )
        if enough and consistent:
            gain = np.linalg.solve(np.eye(6) + A @ pose_prior, A)
            posterior = prior - prior[:, :6] @ gain @ prior[:6, :]
            state.covariance[:] = 0.5 * (posterior + posterior.T)
        return Correction(
            state=state if enough and consistent else predicted,
            accepted=enough and consistent,
            offered=len(chosen),
            found=found,
            matched=matched,
            residual_rms_m=float(np.sqrt(self._statistics[0] / weight)),
            normalised_rms=normalised_rms,
            observability=observability if enough else None,
            wide=False,
            iterations=iterations,
            searches=searches,
        )

    def _find_planes(
        self, state: NavigationState, points_imu: FloatArray, chosen: NDArray[np.int64], fine: bool
    ) -> int:
        return matching_kernels.find_planes(
            points_imu,
            chosen,
            state.vector,
            self._fine.table_keys,
            self._fine.table_blocks,
            self._fine.block_born,
            self._fine.cells,
            self._fine.cell_m,
            self._coarse.table_keys,
            self._coarse.table_blocks,
            self._coarse.block_born,
            self._coarse.cells,
            self._coarse.cell_m,
            self._settings.plane_thickness_m,
            fine,
            self._planes,
        )

    def _accumulate(
        self,
        state: NavigationState,
        points_imu: FloatArray,
        chosen: NDArray[np.int64],
        gate: FloatArray,
    ) -> int:
        return matching_kernels.accumulate(
            points_imu,
            chosen,
            self._planes,
            state.vector,
            gate,
            self._settings.range_sigma_m**2,
            float(np.radians(self._settings.angle_sigma_deg)) ** 2,
            self._settings.map_sigma_m**2,
            self._information,
            self._gradient,
            self._statistics,
        )


def _spread_m(pose_covariance: FloatArray) -> float:
    """Return the standard deviation of where a typical point lies, metres."""
    position = max(0.0, float(np.trace(pose_covariance[:3, :3])))
    turn = max(0.0, float(np.trace(pose_covariance[3:, 3:])))
    return float(np.sqrt(position + _LEVER_M**2 * turn))


def _displacement_m(before: NavigationState, after: NavigationState) -> float:
    """Return how far a typical point may have moved between two states, metres."""
    turn = float(np.linalg.norm(after.R_map_imu - before.R_map_imu)) / np.sqrt(2.0)
    return float(np.linalg.norm(after.vector[P] - before.vector[P]) + _LEVER_M * turn)
