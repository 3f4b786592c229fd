"""LiDAR and IMU of one vehicle, measured step by step on the sensor's clock.

This is all of the simulated sensor that a flight needs, whoever moves the vehicle: our own dynamics, or a
simulator that publishes where its vehicle is.
"""

from companion.geometry.pose import Pose
from sitl.kinematics import BodyTrajectory, Kinematics
from sitl.sensors.imu import ImuModel
from sitl.sensors.mid360 import Mid360Model
from sitl.slots import SLOT_PERIOD_NS, InertialSlot, PointSlots
from sitl.worlds.primitives import World


class Scanner:
    """One LiDAR, measured step by step on its own clock, which starts at zero."""

    def __init__(self, lidar: Mid360Model) -> None:
        """Power on."""
        self._lidar = lidar
        self._t_sensor_ns = 0
        self._next_slot = 0

    def step(self, start: Kinematics, end: Kinematics, step_ns: int, world: World) -> PointSlots:
        """Return all slots that fire while the body moves from `start` to `end`.

        Args:
            start: the body's pose at the end of the previous step; rates do not matter.
            end: its pose `step_ns` nanoseconds later.
            step_ns: length of the step, a multiple of the firing period of 20 us.
            world: what the beams can hit; what moves in it stands still meanwhile.

        Raises:
            ValueError: if the step cuts a firing in two.
        """
        t_start_ns, t_end_ns = self._t_sensor_ns, self._t_sensor_ns + step_ns
        # A slot belongs to the step in which it fires; the one that fires at the very end to the next.
        end_slot = -(-t_end_ns // SLOT_PERIOD_NS)
        slots = self._lidar.measure(
            self._next_slot,
            end_slot - self._next_slot,
            BodyTrajectory.between(t_start_ns, start, t_end_ns, end),
            world,
        )
        self._t_sensor_ns, self._next_slot = t_end_ns, end_slot
        return slots


class SensorRig:
    """One sensor, measured step by step on its own clock, which starts at zero."""

    def __init__(self, lidar: Mid360Model, imu: ImuModel, world: World) -> None:
        """Power on in a world."""
        self._scanner = Scanner(lidar)
        self._imu = imu
        self._world = world
        self._t_sensor_ns = 0

    @property
    def T_body_imu(self) -> Pose:
        """Where the inertial chip sits on the body."""
        return self._imu.T_body_imu

    def step(
        self, start: Kinematics, end: Kinematics, step_ns: int, thrust: float
    ) -> tuple[PointSlots, InertialSlot]:
        """Measure while the body moves from `start` to `end`.

        Args:
            start: the body's motion at the end of the previous step.
            end: its motion `step_ns` nanoseconds later.
            step_ns: length of the step, a multiple of the firing period of 20 us.
            thrust: of the motors by vehicle mass, m/s^2; it drives the vibration.

        Returns:
            All slots that fire within the step, and one inertial sample stamped with its end.

        Raises:
            ValueError: if the step cuts a firing in two.
        """
        slots = self._scanner.step(start, end, step_ns, self._world)
        return slots, self.feel(start, end, step_ns, thrust)

    def feel(self, start: Kinematics, end: Kinematics, step_ns: int, thrust: float) -> InertialSlot:
        """Return the inertial sample alone, where somebody else has simulated the beams."""
        t_start_ns, self._t_sensor_ns = self._t_sensor_ns, self._t_sensor_ns + step_ns
        return self._imu.sample(t_start_ns, start, self._t_sensor_ns, end, thrust)
