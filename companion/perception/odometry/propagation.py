"""Moving the state forward through inertial samples."""

import numpy as np

from companion.messages import FloatArray
from companion.perception.odometry import kernels
from companion.perception.odometry.inertial_history import CAPACITY, InertialHistory
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState

_GAP_S = 0.025  # five missing samples at 200 Hz


class Propagation:
    """Integrates inertial samples; keeps the way it went, for de-skewing, and how much it shook."""

    def __init__(self, settings: OdometrySettings) -> None:
        """Take all memory at once."""
        self._noise = np.array(
            [
                settings.gyro_noise**2,
                settings.accel_noise**2,
                settings.gyro_bias_walk**2,
                settings.accel_bias_walk**2,
                settings.gap_rate_sigma**2,
                settings.gap_accel_sigma**2,
                settings.saturated_rate_sigma**2,
                settings.saturated_accel_sigma**2,
                _GAP_S,
            ]
        )
        self._shaking = np.zeros(2)
        self.segments = np.zeros((CAPACITY + 2, kernels.SEGMENT_WIDTH))
        self.count = 0

    @property
    def end_rate(self) -> FloatArray:
        """Rate (3,) of the IMU at the end of the newest way, free of bias, rad/s."""
        return self.segments[max(self.count - 1, 0), 19:22].copy()

    def advance(self, state: NavigationState, history: InertialHistory, end_ns: int, origin_ns: int) -> None:
        """Propagate a state in place to `end_ns`.

        Args:
            state: moved and re-stamped.
            history: covers the way.
            end_ns: sensor time to reach; nothing happens unless it is later than the state.
            origin_ns: zero of the times in `segments`.
        """
        if end_ns <= state.t_ns:
            return
        t_ns, inertial, suspect = history.samples
        self.count = kernels.integrate(
            state.vector,
            state.covariance,
            t_ns,
            inertial,
            suspect,
            state.t_ns,
            end_ns,
            origin_ns,
            self._noise,
            self._shaking,
            self.segments,
        )
        state.t_ns = end_ns
