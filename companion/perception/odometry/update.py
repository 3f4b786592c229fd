"""Correcting the predicted state with one scan: the iterated point-to-plane update."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray
from companion.perception.odometry import matching_kernels
from companion.perception.odometry import registration_kernels as kernels
from companion.perception.odometry.degeneracy import Observability
from companion.perception.odometry.preprocessing import MOST_POINTS
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import ERROR_SIZE, STATE_SIZE, NavigationState
from companion.perception.odometry.voxel_map import VoxelMap


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
        seen: (24,) the prediction with the pose at which the points lie on the map; it differs from the
            corrected state where de-skewing took a wrong velocity or rate.
        gain: (6, 6) covariance of that pose against the map, by which a gradient moves it.
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
    seen: FloatArray
    gain: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a scan shows of the state at its end.

    Attributes:
        lag_s: mean age of its points.
        unseen: (18, 18) part of the prediction's covariance that arose too late to be seen.
    """

    lag_s: float
    unseen: FloatArray


AT_ONCE = View(0.0, np.zeros((ERROR_SIZE, ERROR_SIZE)))
"""View of a scan whose points were all taken at its end."""


class ScanMatcher:
    """Finds the state that explains both the prediction and a scan's points."""

    def __init__(self, settings: OdometrySettings, fine: VoxelMap, coarse: VoxelMap) -> None:
        """Match against two maps of different cell sizes."""
        self._settings = settings
        self._fine, self._coarse = fine, coarse
        self._planes = np.zeros((MOST_POINTS, matching_kernels.PLANE_WIDTH))
        self._tuning = _packed(settings)

    def correct(
        self,
        predicted: NavigationState,
        points_imu: FloatArray,
        chosen: NDArray[np.int64],
        view: View = AT_ONCE,
    ) -> Correction:
        """Correct a prediction; if the points contradict it, search once more and more widely.

        Args:
            predicted: state and covariance at the scan's end.
            points_imu: (n, 3) de-skewed points.
            chosen: (m,) indices of the points to match.
            view: when they were measured, and what noise came later.
        """
        correction = self._iterate(predicted, points_imu, chosen, view)
        if correction.accepted or correction.offered < self._settings.min_effective_points:
            return correction
        wide = self._iterate(self.widened(predicted), points_imu, chosen, view)
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
        seen: FloatArray,
        points_imu: FloatArray,
        chosen: NDArray[np.int64],
        starts: NDArray[np.int64],
        count: int,
        information: FloatArray,
        weights: FloatArray,
    ) -> None:
        """Split what corrected a state by when the ground it rests on was first seen.

        Args:
            seen: pose (>= 12,) of the newest correction.
            points_imu: as given to it.
            chosen: as given to it.
            starts: (>= count,) first birth of each period, ascending.
            count: number of periods.
            information: (>= count, 6, 6) receives H' W H of each period.
            weights: (>= count,) receives the sum of weights of each period.
        """
        matching_kernels.share_by_birth(
            points_imu, chosen, self._planes, seen, starts, count, information, weights
        )

    def _iterate(
        self, predicted: NavigationState, points_imu: FloatArray, chosen: NDArray[np.int64], view: View
    ) -> Correction:
        """Run the iterated update once; see `registration_kernels.register`."""
        state = predicted.copy()
        shares, directions = np.zeros(6), np.zeros((6, 6))
        summary = np.zeros(kernels.N_SUMMARY)
        seen, gain = np.zeros(STATE_SIZE), np.zeros((6, 6))
        kernels.register(
            points_imu,
            chosen,
            predicted.vector,
            predicted.covariance,
            view.lag_s,
            view.unseen,
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
            self._tuning,
            self._planes,
            seen,
            state.vector,
            state.covariance,
            shares,
            directions,
            summary,
            gain,
        )
        accepted, matched = bool(summary[kernels.ACCEPTED]), int(summary[kernels.MATCHED])
        observability = None
        if matched >= self._settings.min_effective_points:
            kept = shares >= self._settings.degenerate_fraction
            observability = Observability(shares, directions, float(summary[kernels.LEVER]), kept)
        return Correction(
            state=state if accepted else predicted,
            accepted=accepted,
            offered=len(chosen),
            found=int(summary[kernels.FOUND]),
            matched=matched,
            residual_rms_m=math.sqrt(summary[kernels.SQUARES] / max(float(summary[kernels.WEIGHT]), 1e-12)),
            normalised_rms=float(summary[kernels.NORMALISED_RMS]),
            observability=observability,
            wide=False,
            iterations=int(summary[kernels.ITERATIONS]),
            searches=int(summary[kernels.SEARCHES]),
            seen=seen,
            gain=gain,
        )


def _packed(settings: OdometrySettings) -> FloatArray:
    """Return the numbers that `registration_kernels.register` wants, in its order."""
    tuning = np.zeros(kernels.N_TUNING)
    tuning[kernels.THICKNESS_M] = settings.plane_thickness_m
    tuning[kernels.RANGE_VARIANCE] = settings.range_sigma_m**2
    tuning[kernels.ANGLE_VARIANCE] = math.radians(settings.angle_sigma_deg) ** 2
    tuning[kernels.MAP_VARIANCE] = settings.map_sigma_m**2
    tuning[kernels.LEAST_SHARE] = settings.degenerate_fraction
    tuning[kernels.MIN_POINTS] = settings.min_effective_points
    tuning[kernels.MAX_ITERATIONS] = settings.max_iterations
    tuning[kernels.CONSISTENT_SHARE] = settings.consistent_share
    return tuning
