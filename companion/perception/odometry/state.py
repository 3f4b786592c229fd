"""The filter's state and its error covariance.

The error has 18 dimensions in this order: position in map, rotation in the IMU frame (right
perturbation), velocity in map, gyro bias, accelerometer bias, gravity in map.
"""

from dataclasses import dataclass

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray

STATE_SIZE = 24
ERROR_SIZE = 18
P, THETA, V, GYRO_BIAS, ACCEL_BIAS, GRAVITY = (slice(i, i + 3) for i in range(0, ERROR_SIZE, 3))


@dataclass(slots=True, eq=False)
class NavigationState:
    """Motion of the IMU, its biases and gravity at one sensor time.

    Attributes:
        t_ns: sensor time.
        vector: (24,) p_map, R_map_imu by rows, v_map, gyro bias, accelerometer bias, g_map.
        covariance: (18, 18) of the error.
    """

    t_ns: int
    vector: FloatArray
    covariance: FloatArray

    @property
    def p_map(self) -> FloatArray:
        """Position (3,), a view."""
        return self.vector[0:3]

    @property
    def R_map_imu(self) -> FloatArray:
        """Attitude (3, 3), a view."""
        return self.vector[3:12].reshape(3, 3)

    @property
    def v_map(self) -> FloatArray:
        """Velocity (3,), a view."""
        return self.vector[12:15]

    @property
    def gyro_bias(self) -> FloatArray:
        """Gyro bias (3,), a view."""
        return self.vector[15:18]

    @property
    def accel_bias(self) -> FloatArray:
        """Accelerometer bias (3,), a view."""
        return self.vector[18:21]

    @property
    def g_map(self) -> FloatArray:
        """Gravity (3,), pointing down, a view."""
        return self.vector[21:24]

    def copy(self) -> "NavigationState":
        """Return an independent copy."""
        return NavigationState(self.t_ns, self.vector.copy(), self.covariance.copy())

    def assign(self, other: "NavigationState") -> None:
        """Take over another state's values without allocating."""
        self.t_ns = other.t_ns
        self.vector[:] = other.vector
        self.covariance[:] = other.covariance

    def plus(self, error: FloatArray) -> "NavigationState":
        """Return the state moved by an error (18,); gravity keeps its length."""
        moved = self.copy()
        moved.vector[0:3] += error[P]
        moved.vector[12:24] += error[6:18]
        q = rotation.multiply(rotation.from_matrix(self.R_map_imu), rotation.exp(error[THETA]))
        moved.vector[3:12] = rotation.to_matrix(rotation.normalize(q)).ravel()
        moved.g_map[:] *= np.linalg.norm(self.g_map) / np.linalg.norm(moved.g_map)
        return moved

    def is_finite(self) -> bool:
        """Whether every number of state and covariance is finite."""
        return bool(np.isfinite(self.vector).all() and np.isfinite(self.covariance).all())
