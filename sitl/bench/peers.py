"""Other odometries from PyPI on the same events: RKO-LIO, KISS-ICP and small_gicp.

All run on one thread, so that processor time compares. Points are handed over as these libraries want
them, in double precision; that conversion is not timed. Poses are of the body at the end of the scan.
"""

from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample, LidarScan
from sitl.bench.contenders import Estimate, Job, Mount, SensorEvent

_WAITING_SAMPLES = 4000
_WAITING_SCANS = 20


class RkoLio:
    """LiDAR and IMU, coupled loosely: point-to-point ICP from an IMU prediction.

    Source: M. Malladi, T. Guadagnino, L. Lobefaro, C. Stachniss, "A Robust Approach for LiDAR-Inertial
    Odometry Without Sensor-Specific Modeling", 2025; the package rko-lio.
    """

    setup = "defaults (1 m voxels, 1 to 100 m, double downsampling), one thread"
    remark = ""

    def __init__(self, mount: Mount) -> None:
        """Configure as the package does by default.

        Raises:
            ImportError: if rko-lio is not installed.
        """
        from rko_lio.config import LIOConfig
        from rko_lio.lio import LIO

        self._lio: Any = LIO(LIOConfig(max_num_threads=1))
        self._T_base_lidar = _matrix(mount.T_body_lidar)
        self._T_base_imu = _matrix(mount.T_body_lidar @ mount.T_lidar_imu)
        self._samples: deque[ImuSample] = deque(maxlen=_WAITING_SAMPLES)
        self._scans: deque[LidarScan] = deque(maxlen=_WAITING_SCANS)

    def jobs(self, event: SensorEvent) -> Iterator[Job]:
        """Yield the samples up to a scan's end and then the scan, once the samples cover it."""
        if isinstance(event, LidarScan):
            self._scans.append(event)
        else:
            self._samples.append(event)
        while (
            self._scans and self._samples and self._samples[-1].t_sensor_ns >= self._scans[0].t_sensor_end_ns
        ):
            scan = self._scans.popleft()
            while self._samples and self._samples[0].t_sensor_ns <= scan.t_sensor_end_ns:
                yield partial(self._add, self._samples.popleft())
            points, times_ns = _points(scan), _times_ns(scan)
            if len(points):
                yield partial(self._register, scan, points, times_ns)

    def _add(self, sample: ImuSample) -> None:
        self._lio.add_imu_measurement(sample.accel_imu, sample.gyro_imu, sample.t_sensor_ns, self._T_base_imu)

    def _register(self, scan: LidarScan, points: FloatArray, times_ns: NDArray[np.int64]) -> Estimate:
        end_ns = scan.t_sensor_end_ns
        self._lio.register_scan(points, times_ns, self._T_base_lidar, scan.t_sensor_start_ns, end_ns)
        return Estimate(end_ns, _pose(self._lio.pose()))


class KissIcp:
    """LiDAR alone: point-to-point ICP from constant velocity, which also de-skews.

    Source: I. Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP", RA-L 8(2), 2023; the package
    kiss-icp.
    """

    setup = "defaults (1 m voxels, up to 100 m, de-skewed), one thread"
    remark = ""

    def __init__(self, mount: Mount) -> None:
        """Configure as the package does by default.

        Raises:
            ImportError: if kiss-icp is not installed.
        """
        from kiss_icp.config import load_config
        from kiss_icp.kiss_icp import KissICP

        config = load_config(None)
        config.registration.max_num_threads = 1
        self._icp: Any = KissICP(config)
        self._T_body_lidar = mount.T_body_lidar

    def jobs(self, event: SensorEvent) -> Iterator[Job]:
        """Yield the registration of each scan."""
        if isinstance(event, LidarScan) and len(event.points_lidar):
            yield partial(self._register, event, _points(event), event.offsets_ns.astype(np.float64))

    def _register(self, scan: LidarScan, points: FloatArray, times: FloatArray) -> Estimate:
        self._icp.register_frame(points, times)
        return Estimate(scan.t_sensor_end_ns, _of_body(_pose(self._icp.last_pose), self._T_body_lidar))


class SmallGicp:
    """LiDAR alone: generalised ICP from constant velocity, scan to a map of Gaussian voxels.

    The library registers clouds and leaves odometry to its user; this is the scan-to-model loop of its
    own Python example with that example's numbers. It does not de-skew, so its points arrive de-skewed
    with the motion between its last two scans, which is not timed.

    Source: K. Koide, "small_gicp: Efficient and parallel algorithms for point cloud registration",
    JOSS 9(100), 2024; the package small_gicp.
    """

    setup = "VGICP of its example (0.25 m grid, 1 m voxels), de-skewed by constant velocity, one thread"
    remark = ""

    def __init__(self, mount: Mount) -> None:
        """Start with an empty map.

        Raises:
            ImportError: if small_gicp is not installed.
        """
        import small_gicp

        self._library: Any = small_gicp
        self._map: Any = small_gicp.GaussianVoxelMap(1.0)
        self._T_map_lidar = np.eye(4)
        self._T_last_current = np.eye(4)
        self._T_body_lidar = mount.T_body_lidar

    def jobs(self, event: SensorEvent) -> Iterator[Job]:
        """Yield the registration of each scan."""
        if isinstance(event, LidarScan) and len(event.points_lidar):
            yield partial(self._register, event, deskewed(event, _pose(self._T_last_current)))

    def _register(self, scan: LidarScan, points: FloatArray) -> Estimate:
        cloud, _ = self._library.preprocess_points(points, 0.25, num_threads=1)
        if self._map.size():
            guess = self._T_map_lidar @ self._T_last_current
            found = self._library.align(self._map, cloud, guess, num_threads=1).T_target_source
            self._T_last_current = np.linalg.inv(self._T_map_lidar) @ found
            self._T_map_lidar = found
        self._map.insert(cloud, self._T_map_lidar)
        return Estimate(scan.t_sensor_end_ns, _of_body(_pose(self._T_map_lidar), self._T_body_lidar))


def deskewed(scan: LidarScan, T_last_current: Pose) -> FloatArray:
    """Return a scan's points (n, 3) in the frame of its end, had it moved on as from the scan before.

    Args:
        scan: as it came.
        T_last_current: motion during one scan.
    """
    period_ns = scan.t_sensor_end_ns - scan.t_sensor_start_ns
    before_end = scan.offsets_ns[:, None] / period_ns - 1.0
    turn = rotation.log(T_last_current.q)
    step = rotation.rotate(rotation.conjugate(T_last_current.q), T_last_current.p)
    return np.ascontiguousarray(
        rotation.rotate(rotation.exp(before_end * turn), _points(scan)) + before_end * step
    )


def _points(scan: LidarScan) -> FloatArray:
    return scan.points_lidar.astype(np.float64)


def _times_ns(scan: LidarScan) -> NDArray[np.int64]:
    return np.int64(scan.t_sensor_start_ns) + scan.offsets_ns.astype(np.int64)


def _matrix(pose: Pose) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.to_matrix(pose.q), pose.p
    return matrix


def _pose(matrix: FloatArray) -> Pose:
    return Pose.of(matrix[:3, 3], rotation.from_matrix(matrix[:3, :3]))


def _of_body(T_map_lidar: Pose, T_body_lidar: Pose) -> Pose:
    """Return the body's pose in a map that begins with the body, from the LiDAR's in its own."""
    return T_body_lidar @ T_map_lidar @ T_body_lidar.inverse()
