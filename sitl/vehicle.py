"""One simulated UAV: airframe, autopilot, LiDAR and IMU on one clock, as bytes."""

from dataclasses import dataclass

from companion.logs.records import StampedPose
from sitl.airframe import Airframe
from sitl.autopilot import Autopilot, AutopilotSettings
from sitl.autopilot_parameters import GNSS_DENIED, Parameters
from sitl.dynamics import STEP_NS
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.mavlink_emulator import MavlinkEmulator
from sitl.operator import Operator, OperatorSettings
from sitl.operator_script import takeoff_and_authorise
from sitl.referee import Sighting
from sitl.scenario import Stage
from sitl.sensor_rig import SensorRig
from sitl.sensors.imu import ImuModel, ImuSettings
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.slots import InertialSlot, PointSlots


def build_lidar(stage: Stage) -> Mid360Model:
    """Return the vehicle's LiDAR at power-on."""
    return Mid360Model(stage.generator("lidar"), stage.profile.vehicle.T_body_lidar, Mid360Settings())


def build_sensors(stage: Stage) -> SensorRig:
    """Return the vehicle's LiDAR and IMU at power-on."""
    T_body_lidar = stage.profile.vehicle.T_body_lidar
    return SensorRig(
        build_lidar(stage),
        ImuModel(stage.generator("imu"), T_body_lidar, ImuSettings()),
        stage.world,
    )


def build_livox(stage: Stage, boot_ns: int) -> LivoxEmulator:
    """Return the LiDAR's side of its protocol, switched on at host time `boot_ns`."""
    return LivoxEmulator(LivoxEmulatorSettings(lidar_ip=stage.profile.lidar.lidar_ip), boot_ns)


def operator_settings(stage: Stage) -> OperatorSettings:
    """Return whom the operator attends to."""
    autopilot = stage.profile.autopilot
    return OperatorSettings(
        vehicle_system_id=autopilot.system_id, companion_component_id=autopilot.component_id
    )


def build_operator(stage: Stage) -> Operator:
    """Return the person who flies the scenario's script against this vehicle."""
    wishes = stage.scenario.operator
    script = takeoff_and_authorise(wishes.takeoff_height_m, wishes.authorise_after_s, wishes.takeover_after_s)
    return Operator(script, operator_settings(stage))


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What the sensor measured in one step."""

    slots: PointSlots
    inertial: InertialSlot


class SimulatedVehicle:
    """Airframe under the emulated PX4, with the sensor on it, in steps of 5 ms."""

    def __init__(self, stage: Stage, boot_ns: int) -> None:
        """Switch everything on at host time `boot_ns`, standing at the start."""
        scenario = stage.scenario
        self._t_ns = boot_ns
        self.airframe = Airframe(
            stage.T_world_start,
            stage.world,
            quadrotor=scenario.quadrotor,
            wind=scenario.wind,
            radius_m=scenario.vehicle_radius_m,
            rng=stage.generator("wind"),
        )
        parameters = Parameters(
            {
                **GNSS_DENIED,
                "MAV_SYS_ID": stage.profile.autopilot.system_id,
                "MIS_TAKEOFF_ALT": scenario.operator.takeoff_height_m,
            }
        )
        self.autopilot = Autopilot(AutopilotSettings(), parameters, stage.generator("autopilot"))
        self.mavlink = MavlinkEmulator(self.autopilot, boot_ns=boot_ns)
        self._sensors = build_sensors(stage)
        self._before = self.airframe.kinematics

    @property
    def t_ns(self) -> int:
        """Present time on the host's clock."""
        return self._t_ns

    def step(self) -> Measured:
        """Move on by 5 ms; return what the sensor measured."""
        self.move()
        return self.measure()

    def move(self) -> None:
        """Move on by 5 ms; `measure` has to follow before the next step."""
        command = self.autopilot.step(self._t_ns, self.airframe.truth(self._t_ns))
        self._before = self.airframe.kinematics
        self.airframe.step(command)
        self._t_ns += STEP_NS

    def measure(self, slots: PointSlots | None = None) -> Measured:
        """Return what the sensor measured during the step just made.

        Args:
            slots: what the LiDAR measured, if somebody else simulates it.
        """
        start, end, thrust = self._before, self.airframe.kinematics, self.airframe.thrust
        if slots is not None:
            return Measured(slots, self._sensors.feel(start, end, STEP_NS, thrust))
        return Measured(*self._sensors.step(start, end, STEP_NS, thrust))

    def true_pose(self) -> StampedPose:
        """Return the body's true pose in the world, for the log."""
        motion = self.airframe.kinematics
        return StampedPose(self._t_ns, "world", motion.p_world, motion.q_world_body)

    def sighting(self) -> Sighting:
        """Return what can be seen of the vehicle from outside."""
        return Sighting(
            t_ns=self._t_ns,
            p_world=self.airframe.kinematics.p_world,
            landed=self.autopilot.landed,
            armed=self.autopilot.armed,
            collisions=self.airframe.collisions,
        )
