"""What a system must offer to be compared, and our own odometry in that form."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample, LidarScan, RegisteredScan
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings

SensorEvent = ImuSample | LidarScan


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Where the sensor sits: T_body_lidar, and T_lidar_imu of its inertial chip."""

    T_body_lidar: Pose
    T_lidar_imu: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What a system says about one scan.

    Attributes:
        t_sensor_ns: time of the pose.
        T_map_body: in a map of the system's own.
        v_map: (3,) m/s, None if the system does not tell.
    """

    t_sensor_ns: int
    T_map_body: Pose
    v_map: FloatArray | None = None


Job = Callable[[], Estimate | None]
"""One call into a system, to be timed; it returns an estimate if it registered a scan."""


class Contender(Protocol):
    """One odometry that takes the events of one flight."""

    @property
    def setup(self) -> str:
        """How it is configured, in one sentence."""
        ...

    @property
    def remark(self) -> str:
        """What it complains about now, empty if nothing."""
        ...

    def jobs(self, event: SensorEvent) -> Iterator[Job]:
        """Yield the calls that follow from an event; run each before asking for the next.

        What happens between them (waiting for the other sensor, conversion to the system's types) is not
        the system's work and not timed.
        """
        ...


class CompanionOdometry:
    """Our own odometry, as it flies."""

    def __init__(self, mount: Mount, settings: OdometrySettings | None = None) -> None:
        """Prepare to start at rest; the kernels should be loaded."""
        self.setup = "default settings" if settings is None else "given settings"
        self.remark = "no inertial samples"
        self._lio = LidarInertialOdometry(
            settings or OdometrySettings(), mount.T_body_lidar, mount.T_lidar_imu
        )

    def jobs(self, event: SensorEvent) -> Iterator[Job]:
        """Yield the one call that an event leads to."""
        yield lambda: self._handle(event)

    def _handle(self, event: SensorEvent) -> Estimate | None:
        estimate = None
        for output in self._lio.handle(event):
            if isinstance(output, RegisteredScan):
                found = output.odometry
                pose = Pose(found.p_map, found.q_map_body)
                estimate = Estimate(found.t_sensor_ns, pose, found.v_map)
            else:
                self.remark = output.reason
        return estimate
