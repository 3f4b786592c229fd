"""The iterated update as it reads in the literature, slow: what the compiled loop must equal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray
from companion.perception.odometry import matching_kernels, registration_kernels
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState, P
from companion.perception.odometry.update import View
from companion.perception.odometry.voxel_map import VoxelMap


@dataclass(frozen=True)
class Expected:
    state: NavigationState
    accepted: bool
    matched: int
    iterations: int
    searches: int
    shares: FloatArray
    seen: FloatArray
    gain: FloatArray


def keep_observed(
    information: FloatArray, gradient: FloatArray, weight: float, lever_square: float, least_share: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project the normal equations onto the directions whose share of the weight suffices."""
    lever_m = float(np.sqrt(max(lever_square, 1e-9) / max(weight, 1e-9)))
    scale = np.diag([1.0, 1.0, 1.0, 1.0 / lever_m, 1.0 / lever_m, 1.0 / lever_m])
    values, vectors = np.linalg.eigh(scale @ information @ scale)
    shares = np.maximum(values, 0.0) / max(weight, 1e-9)
    kept = vectors[:, shares >= least_share]
    projection, back = kept @ kept.T, np.linalg.inv(scale)
    remaining = back @ projection @ scale @ information @ scale @ projection @ back
    return remaining, back @ projection @ scale @ gradient, shares


def register(
    predicted: NavigationState,
    points_imu: FloatArray,
    chosen: NDArray[np.int64],
    fine: VoxelMap,
    coarse: VoxelMap,
    settings: OdometrySettings,
    view: View,
) -> Expected:
    """Iterate with full matrices."""
    prior = predicted.covariance - view.unseen
    E = np.eye(18)[:, :6]  # of the pose shown, by the error at the end
    E[6:9, :3] = -view.lag_s * np.eye(3)
    E[9:12, 3:] = view.lag_s * np.eye(3)
    planes = np.zeros((len(chosen), matching_kernels.PLANE_WIDTH))
    A, b, statistics = np.zeros((6, 6)), np.zeros(6), np.zeros(4)
    state, error = predicted, np.zeros(18)
    searched_at: NavigationState | None = None
    seen, shown_prior = predicted, np.ascontiguousarray(E.T @ prior @ E)
    spread = spread_m(prior) / settings.fine_cell_m
    use_fine, gate = spread < 1.0, shown_prior
    found = matched = iterations = searches = 0
    shares, gain = np.zeros(6), np.zeros((6, 6))
    while iterations < settings.max_iterations:
        far = searched_at is None or displacement_m(searched_at, seen) > 0.1 * settings.fine_cell_m
        if far:
            found = matching_kernels.find_planes(
                points_imu, chosen, seen.vector,
                fine.table_keys, fine.table_blocks, fine.block_born, fine.cells, fine.cell_m,
                coarse.table_keys, coarse.table_blocks, coarse.block_born, coarse.cells, coarse.cell_m,
                settings.plane_thickness_m, use_fine, planes,
            )  # fmt: skip
            searched_at = seen
            searches += 1
        matched = matching_kernels.accumulate(
            points_imu, chosen, planes, seen.vector, gate, settings.range_sigma_m**2,
            float(np.radians(settings.angle_sigma_deg)) ** 2, settings.map_sigma_m**2, A, b, statistics,
        )  # fmt: skip
        if matched < settings.min_effective_points:
            break
        kept_A, kept_b, shares = keep_observed(
            A, b, float(statistics[1]), float(statistics[2]), settings.degenerate_fraction
        )
        inner = np.linalg.inv(np.eye(6) + kept_A @ E.T @ prior @ E)
        error = prior @ E @ inner @ (kept_b + kept_A @ E.T @ error)
        previous, seen = seen, predicted.plus(np.concatenate([E.T @ error, np.zeros(12)]))
        iterations += 1
        settled = displacement_m(previous, seen) < registration_kernels.SMALL_STEP_M
        if use_fine and settled:
            break
        if not use_fine and (settled or iterations >= registration_kernels.COARSE_ITERATIONS):
            use_fine, searched_at, gate = True, None, shown_prior / spread**2
    rms = np.sqrt(statistics[3] / max(matched, 1))
    accepted = (
        matched >= settings.min_effective_points
        and matched >= settings.consistent_share * found
        and bool(rms < registration_kernels.WORST_NORMALISED_RMS)
    )
    if accepted:
        state = predicted.plus(error)
        inner = np.linalg.inv(np.eye(6) + kept_A @ E.T @ prior @ E)
        remaining = prior - prior @ E @ inner @ kept_A @ E.T @ prior
        state.covariance[:] = remaining + view.unseen
        gain = E.T @ remaining @ E
    final = state if accepted else predicted
    return Expected(final, accepted, matched, iterations, searches, shares, seen.vector, gain)


def spread_m(covariance: FloatArray) -> float:
    return float(np.sqrt(np.trace(covariance[:3, :3]) + 100.0 * np.trace(covariance[3:6, 3:6])))


def displacement_m(before: NavigationState, after: NavigationState) -> float:
    turn = float(np.linalg.norm(after.R_map_imu - before.R_map_imu)) / np.sqrt(2.0)
    return float(np.linalg.norm(after.vector[P] - before.vector[P]) + 10.0 * turn)
