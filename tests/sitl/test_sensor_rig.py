"""The sensor measures step by step and leaves out no slot, whatever the length of the steps."""

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from sitl.dynamics import GRAVITY, STEP_NS
from sitl.kinematics import Kinematics
from sitl.sensor_rig import SensorRig
from sitl.sensors.imu import ImuModel, ImuSettings
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.slots import SLOT_PERIOD_NS
from sitl.worlds.primitives import Ground, Sphere, World

MOUNT = Pose.of([0.0, 0.0, 0.08], rotation.IDENTITY)
AROUND = World.of([Ground(), Sphere(centre_world_m=(0.0, 0.0, 1.5), radius_m=6.0)])


def rig(world: World = AROUND) -> SensorRig:
    return SensorRig(
        Mid360Model(np.random.default_rng(1), MOUNT, Mid360Settings.ideal()),
        ImuModel(np.random.default_rng(2), MOUNT, ImuSettings.ideal()),
        world,
    )


def moving(x: float, speed: float = 0.0) -> Kinematics:
    return Kinematics(np.array([x, 0.0, 1.5]), np.array([speed, 0.0, 0.0]), rotation.IDENTITY, np.zeros(3))


def test_steps_of_5_ms_measure_a_thousand_slots_each_without_a_gap() -> None:
    sensors, still = rig(), moving(0.0)
    next_slot = 0
    for index in range(300):
        slots, inertial = sensors.step(still, still, STEP_NS, 0.0)
        assert slots.first_slot == next_slot == index * 1000
        assert len(slots.points_lidar) == len(slots.reflectivity) == len(slots.tags) == 1000
        assert inertial.t_sensor_ns == (index + 1) * STEP_NS
        next_slot += len(slots.points_lidar)


@pytest.mark.parametrize("step_ns", [20_000, 60_000, 3_340_000])
def test_steps_of_any_number_of_firings_lose_and_repeat_no_slot(step_ns: int) -> None:
    sensors, still = rig(), moving(0.0)
    fired: list[int] = []
    for index in range(1, 60):
        slots, inertial = sensors.step(still, still, step_ns, 0.0)
        fired.extend(range(slots.first_slot, slots.first_slot + len(slots.points_lidar)))
        assert inertial.t_sensor_ns == index * step_ns
        assert len(fired) * SLOT_PERIOD_NS == index * step_ns
    assert fired == list(range(len(fired)))


def test_a_step_that_cuts_a_firing_in_two_is_refused() -> None:
    sensors, still = rig(), moving(0.0)
    sensors.step(still, still, 25_000, 0.0)
    with pytest.raises(ValueError, match="outside the trajectory"):
        sensors.step(still, still, 25_000, 0.0)


def test_two_short_steps_measure_what_one_long_step_does() -> None:
    still = moving(0.0)
    whole, _ = rig().step(still, still, 2 * STEP_NS, 0.0)
    halves = rig()
    parts: list[FloatArray] = [halves.step(still, still, STEP_NS, 0.0)[0].points_lidar for _ in range(2)]
    np.testing.assert_allclose(np.concatenate(parts), whole.points_lidar, atol=1e-12)


def test_points_lie_on_the_surfaces_around_the_moving_body() -> None:
    sensors = rig()
    speed = 2.0
    for index in range(20):
        x = speed * index * STEP_NS * 1e-9
        x_next = speed * (index + 1) * STEP_NS * 1e-9
        slots, _ = sensors.step(moving(x, speed), moving(x_next, speed), STEP_NS, 0.0)
        returned = slots.points_lidar[np.any(slots.points_lidar != 0.0, axis=1)]
        assert len(returned) > 100
        middle_world = np.array([0.5 * (x + x_next), 0.0, 1.5]) + MOUNT.p
        # A body that moves 1 cm in a step leaves points at most half of that beside their surface.
        assert np.abs(AROUND.clearance(returned + middle_world)).max() < 0.006


def test_the_inertial_sample_holds_the_acceleration_of_its_step() -> None:
    sensors = rig()
    at_rest = sensors.step(moving(0.0), moving(0.0), STEP_NS, 0.0)[1]
    np.testing.assert_allclose(at_rest.accel_imu, [0.0, 0.0, GRAVITY], atol=1e-9)
    pushed = sensors.step(moving(0.0), moving(0.0, 0.01), STEP_NS, 0.0)[1]
    np.testing.assert_allclose(pushed.accel_imu, [2.0, 0.0, GRAVITY], atol=1e-9)
    np.testing.assert_allclose(pushed.gyro_imu, 0.0, atol=1e-12)


def test_the_chip_sits_beside_the_point_frames_origin() -> None:
    np.testing.assert_allclose(rig().T_body_imu.p, [0.011, 0.02329, 0.08 - 0.04412])
