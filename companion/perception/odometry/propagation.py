"""Moving the state forward through inertial samples."""

import numpy as np

from companion.messages import FloatArray
from companion.perception.odometry import kernels
from companion.perception.odometry.inertial_history import CAPACITY, InertialHistory, InertialStretch
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState

_GAP_NS = 25_000_000  # five missing samples at 200 Hz


class Propagation:
    """Integrates inertial samples; keeps the way it went, for de-skewing."""

    def __init__(self, settings: OdometrySettings) -> None:
        """Take all memory at once."""
        self._settings = settings
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
        stretch = history.between(state.t_ns, end_ns, origin_ns)
        noise = process_noise(stretch, self._settings)
        kernels.propagate(state.vector, state.covariance, stretch.t_s, stretch.inertial, noise, self.segments)
        self.count = len(stretch.t_s)
        state.t_ns = end_ns


def process_noise(stretch: InertialStretch, settings: OdometrySettings) -> FloatArray:
    """Return the noise densities (n - 1, 4) of every interval between samples.

    White noise is what the settings say or what successive samples show (vibration), whichever is
    more. Where samples are missing or saturated, motion may have gone unseen.
    """
    dt = np.diff(stretch.t_s)
    noise = np.empty((len(dt), 4))
    differences = np.diff(stretch.inertial, axis=0)
    half_square = 0.5 * np.einsum("ij,ij->j", differences, differences) / len(dt)
    mean_dt = float(dt.mean())
    noise[:, 0] = max(settings.gyro_noise**2, float(half_square[:3].mean()) * mean_dt)
    noise[:, 1] = max(settings.accel_noise**2, float(half_square[3:].mean()) * mean_dt)
    noise[:, 2] = settings.gyro_bias_walk**2
    noise[:, 3] = settings.accel_bias_walk**2
    unseen = (dt > _GAP_NS * 1e-9) | stretch.suspect[1:] | stretch.suspect[:-1]
    if unseen.any():
        noise[unseen, 0] += settings.gap_rate_sigma**2 * dt[unseen]
        noise[unseen, 1] += settings.gap_accel_sigma**2 * dt[unseen]
    return noise
