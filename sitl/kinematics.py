"""Motion of one simulated body, as its sensors feel it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """State of motion of one body at one instant.

    Attributes:
        p_world: (3,) position of the body's origin, m.
        v_world: (3,) its velocity, m/s.
        q_world_body: (4,) attitude.
        omega_body: (3,) angular rate, rad/s.
    """

    p_world: FloatArray
    v_world: FloatArray
    q_world_body: FloatArray
    omega_body: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BodyTrajectory:
    """Poses of one body at increasing times of its sensor's clock.

    Attributes:
        t_sensor_ns: (k,) int64, k >= 2.
        p_world: (k, 3) metres.
        q_world_body: (k, 4) unit quaternions.
    """

    t_sensor_ns: NDArray[np.int64]
    p_world: FloatArray
    q_world_body: FloatArray

    def __post_init__(self) -> None:
        """Check shapes and order.

        Raises:
            ValueError: if they do not fit.
        """
        k = len(self.t_sensor_ns)
        if k < 2 or self.p_world.shape != (k, 3) or self.q_world_body.shape != (k, 4):
            raise ValueError(
                f"a trajectory needs k >= 2 times, (k, 3) positions and (k, 4) attitudes, got {k}, "
                f"{self.p_world.shape}, {self.q_world_body.shape}"
            )
        times = self.t_sensor_ns
        # Two poses, one simulation step, are by far the most frequent.
        if times[1] <= times[0] or (k > 2 and (times[1:] <= times[:-1]).any()):
            raise ValueError("times of a trajectory must increase")

    @classmethod
    def between(cls, t_start_ns: int, start: Kinematics, t_end_ns: int, end: Kinematics) -> "BodyTrajectory":
        """Return the trajectory of one simulation step."""
        p_world, q_world_body = np.empty((2, 3)), np.empty((2, 4))
        p_world[0], p_world[1] = start.p_world, end.p_world
        q_world_body[0], q_world_body[1] = start.q_world_body, end.q_world_body
        return cls(np.array([t_start_ns, t_end_ns], np.int64), p_world, q_world_body)
