"""Moving the state forward through inertial samples."""

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray
from companion.perception.odometry import kernels
from companion.perception.odometry.inertial_history import CAPACITY, InertialHistory
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import ERROR_SIZE, STATE_SIZE, THETA, NavigationState, V
from companion.perception.odometry.update import AT_ONCE, View

_SCAN_S = 0.1  # an unknown scale adds a steady rate, which scans correct as often as this
_UNSEEN_PART = 3
_LEARNING = np.array([0.2, 0.02])  # weight of every scan: tones come in a second and go for tens
_LEAST_EXCESS, _MOST_EXCESS = 0.4, 100.0
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
                settings.gyro_scale_sigma**2 * _SCAN_S,
            ]
        )
        self._shaking = np.zeros(2)
        self._ratios = np.ones((2, 2))  # over seconds and over tens of seconds, of rate and force
        self.excess = np.ones(2)
        self.segments = np.zeros((CAPACITY + 2, kernels.SEGMENT_WIDTH))
        self.count = 0
        self._late_segments = np.zeros_like(self.segments)

    @property
    def end_rate(self) -> FloatArray:
        """Rate (3,) of the IMU at the end of the newest way, free of bias, rad/s."""
        return self.segments[max(self.count - 1, 0), 19:22].copy()

    def learn(self, predicted: NavigationState, corrected: NavigationState) -> None:
        """Notice when scans correct attitude or velocity by more, or less, than the noise explains.

        A rotor's tone that sampling folds to a few hertz looks like motion from sample to sample, and
        integrates to far more than white noise of its size would. Squared corrections then exceed the
        variance that they take away, which in a consistent filter they equal on average; the noise grows
        by their ratio. Source: R. Mehra, "Approaches to adaptive filtering", IEEE TAC 17(5), 1972
        (covariance matching).

        Args:
            predicted: the state before an accepted correction.
            corrected: the state after it.
        """
        turn = 0.5 * predicted.R_map_imu.T @ corrected.R_map_imu
        steps = (
            np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]),
            corrected.v_map - predicted.v_map,
        )
        for half, (step, part) in enumerate(zip(steps, (THETA, V), strict=True)):
            taken = np.trace(predicted.covariance[part, part] - corrected.covariance[part, part])
            ratio = min(_MOST_EXCESS, float(step @ step) / max(float(taken), 1e-12))
            self._ratios[:, half] += _LEARNING * (ratio - self._ratios[:, half])
        np.clip(self._ratios.max(axis=0), _LEAST_EXCESS, _MOST_EXCESS, out=self.excess)

    def view(
        self,
        state: NavigationState,
        history: InertialHistory,
        scan_ns: int,
        offsets_ns: NDArray[np.int32],
    ) -> View:
        """Return what a scan shows of the state at its end.

        A scan is taken all along its way and shows the mean of the poses there. Of noise that makes the
        pose walk at random, the last pose differs from that mean by a third of the variance that the whole
        way adds: by as much as the last third of it adds.

        Args:
            state: as `advance` left it at the scan's end, with the scan's way in `segments`.
            history: covers the way.
            scan_ns: duration of the scan.
            offsets_ns: (n,) times of its points after its start.
        """
        lag_ns = scan_ns - float(offsets_ns.mean()) if len(offsets_ns) else 0.0
        span_ns = min(scan_ns, round(self.segments[self.count - 1, 0] * 1e9)) // _UNSEEN_PART
        if self.count < 2 or span_ns <= 0:
            return AT_ONCE
        times = self.segments[: self.count, 0]
        first = int(np.searchsorted(times, times[-1] - span_ns * 1e-9))
        late, covariance = np.empty(STATE_SIZE), np.zeros((ERROR_SIZE, ERROR_SIZE))
        late[:15] = self.segments[first, 1:16]
        late[15:] = state.vector[15:]
        t_ns, inertial, suspect = history.samples
        kernels.integrate(
            late,
            covariance,
            t_ns,
            inertial,
            suspect,
            state.t_ns - span_ns,
            state.t_ns,
            state.t_ns,
            self._noise,
            self._shaking.copy(),
            self.excess,
            self._late_segments,
        )
        return View(lag_ns * 1e-9, covariance)

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
            self.excess,
            self.segments,
        )
        state.t_ns = end_ns
