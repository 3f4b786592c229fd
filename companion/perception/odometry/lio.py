"""LiDAR-inertial odometry: where the body is, from nothing but its own sensor.

Source of the method: W. Xu, Y. Cai, D. He, J. Lin, F. Zhang, "FAST-LIO2: Fast Direct LiDAR-Inertial
Odometry", IEEE T-RO 38(4), 2022; the map is this project's own.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import (
    ByteArray,
    FloatArray,
    ImuSample,
    LidarScan,
    Odometry,
    OdometryStatus,
    PointArray,
    RegisteredScan,
    SensorEvent,
)
from companion.perception.odometry import kernels
from companion.perception.odometry.anchor import Anchor
from companion.perception.odometry.body_motion import Mounting, body_odometry, no_odometry
from companion.perception.odometry.health import Concern, Health, HealthMonitor
from companion.perception.odometry.initialisation import StaticInitialiser
from companion.perception.odometry.preprocessing import MOST_POINTS, Thinning, nearest_first, usable_points
from companion.perception.odometry.propagation import Propagation
from companion.perception.odometry.relocalisation import Relocaliser
from companion.perception.odometry.resting_scans import map_from_rest
from companion.perception.odometry.sequencer import Arrival, Sequencer
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState
from companion.perception.odometry.update import AT_ONCE, Correction, ScanMatcher
from companion.perception.odometry.voxel_map import VoxelMap

_WAITING_PERIOD_NS = NANOSECONDS_PER_SECOND // 2


class LidarInertialOdometry:
    """Turns IMU samples and LiDAR scans into odometry of the body and scans in the map.

    It reads no clock and keeps all memory bounded: what it returns follows from the events alone.
    """

    def __init__(self, settings: OdometrySettings, T_body_lidar: Pose, T_lidar_imu: Pose) -> None:
        """Prepare to start at rest.

        Args:
            settings: see `OdometrySettings`.
            T_body_lidar: point frame of the sensor in the body frame.
            T_lidar_imu: the sensor's inertial chip in its point frame.
        """
        self._settings = settings
        self._T_imu_body = (T_body_lidar @ T_lidar_imu).inverse()
        self._mounting = Mounting(self._T_imu_body, settings)
        T_imu_lidar = T_lidar_imu.inverse()
        self._imu_lidar = np.concatenate([rotation.to_matrix(T_imu_lidar.q).ravel(), T_imu_lidar.p])
        self.fine_map = VoxelMap(settings.fine_cell_m, settings.fine_blocks, settings.map_radius_m)
        self.coarse_map = VoxelMap(settings.coarse_cell_m, settings.coarse_blocks, settings.map_radius_m)
        self.sequencer = Sequencer(settings)
        self.anchor = Anchor(settings.residual_correlation)
        self.last_correction: Correction | None = None
        self._initialiser = StaticInitialiser(settings, self._T_imu_body)
        self._propagation = Propagation(settings)
        self._view = AT_ONCE
        self._thinning = Thinning(settings)
        self._matcher = ScanMatcher(settings, self.fine_map, self.coarse_map)
        self._relocaliser = Relocaliser(self._matcher)
        self._points_imu = np.zeros((MOST_POINTS, 3))
        self._scan_state: NavigationState | None = None  # at the end of the newest scan
        self._head: NavigationState | None = None  # the same, at the newest IMU sample
        self._health = HealthMonitor(settings, 0)
        self._reset_counter = 0
        self._refusal = ""  # what the last scans of a resting window were refused for
        self._clock_offset_ns: int | None = None
        self._offset_by_scan = False
        self._output_period_ns = round(NANOSECONDS_PER_SECOND / settings.output_hz)
        self._last_output = (-1, -1)  # sensor time and host time

    @property
    def state(self) -> NavigationState | None:
        """The filter's state at the newest scan's end, None before the start."""
        return self._scan_state

    def handle(self, event: SensorEvent) -> list[Odometry | RegisteredScan]:
        """Take one event and return what follows from it.

        Args:
            event: IMU samples and scans in order of arrival; anything else is ignored.

        Returns:
            Odometry at the output rate, propagated to the newest IMU sample, or with each scan while the
            IMU is silent; one registered scan per scan as soon as IMU samples cover its end. While it is
            not started, odometry with status INITIALISING and the reason, twice a second; with LOST and the
            reason, at the output rate, while it searches its place after an outage.
        """
        outputs: list[Odometry | RegisteredScan] = []
        if isinstance(event, LidarScan):
            outputs += self._handle_scan(event)
        elif isinstance(event, ImuSample):
            outputs += self._handle_sample(event)
        while self._scan_state is not None:
            scan = self.sequencer.covered_scan(self._scan_state.t_ns)
            if scan is None:
                break
            outputs += self._register(scan, self._scan_state)
        return outputs

    def _register(self, scan: LidarScan, state: NavigationState) -> list[Odometry | RegisteredScan]:
        """The whole algorithm: predict, de-skew, match, correct, map, and catch up with the IMU."""
        points_lidar, offsets_ns, reflectivity = usable_points(scan, self._settings)
        self._propagation.advance(state, self.sequencer.history, scan.t_sensor_end_ns, scan.t_sensor_start_ns)
        self._view = self._propagation.view(
            state, self.sequencer.history, scan.t_sensor_end_ns - scan.t_sensor_start_ns, offsets_ns
        )
        if not state.is_finite():
            return [self._give_up(self._health.judge(state))]
        points_imu = self._points_imu[: len(points_lidar)]
        kernels.deskew(
            points_lidar,
            offsets_ns,
            self._propagation.segments,
            self._propagation.count,
            self._imu_lidar,
            points_imu,
        )
        chosen = self._thinning.choose(points_imu)
        correction = self._locate(state, points_imu, chosen)
        self._scan_state = correction.state if correction is not None else state
        self.last_correction = correction or self.last_correction
        health = self._health.judge(self._scan_state)
        if self._health.is_over(self._scan_state) or self._relocaliser.hopeless:
            return [self._give_up(health)]
        outputs: list[Odometry | RegisteredScan] = []
        if correction is not None and correction.accepted:
            if self._health.may_map(correction.state.t_ns):
                self._insert(points_imu, chosen, correction.seen)
            ages_ns = (scan.t_sensor_end_ns - scan.t_sensor_start_ns - offsets_ns).astype(np.int32)
            outputs.append(self._registered(scan, points_imu, reflectivity, ages_ns, correction, health))
        self._head = self._scan_state.copy()
        self._propagation.advance(
            self._head, self.sequencer.history, self.sequencer.history.last_ns, self._scan_state.t_ns
        )
        return outputs

    def _locate(
        self, predicted: NavigationState, points_imu: FloatArray, chosen: NDArray[np.int64]
    ) -> Correction | None:
        """Match a scan; after an outage search the place, with None while it is not found."""
        way = self._propagation.segments[: self._propagation.count]
        if not self._health.must_search(predicted.t_ns):
            correction = self._matcher.correct(predicted, points_imu, chosen, self._view)
            if correction.accepted:
                self._propagation.learn(predicted, correction.state)
                self._inherit(correction, points_imu, chosen)
            if self._health.observe(predicted, correction, way):
                self._reset_counter += 1
            return correction
        found = self._relocaliser.consider(predicted, points_imu, chosen)
        if found is not None:
            self._inherit(found, points_imu, chosen)
            self._relocaliser.forget()
            if self._health.relocated(predicted, found):
                self._reset_counter += 1
        return found

    def _handle_scan(self, scan: LidarScan) -> list[Odometry | RegisteredScan]:
        """Queue a scan; if it finds the IMU silent, it tells the time instead."""
        self._follow_clock(scan)
        self.sequencer.add_scan(scan)
        newest, head = self.sequencer.newest, self._head
        if newest is None or head is None:
            return []
        self._health.observe_scan(scan, newest)
        silent_ns = scan.t_ns - newest.t_ns
        if silent_ns <= seconds_to_ns(self._settings.imu_silent_after_s):
            return []
        predicted = head.copy()
        self._propagation.advance(predicted, self.sequencer.history, head.t_ns + silent_ns, head.t_ns)
        reason = f"IMU silent for {silent_ns / NANOSECONDS_PER_SECOND:.2f} s"
        self._health.alarm(predicted.t_ns, Concern.INERTIAL, reason)
        if silent_ns > seconds_to_ns(self._settings.max_imu_gap_s):
            return [self._give_up(Health(OdometryStatus.LOST, 0, reason), predicted.t_ns)]
        return self._report(predicted, newest)

    def _report(self, state: NavigationState, newest: ImuSample) -> list[Odometry | RegisteredScan]:
        """Return odometry if it is due, or why there is none."""
        if not self._is_due(state.t_ns, self._output_period_ns):
            return []
        health = self._health.judge(state)
        if health.status is not OdometryStatus.LOST:
            return [self._odometry(state, newest.gyro_imu - state.gyro_bias, health)]
        if self._health.is_over(state):
            return [self._give_up(health)]
        if self._relocaliser.reason:
            health = replace(health, reason=f"{health.reason}; {self._relocaliser.reason}")
        return [no_odometry(self._host_time_ns(state.t_ns), state.t_ns, self._reset_counter, health)]

    def _handle_sample(self, sample: ImuSample) -> list[Odometry | RegisteredScan]:
        """Take one IMU sample: start, restart, or propagate and report."""
        arrival = self.sequencer.add_sample(sample)
        if arrival is Arrival.DROPPED:
            return []
        if arrival in (Arrival.BROKEN, Arrival.RELABELLED):
            self._offset_by_scan, self._clock_offset_ns = False, None
            self._last_output = (-1, self._last_output[1])
        self._follow_clock(sample)
        if self._scan_state is None or self._head is None:
            return self._wait_for_rest(sample)
        if arrival is Arrival.BROKEN:
            # Nothing bounds what a vehicle may do in that time, its tilt least of all.
            return [self._give_up(Health(OdometryStatus.LOST, 0, "IMU data interrupted"))]
        if arrival is Arrival.RELABELLED:
            self._relabel(self._scan_state, self._head)
        self._health.observe_sample(sample)
        self._propagation.advance(self._head, self.sequencer.history, sample.t_sensor_ns, sample.t_sensor_ns)
        return self._report(self._head, sample)

    def _relabel(self, *states: NavigationState) -> None:
        """Follow a jump of the sensor's clock: the host's clock says how much time really passed."""
        shift_ns = self.sequencer.relabelled_by_ns
        for state in states:
            state.t_ns += shift_ns
        self._health.relabel(shift_ns)
        reason = f"sensor clock jumped by {shift_ns / NANOSECONDS_PER_SECOND:+.3f} s"
        self._health.alarm(states[-1].t_ns, Concern.CLOCK, reason)
        self._reset_counter += 1

    def _wait_for_rest(self, sample: ImuSample) -> list[Odometry | RegisteredScan]:
        """Start if the newest window shows rest, else say now and then why not."""
        initialisation = self._initialiser.add(sample)
        state, reason = initialisation.state, initialisation.reason
        if state is not None:
            self._refusal = reason = self._map_from_rest(state)
        if state is None or reason:
            if not self._is_due(sample.t_sensor_ns, _WAITING_PERIOD_NS):
                return []
            health = Health(OdometryStatus.INITIALISING, 0, self._refusal or reason)
            t_ns = self._host_time_ns(sample.t_sensor_ns)
            return [no_odometry(t_ns, sample.t_sensor_ns, self._reset_counter, health)]
        self._scan_state, self._head = state, state.copy()
        self.anchor.restart()
        self._health = HealthMonitor(self._settings, sample.t_sensor_ns)
        self._last_output = (-1, self._last_output[1])
        return []

    def _map_from_rest(self, state: NavigationState) -> str:
        """Fill the map with the scans of the resting window; if they move, say so and wait anew."""
        since_ns = state.t_ns - seconds_to_ns(self._settings.initial_window_s)
        reason = map_from_rest(
            self.sequencer.take_scans(since_ns, state.t_ns),
            state,
            self._imu_lidar,
            self._matcher,
            self.fine_map,
            self.coarse_map,
            self._settings,
        )
        if reason:
            self._forget()
        return reason

    def _forget(self) -> None:
        self.fine_map.clear()
        self.coarse_map.clear()
        self._initialiser.clear()

    def _give_up(self, health: Health, t_sensor_ns: int | None = None) -> Odometry:
        """Forget motion and map and wait for rest again; nothing is known then, whatever was a moment ago."""
        reason = self._relocaliser.reason if self._relocaliser.hopeless else health.reason
        lost = Health(OdometryStatus.LOST, 0, reason or "state is not finite")
        self._scan_state = self._head = None
        self._relocaliser.forget()
        self._forget()
        self._reset_counter += 1
        self._last_output = (-1, self._last_output[1])
        if t_sensor_ns is None:
            t_sensor_ns = self.sequencer.history.last_ns
        t_ns = max(self._host_time_ns(t_sensor_ns), self._last_output[1])
        return no_odometry(t_ns, t_sensor_ns, self._reset_counter, lost)

    def _inherit(self, correction: Correction, points_imu: FloatArray, chosen: NDArray[np.int64]) -> None:
        """Let the anchor know which ground a scan was matched to."""
        anchor = self.anchor
        self._matcher.share_by_birth(
            correction.seen,
            points_imu,
            chosen,
            anchor.starts,
            anchor.periods,
            anchor.information,
            anchor.weights,
        )
        anchor.follow(correction, self.fine_map.stamp + 1)

    def _insert(self, points_imu: FloatArray, chosen: NDArray[np.int64], pose: FloatArray) -> None:
        """Fuse all points into the fine map; the coarse one, which serves sparse places, needs but a few."""
        self.fine_map.insert(points_imu, pose, self._settings.fine_range_m)
        self.coarse_map.insert(points_imu[chosen], pose, self._settings.max_range_m)

    def _registered(
        self,
        scan: LidarScan,
        points_imu: FloatArray,
        reflectivity: ByteArray,
        ages_ns: NDArray[np.int32],
        correction: Correction,
        health: Health,
    ) -> RegisteredScan:
        """Return the scan in the map with the body's motion at its end."""
        kept = nearest_first(points_imu, self._settings.registered_points)
        seen, omega_imu = correction.seen, self._propagation.end_rate
        points_map: PointArray = (points_imu[kept] @ seen[3:12].reshape(3, 3).T + seen[:3]).astype(np.float32)
        odometry = self._odometry(correction.state, omega_imu, health)
        return RegisteredScan(
            scan.t_ns, scan.sequence, points_map, reflectivity[kept], odometry, ages_ns[kept]
        )

    def _odometry(self, state: NavigationState, omega_imu: FloatArray, health: Health) -> Odometry:
        return body_odometry(
            state,
            self.anchor.covariance,
            self.anchor.correlation,
            omega_imu,
            self._mounting,
            self._host_time_ns(state.t_ns),
            self._reset_counter,
            health,
        )

    def _follow_clock(self, event: ImuSample | LidarScan) -> None:
        """Keep the newest scan's clock offset; before the first scan, the least delayed sample's."""
        if isinstance(event, LidarScan):
            self._clock_offset_ns, self._offset_by_scan = event.clock_offset_ns, True
        elif not self._offset_by_scan:
            offset_ns = event.t_ns - event.t_sensor_ns
            known = self._clock_offset_ns
            self._clock_offset_ns = offset_ns if known is None else min(known, offset_ns)

    def _host_time_ns(self, t_sensor_ns: int) -> int:
        return t_sensor_ns + (self._clock_offset_ns or 0)

    def _is_due(self, t_sensor_ns: int, period_ns: int) -> bool:
        """Whether an output is due at a sensor time; outputs never go back in host time."""
        before_ns, t_ns = self._last_output[0], self._host_time_ns(t_sensor_ns)
        if t_sensor_ns // period_ns <= before_ns // period_ns or t_ns <= self._last_output[1]:
            return False
        self._last_output = (t_sensor_ns, t_ns)
        return True
