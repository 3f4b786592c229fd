"""The iterated update in one compiled loop: search planes, weigh residuals, step, until it settles."""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray
from companion.perception.odometry.kernels import rotate_by
from companion.perception.odometry.matching_kernels import accumulate, find_planes

SMALL_STEP_M = 5e-4
SEARCH_AGAIN_CELLS = 0.1
"""Of a fine cell: planes found farther away than this are searched anew."""
LEVER_M = 10.0
"""Distance of a typical point, to speak of rotations in metres."""
COARSE_ITERATIONS = 3
WORST_NORMALISED_RMS = 2.5

# Order of the numbers in the tuning array.
THICKNESS_M = 0
RANGE_VARIANCE = 1
ANGLE_VARIANCE = 2
MAP_VARIANCE = 3
LEAST_SHARE = 4
MIN_POINTS = 5
MAX_ITERATIONS = 6
CONSISTENT_SHARE = 7
N_TUNING = 8

# Order of the numbers in the summary array.
FOUND = 0
MATCHED = 1
ITERATIONS = 2
SEARCHES = 3
SQUARES = 4
WEIGHT = 5
LEVER = 6
NORMALISED_RMS = 7
ACCEPTED = 8
N_SUMMARY = 9


@inlined
def move(predicted: FloatArray, error: FloatArray, state: FloatArray) -> None:
    """Write a state (24,) moved by an error (18,) into another; gravity keeps its length."""
    for i in range(24):
        state[i] = predicted[i]
    for i in range(3):
        state[i] += error[i]
    rotate_by(state[3:12], error[3], error[4], error[5])
    for i in range(12):
        state[12 + i] += error[6 + i]
    before = np.sqrt(predicted[21] ** 2 + predicted[22] ** 2 + predicted[23] ** 2)
    after = np.sqrt(state[21] ** 2 + state[22] ** 2 + state[23] ** 2)
    for i in range(21, 24):
        state[i] *= before / after


@inlined
def displacement(before: FloatArray, after: FloatArray) -> float:
    """Return how far a typical point may have moved between two states (24,), metres."""
    shift, turn = 0.0, 0.0
    for i in range(3):
        shift += (after[i] - before[i]) ** 2
    for i in range(3, 12):
        turn += (after[i] - before[i]) ** 2
    moved: float = np.sqrt(shift) + LEVER_M * np.sqrt(0.5 * turn)
    return moved


@inlined
def keep_observed(
    information: FloatArray,
    gradient: FloatArray,
    lever_m: float,
    weight: float,
    least_share: float,
    shares: FloatArray,
    directions: FloatArray,
) -> None:
    """Remove from the normal equations, in place, the directions that are not observed.

    In a corridor or over an empty field some directions receive only the noise of the normals; taking
    that for a measurement corrupts the state. Source: J. Zhang, M. Kaess, S. Singh, "On degeneracy of
    optimization-based state estimation problems", 2016 (solution remapping), applied to the
    measurement instead of the solution so that the IMU still decides those directions.

    Args:
        information: (6, 6) H' W H for position and rotation.
        gradient: (6,) -H' W r.
        lever_m: root mean square lever arm; it makes rotations comparable with translations.
        weight: sum of the weights.
        least_share: smallest share of the weight that counts as observation.
        shares: (6,) receives the eigenvalues of the scaled information over the weight, ascending.
        directions: (6, 6) receives their directions as columns, rotations scaled by `lever_m`.
    """
    scale = np.ones(6)
    scale[3:] = 1.0 / lever_m
    scaled = np.empty((6, 6))
    for r in range(6):
        for c in range(6):
            scaled[r, c] = information[r, c] * scale[r] * scale[c]
    values, vectors = np.linalg.eigh(scaled)
    weak = 0
    for k in range(6):
        shares[k] = max(values[k], 0.0) / max(weight, 1e-9)
        weak += shares[k] < least_share
        for r in range(6):
            directions[r, k] = vectors[r, k]
    if weak == 0:
        return
    kept = np.zeros(6)
    for r in range(6):
        gradient[r] *= scale[r]
    for k in range(weak, 6):
        along = 0.0
        for r in range(6):
            along += directions[r, k] * gradient[r]
        for r in range(6):
            kept[r] += along * directions[r, k]
    for r in range(6):
        gradient[r] = kept[r] / scale[r]
        for c in range(6):
            total = 0.0
            for k in range(weak, 6):
                total += directions[r, k] * values[k] * directions[c, k]
            information[r, c] = total / (scale[r] * scale[c])


@inlined
def solve_pose(information: FloatArray, pose_prior: FloatArray, right: FloatArray) -> FloatArray:
    """Return (I + A P)^-1 right, for A and P (6, 6) and right (6, k)."""
    system = np.eye(6)
    for r in range(6):
        for c in range(6):
            for k in range(6):
                system[r, c] += information[r, k] * pose_prior[k, c]
    return np.linalg.solve(system, right)  # type: ignore[return-value]


@compiled(
    "void(float64[:,::1], int64[::1], float64[::1], float64[:,::1], float64, float64[:,::1],"
    " int64[::1], int32[::1], int64[::1], float32[:,:,::1], float64,"
    " int64[::1], int32[::1], int64[::1], float32[:,:,::1], float64, float64[::1],"
    " float64[:,::1], float64[::1], float64[::1], float64[:,::1], float64[::1], float64[:,::1],"
    " float64[::1], float64[:,::1])"
)
def register(
    points_imu: FloatArray,
    chosen: NDArray[np.int64],
    predicted: FloatArray,
    covariance: FloatArray,
    lag_s: float,
    unseen: FloatArray,
    fine_keys: NDArray[np.int64],
    fine_blocks: NDArray[np.int32],
    fine_born: NDArray[np.int64],
    fine_cells: NDArray[np.float32],
    fine_cell_m: float,
    coarse_keys: NDArray[np.int64],
    coarse_blocks: NDArray[np.int32],
    coarse_born: NDArray[np.int64],
    coarse_cells: NDArray[np.float32],
    coarse_cell_m: float,
    tuning: FloatArray,
    planes: FloatArray,
    seen: FloatArray,
    state: FloatArray,
    posterior: FloatArray,
    shares: FloatArray,
    directions: FloatArray,
    summary: FloatArray,
    gain: FloatArray,
) -> None:
    """Find the state that explains both a prediction and a scan's points.

    With A = H' W H and b = -H' W r at the present iterate, whose error from the prediction is e, the next
    error is P E (I + A E'P E)^-1 (b + A E'e), where E'e is the error of the pose that the scan shows; the
    18 x 18 prior is never inverted. Source: W. Xu et al., "FAST-LIO2", 2022, equation 19, by the matrix
    inversion lemma.

    The scan shows the pose of its mean time, a lag before its end: for de-skewing carries the points on
    to the end with the predicted velocity and rate, errors of which do not displace them where they were
    measured. So E'e is (p - lag v, theta + lag bg), which is what makes velocity observable at once. What
    noise added too late to be seen is no part of P, and added again in the end.

    Args:
        points_imu: (n, 3) de-skewed points, metres.
        chosen: (m,) indices of the points to match.
        predicted: (24,) state at the scan's end.
        covariance: (18, 18) of it.
        lag_s: mean age of the points at the scan's end.
        unseen: (18, 18) part of the covariance that the scan cannot show.
        fine_keys: and the next four: the fine map, see `matching_kernels.find_planes`.
        fine_blocks: see there.
        fine_born: see there.
        fine_cells: see there.
        fine_cell_m: see there.
        coarse_keys: and the next four: the coarse map.
        coarse_blocks: see there.
        coarse_born: see there.
        coarse_cells: see there.
        coarse_cell_m: see there.
        tuning: (8,) in the order of this module's constants.
        planes: (>= m, 8) receives the planes and weights of the last step.
        seen: (24,) receives the prediction with the pose at which the points lie on the map.
        state: (24,) receives the state, the prediction itself if it was not accepted.
        posterior: (18, 18) receives its covariance.
        shares: (6,) receives what share of the scan's weight observes each direction.
        directions: (6, 6) receives these directions as columns.
        summary: (9,) receives counts and statistics in the order of this module's constants.
        gain: (6, 6) receives the covariance of the pose shown, by which a gradient moves it.
    """
    prior = covariance - unseen
    across = np.empty((18, 6))  # P E
    for r in range(18):
        for c in range(3):
            across[r, c] = prior[r, c] - lag_s * prior[r, 6 + c]
            across[r, 3 + c] = prior[r, 3 + c] + lag_s * prior[r, 9 + c]
    pose_prior = np.empty((6, 6))
    for c in range(6):
        for r in range(3):
            pose_prior[r, c] = across[r, c] - lag_s * across[6 + r, c]
            pose_prior[3 + r, c] = across[3 + r, c] + lag_s * across[9 + r, c]
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    statistics = np.zeros(4)
    error, right = np.zeros(18), np.zeros((6, 1))
    shown = np.zeros(18)
    gate = pose_prior.copy()
    searched, previous = np.zeros(24), np.zeros(24)
    state[:] = predicted
    seen[:] = predicted
    posterior[:, :] = covariance
    summary[:] = 0.0
    # A prediction less certain than a fine cell would find the wrong ones of its planes, so coarse
    # ones come first; what they bring near enough is then gated as narrowly as if it had been near.
    shift = max(0.0, prior[0, 0] + prior[1, 1] + prior[2, 2])
    turn = max(0.0, prior[3, 3] + prior[4, 4] + prior[5, 5])
    spread = np.sqrt(shift + LEVER_M * LEVER_M * turn) / fine_cell_m
    fine = spread < 1.0
    search = True
    found, matched, iterations = 0, 0, 0
    while iterations < tuning[MAX_ITERATIONS]:
        if search or displacement(searched, seen) > fine_cell_m * SEARCH_AGAIN_CELLS:
            found = find_planes(
                points_imu,
                chosen,
                seen,
                fine_keys,
                fine_blocks,
                fine_born,
                fine_cells,
                fine_cell_m,
                coarse_keys,
                coarse_blocks,
                coarse_born,
                coarse_cells,
                coarse_cell_m,
                tuning[THICKNESS_M],
                fine,
                planes,
            )
            searched[:] = seen
            search = False
            summary[SEARCHES] += 1.0
        matched = accumulate(
            points_imu,
            chosen,
            planes,
            seen,
            gate,
            tuning[RANGE_VARIANCE],
            tuning[ANGLE_VARIANCE],
            tuning[MAP_VARIANCE],
            information,
            gradient,
            statistics,
        )
        if matched < tuning[MIN_POINTS]:
            break
        lever_m = np.sqrt(max(statistics[2], 1e-9) / max(statistics[1], 1e-9))
        summary[LEVER] = lever_m
        keep_observed(information, gradient, lever_m, statistics[1], tuning[LEAST_SHARE], shares, directions)
        for r in range(6):
            right[r, 0] = gradient[r]
            for c in range(6):
                right[r, 0] += information[r, c] * shown[c]
        pose_step = solve_pose(information, pose_prior, right)
        for r in range(18):
            total = 0.0
            for c in range(6):
                total += across[r, c] * pose_step[c, 0]
            error[r] = total
        for r in range(3):
            shown[r] = error[r] - lag_s * error[6 + r]
            shown[3 + r] = error[3 + r] + lag_s * error[9 + r]
        previous[:] = seen
        move(predicted, shown, seen)
        iterations += 1
        settled = displacement(previous, seen) < SMALL_STEP_M
        if fine and settled:
            break
        if not fine and (settled or iterations >= COARSE_ITERATIONS):
            fine, search = True, True
            gate[:, :] = pose_prior / (spread * spread)
    rms = np.sqrt(statistics[3] / max(matched, 1))
    summary[FOUND], summary[MATCHED], summary[ITERATIONS] = found, matched, iterations
    summary[SQUARES], summary[WEIGHT], summary[NORMALISED_RMS] = statistics[0], statistics[1], rms
    accepted = (
        matched >= tuning[MIN_POINTS]
        and matched >= tuning[CONSISTENT_SHARE] * found
        and rms < WORST_NORMALISED_RMS
    )
    summary[ACCEPTED] = 1.0 if accepted else 0.0
    if not accepted:
        seen[:] = predicted
        return
    move(predicted, error, state)
    taken = solve_pose(information, pose_prior, information)
    half = np.zeros((18, 6))
    for r in range(18):
        for c in range(6):
            for k in range(6):
                half[r, c] += across[r, k] * taken[k, c]
    for r in range(18):
        for c in range(r + 1):
            down, up = 0.0, 0.0
            for k in range(6):
                down += half[r, k] * across[c, k]
                up += half[c, k] * across[r, k]
            posterior[r, c] = 0.5 * (covariance[r, c] - down + covariance[c, r] - up)
            posterior[c, r] = posterior[r, c]
    # (I + P A)^-1 P, which is symmetric.
    gain[:, :] = solve_pose(information, pose_prior, np.eye(6))
    product = np.zeros((6, 6))
    for r in range(6):
        for c in range(6):
            for k in range(6):
                product[r, c] += pose_prior[r, k] * gain[k, c]
    for r in range(6):
        for c in range(6):
            gain[r, c] = 0.5 * (product[r, c] + product[c, r])
