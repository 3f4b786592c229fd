"""What the simulated vehicle touches, and what counts as a collision."""

from dataclasses import dataclass

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import VehicleMode
from sitl.airframe import Airframe
from sitl.autopilot import AutopilotOutput
from sitl.dynamics import STEP_S, QuadrotorSettings
from sitl.wind import WindSettings
from sitl.worlds.primitives import Box, Cylinder, Ground, World

RADIUS_M = 0.2
STANDING_M = QuadrotorSettings().standing_height_m
PILLAR = Cylinder(start_world_m=(3.0, 0.0, 0.0), end_world_m=(3.0, 0.0, 5.0), radius_m=0.3)
THIN_WALL = Box(centre_world_m=(3.0, 0.0, 2.5), size_m=(0.001, 10.0, 5.0))


@dataclass
class Flight:
    """An airframe flown by bare velocities, seen by a perfect estimator."""

    airframe: Airframe

    def fly(self, v_world: tuple[float, float, float], seconds: float, *, armed: bool = True) -> "Flight":
        for _ in range(round(seconds / STEP_S)):
            self.airframe.step(
                AutopilotOutput(
                    v_command_world=np.array(v_world),
                    v_estimated_world=self.airframe.kinematics.v_world,
                    yaw_rate=0.0,
                    armed=armed,
                    mode=VehicleMode.OFFBOARD,
                    horizontal_controlled=True,
                )
            )
        return self

    @property
    def x(self) -> float:
        return float(self.airframe.kinematics.p_world[0])


def at(p_world: tuple[float, float, float], *bodies: Ground | Cylinder | Box, yaw: float = 0.0) -> Flight:
    return Flight(
        Airframe(
            Pose.of(p_world, rotation.from_yaw(yaw)),
            World.of(bodies),
            quadrotor=QuadrotorSettings(),
            wind=WindSettings(),
            radius_m=RADIUS_M,
            rng=np.random.default_rng(1),
        )
    )


def test_a_contact_is_counted_once_however_long_it_lasts() -> None:
    flight = at((0.0, 0.0, 1.5), Ground(), PILLAR)
    flight.fly((1.0, 0.0, 0.0), 2.0)
    assert flight.airframe.collisions == 0
    flight.fly((1.0, 0.0, 0.0), 1.5)
    assert flight.x > 2.5
    assert flight.airframe.collisions == 1


def test_leaving_and_touching_again_counts_twice() -> None:
    flight = at((2.0, 0.0, 1.5), Ground(), PILLAR)
    flight.fly((0.6, 0.0, 0.0), 2.0)
    assert flight.airframe.collisions == 1
    flight.fly((-1.0, 0.0, 0.0), 3.0)
    assert flight.airframe.collisions == 1
    flight.fly((0.6, 0.0, 0.0), 6.0)
    assert flight.airframe.collisions == 2


def test_standing_and_landing_on_the_ground_is_no_collision() -> None:
    flight = at((0.0, 0.0, STANDING_M), Ground(), PILLAR)
    flight.fly((0.0, 0.0, 0.0), 0.5, armed=False).fly((0.0, 0.0, 1.0), 2.0)
    assert not flight.airframe.truth(0).on_ground
    flight.fly((0.0, 0.0, -1.0), 4.0)
    assert flight.airframe.truth(0).on_ground
    assert flight.airframe.collisions == 0


def test_passing_at_more_than_the_radius_is_no_collision_and_at_less_is_one() -> None:
    wide = at((0.0, 0.3 + RADIUS_M + 0.02, 1.5), Ground(), PILLAR).fly((1.5, 0.0, 0.0), 5.0)
    close = at((0.0, 0.3 + RADIUS_M - 0.02, 1.5), Ground(), PILLAR).fly((1.5, 0.0, 0.0), 5.0)
    assert min(wide.x, close.x) > 4.0
    assert (wide.airframe.collisions, close.airframe.collisions) == (0, 1)


def test_not_even_a_sheet_of_a_millimetre_is_flown_through_unnoticed() -> None:
    flight = at((0.0, 0.0, 1.5), Ground(), THIN_WALL).fly((6.0, 0.0, 0.0), 3.0)
    assert flight.x > 4.0
    assert flight.airframe.collisions == 1


def test_a_world_of_nothing_can_be_flown_through() -> None:
    assert at((0.0, 0.0, 1.5)).fly((1.0, 0.0, 0.0), 1.0).airframe.collisions == 0


@pytest.mark.parametrize("armed", [True, False])
def test_thrust_is_felt_only_with_turning_motors(armed: bool) -> None:
    flight = at((0.0, 0.0, STANDING_M), Ground()).fly((0.0, 0.0, 0.0), 1.0, armed=armed)
    assert (flight.airframe.thrust > 0.1) is armed


def test_the_truth_carries_the_stamp_it_is_asked_for_and_the_present_motion() -> None:
    flight = at((1.0, 2.0, 1.5), Ground(), yaw=0.5).fly((0.5, 0.0, 0.0), 1.0)
    truth, motion = flight.airframe.truth(42), flight.airframe.kinematics
    assert truth.t_ns == 42
    np.testing.assert_array_equal(truth.p_world, motion.p_world)
    np.testing.assert_array_equal(truth.v_world, motion.v_world)
    np.testing.assert_array_equal(truth.q_world_body, motion.q_world_body)
    assert float(rotation.yaw_of(truth.q_world_body)) == pytest.approx(0.5, abs=0.01)
    assert not truth.on_ground
