"""Moving the state forward through inertial samples."""

import numpy as np

from companion.messages import FloatArray
from companion.perception.odometry import kernels
from companion.perception.odometry.inertial_history import CAPACITY, InertialHistory, InertialStretch
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState

_GAP_NS = 25_000_000  # five missing samples at 200 Hz
_LEAST_INTERVALS = 8  # fewer do not tell vibration from motion


class Propagation:
    """Integrates inertial samples; keeps the way it went, for de-skewing, and how much it shook."""

    def __init__(self, settings: OdometrySettings) -> None:
        """Take all memory at once."""
        self._settings = settings
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
        stretch = history.between(state.t_ns, end_ns, origin_ns)
        if len(stretch.inertial) >= _LEAST_INTERVALS:
            self._shaking = vibration_densities(stretch)
        kernels.propagate(
            state.vector,
            state.covariance,
            stretch.t_s,
            stretch.inertial,
            process_noise(stretch, self._shaking, self._settings),
            self.segments,
        )
        self.count = len(stretch.t_s)
        state.t_ns = end_ns


def vibration_densities(stretch: InertialStretch) -> FloatArray:
    """Return the squared densities (2,) of rate and specific force that successive samples show.

    Half the mean square of the differences is the variance of what changes from sample to sample; the
    slow motion of the vehicle hardly enters.
    """
    differences = np.diff(stretch.inertial, axis=0)
    variances = 0.5 * np.einsum("ij,ij->j", differences, differences) / len(differences)
    mean_dt = float(stretch.t_s[-1] - stretch.t_s[0]) / len(stretch.inertial)
    return np.array([variances[:3].mean(), variances[3:].mean()]) * mean_dt


def process_noise(stretch: InertialStretch, shaking: FloatArray, settings: OdometrySettings) -> FloatArray:
    """Return the squared noise densities (n - 1, 4) of every interval, as `kernels.propagate` wants them.

    White noise is what the settings say or what vibration shows, whichever is more. Where samples are
    missing or saturated, motion may have gone unseen.

    Args:
        stretch: the intervals.
        shaking: (2,) as from `vibration_densities`.
        settings: see `OdometrySettings`.
    """
    dt = np.diff(stretch.t_s)
    noise = np.empty((len(dt), 4))
    noise[:] = (
        max(settings.gyro_noise**2, float(shaking[0])),
        max(settings.accel_noise**2, float(shaking[1])),
        settings.gyro_bias_walk**2,
        settings.accel_bias_walk**2,
    )
    missing = dt > _GAP_NS * 1e-9
    noise[missing, 0] += settings.gap_rate_sigma**2 * dt[missing]
    noise[missing, 1] += settings.gap_accel_sigma**2 * dt[missing]
    noise[stretch.suspect, 0] += settings.saturated_rate_sigma**2 * dt[stretch.suspect]
    noise[stretch.suspect, 1] += settings.saturated_accel_sigma**2 * dt[stretch.suspect]
    return noise
