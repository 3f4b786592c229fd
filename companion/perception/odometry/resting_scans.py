"""The first map: scans taken at rest, which must show that it was rest.

An IMU cannot tell rest from steady motion; two scans can.
"""

from collections.abc import Sequence

import numpy as np

from companion.messages import FloatArray, LidarScan
from companion.perception.odometry.preprocessing import Thinning, usable_points
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState
from companion.perception.odometry.update import ScanMatcher
from companion.perception.odometry.voxel_map import VoxelMap

_LEAST_SCANS = 4
_REFERENCE_SCANS = 3


def map_from_rest(
    scans: Sequence[LidarScan],
    state: NavigationState,
    imu_lidar: FloatArray,
    matcher: ScanMatcher,
    fine: VoxelMap,
    coarse: VoxelMap,
    settings: OdometrySettings,
) -> str:
    """Fill two empty maps with scans taken at rest.

    The last scan is first matched against the map of the first few, with a prediction so loose that
    steady motion would show.

    Args:
        scans: in order of time, all within the window that the IMU found at rest.
        state: of the resting sensor.
        imu_lidar: (12,) R_imu_lidar by rows, then its translation.
        matcher: works on the two maps.
        fine: map of fine cells.
        coarse: map of coarse cells.
        settings: see `OdometrySettings`.

    Returns:
        Why these scans do not show rest, or "" with the maps filled.
    """
    if len(scans) < _LEAST_SCANS:
        return f"{len(scans)} scans while resting, {_LEAST_SCANS} needed"
    clouds = []
    for scan in scans:
        points_lidar, _, _ = usable_points(scan, settings)
        clouds.append(points_lidar @ imu_lidar[:9].reshape(3, 3).T + imu_lidar[9:])
    points, needed = int(np.median([len(cloud) for cloud in clouds])), 4 * settings.min_effective_points
    if points < needed:
        return f"no map to start in: {points} points a scan while resting, {needed} needed"
    for index, points_imu in enumerate(clouds):
        if index == _REFERENCE_SCANS:
            chosen = Thinning(settings).choose(clouds[-1])
            correction = matcher.correct(matcher.widened(state), clouds[-1], chosen)
            if not correction.accepted:
                return f"scans do not match: {correction.matched} of {correction.offered} points"
            moved_m = float(np.linalg.norm(correction.state.p_map - state.p_map))
            if moved_m > settings.still_displacement_m:
                return f"not still: scans moved by {moved_m:.2f} m"
        fine.insert(points_imu, state.vector, settings.fine_range_m)
        coarse.insert(points_imu, state.vector, settings.max_range_m)
    return ""
