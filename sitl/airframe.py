"""One quadrotor in a world: its motion, the wind on it, and what it touches."""

import math

import numpy as np
from numpy.random import Generator

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from sitl.autopilot import AutopilotOutput
from sitl.dynamics import STEP_S, QuadrotorCommand, QuadrotorSettings, QuadrotorState, at_rest, step
from sitl.kinematics import Kinematics
from sitl.vehicle_truth import VehicleTruth
from sitl.wind import Wind, WindSettings
from sitl.worlds.primitives import World


class Airframe:
    """True motion of one vehicle, in steps of 5 ms.

    Attributes:
        kinematics: present motion.
        collisions: contacts with obstacles so far.
    """

    def __init__(
        self,
        T_world_start: Pose,
        world: World,
        *,
        quadrotor: QuadrotorSettings,
        wind: WindSettings,
        radius_m: float,
        rng: Generator,
    ) -> None:
        """Stand at the start with stopped motors; nearer than `radius_m` to an obstacle is a collision."""
        self._settings = quadrotor
        self._wind = Wind(rng, 1, wind)
        self._obstacles = world.obstacles()
        self._radius_m = radius_m
        yaw = np.array([float(rotation.yaw_of(T_world_start.q))])
        self._state: QuadrotorState = at_rest(T_world_start.p[None, :], yaw, settings=quadrotor)
        self.kinematics: Kinematics = self._state.kinematics(0)
        self._touching = False
        self._room_m = 0.0
        self.collisions = 0

    @property
    def thrust(self) -> float:
        """Thrust by mass, m/s^2; 0 with stopped motors."""
        return float(self._state.thrust[0])

    def truth(self, t_ns: int) -> VehicleTruth:
        """Return the present true motion stamped with `t_ns`."""
        motion = self.kinematics
        return VehicleTruth(
            t_ns=t_ns,
            p_world=motion.p_world,
            v_world=motion.v_world,
            accel_world=self._state.accel_world[0],
            q_world_body=motion.q_world_body,
            omega_body=motion.omega_body,
            on_ground=bool(self._state.on_ground[0]),
        )

    def step(self, command: AutopilotOutput) -> None:
        """Move on by 5 ms under the autopilot's command."""
        before: FloatArray = self._state.p_world
        self._state = step(
            self._state,
            QuadrotorCommand(
                v_world=command.v_command_world[None, :],
                yaw_rate=np.array([command.yaw_rate]),
                armed=np.array([command.armed]),
            ),
            command.v_estimated_world[None, :],
            self._wind.step(STEP_S),
            settings=self._settings,
        )
        self.kinematics = self._state.kinematics(0)
        touching = self._touches(before, self._state.p_world)
        self.collisions += touching and not self._touching
        self._touching = touching

    def _touches(self, start_world: FloatArray, end_world: FloatArray) -> bool:
        if len(self._obstacles) == 0:
            return False
        # Nothing can be touched before the way to the nearest surface, as last measured, has been flown.
        self._room_m -= math.dist(start_world[0].tolist(), end_world[0].tolist())
        if self._room_m > 0.0:
            return False
        self._room_m = float(self._obstacles.clearance(end_world)[0]) - self._radius_m
        contact = self._obstacles.first_contact(start_world, end_world, self._radius_m)
        return bool(np.isfinite(contact[0]))
