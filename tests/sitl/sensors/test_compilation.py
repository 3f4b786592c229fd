"""Kernels are compiled once: no caller may bring an array layout that would need another version."""

from typing import Any, cast

import numpy as np
import pytest

from companion.geometry.pose import Pose
from sitl.kinematics import BodyTrajectory, Kinematics
from sitl.sensors import imu_kernels, measuring_kernels, scan_kernels
from sitl.sensors.imu import ImuModel, ImuSettings
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.worlds import casting_kernels, clearance_kernels
from sitl.worlds.primitives import Ground, World

KERNELS = [
    casting_kernels.cast_rays,
    measuring_kernels.measure_slots,
    clearance_kernels.measure_clearances,
    clearance_kernels.find_contacts,
    scan_kernels.evaluate_directions,
    imu_kernels.average_inertial,
    imu_kernels.blur_inertial,
    imu_kernels.turn_rotors,
    imu_kernels.shake,
]


def _use_everything_oddly() -> None:
    """Call with integers, lists, read-only and strided arrays."""
    world = World.of([Ground()])
    read_only = np.zeros((4, 6))
    read_only.setflags(write=False)
    world.cast(read_only[:, ::2], [[1, 0, 0]] * 4, 10)
    world.clearance(read_only[:, ::2])
    world.first_contact([0, 0, 1], read_only[:, ::2], 1)
    still = Kinematics(read_only[0, :3], read_only[0, :3], np.array([1, 0, 0, 0]), read_only[0, ::2])
    ImuModel(np.random.default_rng(0), Pose.identity(), ImuSettings()).sample(0, still, 5, still, 1)
    times = np.array([0, 5_000_000])
    times.setflags(write=False)
    trajectory = BodyTrajectory(times, read_only[:2, ::2], np.array([[1, 0, 0, 0]] * 2))
    Mid360Model(np.random.default_rng(0), Pose.identity(), Mid360Settings()).measure(0, 10, trajectory, world)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.__name__)
def test_odd_arguments_compile_no_second_version(kernel: object) -> None:
    _use_everything_oddly()
    assert len(cast(Any, kernel).signatures) == 1
