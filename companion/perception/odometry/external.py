"""Own motion from another process, carried on by the IMU, and the LiDAR's scans registered with it."""

from collections import deque

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import (
    ExternalOdometry,
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
from companion.perception.odometry.body_motion import no_odometry
from companion.perception.odometry.external_body import body_odometry_of, imu_motion_of
from companion.perception.odometry.external_health import ExternalHealth, Step
from companion.perception.odometry.external_path import (
    DeadReckoning,
    P,
    R,
    StatedPath,
    V,
)
from companion.perception.odometry.health import Health
from companion.perception.odometry.preprocessing import nearest_first, usable_points
from companion.perception.odometry.sequencer import MOST_WAITING_SCANS, Arrival, Sequencer
from companion.perception.odometry.settings import OdometrySettings

_WAITING_PERIOD_NS = NANOSECONDS_PER_SECOND // 2
_MOST_WAITING_MESSAGES = 64
_LEAST_STEP_NS = seconds_to_ns(0.001)
_MAX_AHEAD_NS = seconds_to_ns(0.25)


class ExternalMotionEstimator:
    """Turns another process's odometry, IMU samples and LiDAR scans into odometry and scans in the map.

    Between two messages, and after the newest, the IMU leads on; every message is taken as it is. It
    reads no clock and keeps all memory bounded: what it returns follows from the events alone.
    """

    def __init__(self, settings: OdometrySettings, T_body_lidar: Pose, T_lidar_imu: Pose) -> None:
        """Wait for the first message.

        Args:
            settings: see `OdometrySettings`; of the own estimate's, only what concerns outputs and points.
            T_body_lidar: point frame of the LiDAR in the body frame.
            T_lidar_imu: the LiDAR's inertial chip in its point frame.
        """
        self._settings = settings
        self._limits = settings.external
        self._T_body_imu = T_body_lidar @ T_lidar_imu
        T_imu_lidar = T_lidar_imu.inverse()
        self._imu_lidar = np.concatenate([rotation.to_matrix(T_imu_lidar.q).ravel(), T_imu_lidar.p])
        self._sequencer = Sequencer(settings)
        self._reckoning = DeadReckoning(settings.gravity)
        self._path = StatedPath()
        self._health = ExternalHealth(self._limits)
        self._scans: deque[LidarScan] = deque(maxlen=MOST_WAITING_SCANS)
        self._messages: deque[ExternalOdometry] = deque(maxlen=_MOST_WAITING_MESSAGES)
        self._stated: ExternalOdometry | None = None
        self._stated_ns = 0  # sensor time of what was stated
        self._motion = np.zeros(15)  # of the IMU, as stated
        self._head = np.zeros(15)  # the same, at the newest IMU sample
        self._head_ns = 0
        self._omega_imu = np.zeros(3)
        self._settled = False
        self._reset_counter = 0
        self._clock_offset_ns: int | None = None
        self._offset_by_scan = False
        self._sample_t_ns = 0
        self._output_period_ns = round(NANOSECONDS_PER_SECOND / settings.output_hz)
        self._last_output = (-1, -1)  # index in the output grid, host time
        self.messages_unusable = 0
        self.scans_unusable = 0

    def handle(self, event: SensorEvent) -> list[Odometry | RegisteredScan]:
        """Take one event and return what follows from it.

        Args:
            event: messages of the other process, IMU samples and scans in order of arrival.

        Returns:
            Odometry at the output rate, carried on to the newest IMU sample; one registered scan per scan
            as soon as messages cover its end. While it does not count, odometry with status INITIALISING
            and the reason, twice a second.
        """
        outputs: list[Odometry | RegisteredScan] = []
        if isinstance(event, ExternalOdometry):
            self._messages.append(event)
        elif isinstance(event, LidarScan):
            self._clock_offset_ns, self._offset_by_scan = event.clock_offset_ns, True
            self._scans.append(event)
        else:
            outputs += self._handle_sample(event)
        if len(self._sequencer.history):
            self._take_messages()
            outputs += self._report(event)
            outputs += self._register_scans()
        return outputs

    def _handle_sample(self, sample: ImuSample) -> list[Odometry | RegisteredScan]:
        arrival = self._sequencer.add_sample(sample)
        if arrival is Arrival.DROPPED:
            return []
        self._sample_t_ns = sample.t_ns
        if arrival in (Arrival.BROKEN, Arrival.RELABELLED):
            self._offset_by_scan, self._clock_offset_ns = False, None
            self._last_output = (-1, self._last_output[1])
            self._messages.clear()
            self._scans.clear()
        if not self._offset_by_scan:
            offset_ns, known = sample.t_ns - sample.t_sensor_ns, self._clock_offset_ns
            self._clock_offset_ns = offset_ns if known is None else min(known, offset_ns)
        if arrival is Arrival.BROKEN and self._stated is not None:
            return [self._give_up("IMU data interrupted")]
        if arrival is Arrival.RELABELLED:
            shift_ns = self._sequencer.relabelled_by_ns
            self._stated_ns += shift_ns
            self._head_ns += shift_ns
            self._path.relabel(shift_ns)
            self._health.relabel(shift_ns)
        self._carry_on()
        return []

    def _carry_on(self) -> None:
        """Move the head to the newest IMU sample."""
        last_ns = self._sequencer.history.last_ns
        if self._stated is not None and last_ns > self._head_ns:
            history = self._sequencer.history
            self._omega_imu = self._reckoning.advance(self._head, history, self._head_ns, last_ns)
            self._head_ns = last_ns

    def _take_messages(self) -> None:
        """Take every message whose time the IMU has reached."""
        history = self._sequencer.history
        taken = False
        while self._messages:
            message = self._messages[0]
            t_ns = self._sensor_time_ns(message)
            ahead_ns = t_ns - history.last_ns
            if 0 < ahead_ns <= _MAX_AHEAD_NS:
                break
            self._messages.popleft()
            first = self._stated is None or message.session != self._stated.session
            if (
                ahead_ns > 0
                or t_ns < history.first_ns
                or not (first or t_ns - self._stated_ns > _LEAST_STEP_NS)
            ):
                self.messages_unusable += 1
                continue
            self._take(t_ns, message)
            taken = True
        if taken:
            self._head[:] = self._motion
            self._head_ns = self._stated_ns
            self._carry_on()

    def _take(self, t_ns: int, message: ExternalOdometry) -> None:
        """Make a message the newest that is stated, and see how it follows from the one before."""
        before, before_ns = self._stated, self._stated_ns
        if before is None or message.session != before.session:
            if before is not None:  # another process, or one that has started again
                self._reset_counter += 1
                self._settled = False
                self._last_output = (-1, self._last_output[1])
            self._health.begin(t_ns)
            self._state(t_ns, message, np.zeros(3), np.nan_to_num(message.v_map))
            self._path.begin(t_ns, self._motion)
            return
        predicted = self._motion.copy()
        omega_imu = self._reckoning.advance(predicted, self._sequencer.history, before_ns, t_ns)
        duration_s = (t_ns - before_ns) * 1e-9
        old = self._motion
        v_map = self._velocity(message, predicted, omega_imu, duration_s)
        self._state(t_ns, message, omega_imu, v_map)
        miss = self._motion[P] - predicted[P]
        R_predicted_stated = predicted[R].reshape(3, 3).T @ self._motion[R].reshape(3, 3)
        turn = rotation.log(rotation.from_matrix(R_predicted_stated))
        jump = self._jump(float(np.linalg.norm(miss)), float(np.linalg.norm(turn)))
        announced = message.reset_counter != before.reset_counter
        if announced or jump:
            self._reset_counter += 1
            self._path.begin(t_ns, self._motion)
            self._health.reset(t_ns, "" if announced else jump)
            return
        self._path.extend(t_ns, self._motion, self._reckoning.segments[: self._reckoning.count])
        self._learn_gyro_bias(turn, duration_s)
        gravity_up = np.array([0.0, 0.0, self._settings.gravity])
        step = Step(
            duration_s=duration_s,
            way_map=self._motion[P] - old[P],
            stated_way_map=0.5 * duration_s * (old[V] + self._motion[V]),
            lift_map=(predicted[V] - self._motion[V]) / duration_s + gravity_up,
        )
        self._health.moved(t_ns, step)

    def _state(self, t_ns: int, message: ExternalOdometry, omega_imu: FloatArray, v_map: FloatArray) -> None:
        self._stated, self._stated_ns = message, t_ns
        self._motion = imu_motion_of(message, v_map, omega_imu, self._T_body_imu)
        self._health.arrived(t_ns, message)

    def _velocity(
        self, message: ExternalOdometry, predicted: FloatArray, omega_imu: FloatArray, duration_s: float
    ) -> FloatArray:
        """Return the body's velocity (3,): as stated, or learnt from positions and the IMU."""
        if np.isfinite(message.v_map).all():
            return message.v_map
        R_map_imu = predicted[R].reshape(3, 3)
        R_map_body = rotation.to_matrix(message.q_map_body)
        lever_map = R_map_body @ self._T_body_imu.p
        swing_map = R_map_imu @ np.cross(omega_imu, R_map_imu.T @ lever_map)
        gain = min(1.0, duration_s / self._limits.unstated_velocity_time_s)
        miss = message.p_map + lever_map - predicted[P]
        return np.asarray(predicted[V] - swing_map + gain * miss / duration_s)

    def _jump(self, miss_m: float, turn_rad: float) -> str:
        """Return how a pose differs too much from the prediction, or an empty string."""
        if miss_m > self._limits.max_jump_m:
            return f"external position jumped by {miss_m:.2f} m"
        turn_deg = float(np.degrees(turn_rad))
        if turn_deg > self._limits.max_turn_jump_deg:
            return f"external attitude jumped by {turn_deg:.0f} deg"
        return ""

    def _learn_gyro_bias(self, turn: FloatArray, duration_s: float) -> None:
        """What the gyro turns too far, interval by interval, is its bias."""
        limit = self._limits.max_gyro_bias
        # turn / duration is the rate's error; only duration / time constant of it is believed at once.
        bias = self._reckoning.gyro_bias - turn / self._limits.gyro_bias_time_s
        self._reckoning.gyro_bias = np.clip(bias, -limit, limit)

    def _report(self, event: SensorEvent) -> list[Odometry | RegisteredScan]:
        """Judge what is known at this moment, and say it when an output is due."""
        silent_s = (event.t_ns - self._sample_t_ns) * 1e-9
        if self._settled and silent_s > self._settings.max_imu_gap_s:
            return [self._give_up(f"no IMU samples for {silent_s:.1f} s")]
        now_ns = self._sequencer.history.last_ns
        health = self._health.judge(now_ns, self._settled)
        if health.status is OdometryStatus.LOST and self._stated is not None:
            if self._settled:
                return [self._give_up(health.reason)]
            if self._is_silent(now_ns):
                self._stated = None
                self._health.forget()
            health = Health(OdometryStatus.INITIALISING, 0, health.reason)
        if health.status is OdometryStatus.INITIALISING:
            if not isinstance(event, ImuSample) or not self._is_due(now_ns, _WAITING_PERIOD_NS):
                return []
            return [no_odometry(self._host_time_ns(now_ns), now_ns, self._reset_counter, health)]
        self._settled = True
        if not isinstance(event, ImuSample) or not self._is_due(now_ns, self._output_period_ns):
            return []
        return [self._odometry(self._head, self._omega_imu, self._head_ns, health)]

    def _is_silent(self, now_ns: int) -> bool:
        return now_ns - self._stated_ns > seconds_to_ns(self._limits.lost_after_s)

    def _give_up(self, reason: str) -> Odometry:
        """Count on nothing any more and wait for messages that settle anew."""
        self._stated = None
        self._settled = False
        self._health.forget()
        self._messages.clear()
        self._scans.clear()
        self._reset_counter += 1
        self._last_output = (-1, self._last_output[1])
        t_ns = self._sequencer.history.last_ns
        health = Health(OdometryStatus.LOST, 0, reason)
        return no_odometry(self._host_time_ns(t_ns), t_ns, self._reset_counter, health)

    def _register_scans(self) -> list[Odometry | RegisteredScan]:
        """Move every scan into the map whose end the messages cover."""
        outputs: list[Odometry | RegisteredScan] = []
        while self._settled and self._scans and self._scans[0].t_sensor_end_ns <= self._path.end_ns:
            scan = self._scans.popleft()
            if self._path.covers(scan.t_sensor_start_ns, scan.t_sensor_end_ns):
                outputs.append(self._registered(scan))
            else:
                self.scans_unusable += 1
        return outputs

    def _registered(self, scan: LidarScan) -> RegisteredScan:
        segments, motion, omega_imu = self._path.between(scan.t_sensor_start_ns, scan.t_sensor_end_ns)
        points_lidar, offsets_ns, reflectivity = usable_points(scan, self._settings)
        points_imu = np.empty((len(points_lidar), 3))
        kernels.deskew(points_lidar, offsets_ns, segments, len(segments), self._imu_lidar, points_imu)
        kept = nearest_first(points_imu, self._settings.registered_points)
        points_map: PointArray = (points_imu[kept] @ motion[R].reshape(3, 3).T + motion[P]).astype(np.float32)
        health = self._health.judge(self._sequencer.history.last_ns, self._settled)
        odometry = self._odometry(motion, omega_imu, scan.t_sensor_end_ns, health)
        ages_ns = (scan.t_sensor_end_ns - scan.t_sensor_start_ns - offsets_ns).astype(np.int32)
        return RegisteredScan(
            scan.t_ns, scan.sequence, points_map, reflectivity[kept], odometry, ages_ns[kept]
        )

    def _odometry(self, motion: FloatArray, omega_imu: FloatArray, t_ns: int, health: Health) -> Odometry:
        assert self._stated is not None
        return body_odometry_of(
            motion,
            omega_imu,
            self._T_body_imu,
            self._stated,
            age_s=max(0, t_ns - self._stated_ns) * 1e-9,
            t_ns=self._host_time_ns(t_ns),
            t_sensor_ns=t_ns,
            reset_counter=self._reset_counter,
            health=health,
            limits=self._limits,
        )

    def _sensor_time_ns(self, message: ExternalOdometry) -> int:
        if message.on_lidar_clock:
            return message.t_source_ns
        return message.t_valid_ns - (self._clock_offset_ns or 0)

    def _host_time_ns(self, t_sensor_ns: int) -> int:
        return t_sensor_ns + (self._clock_offset_ns or 0)

    def _is_due(self, t_sensor_ns: int, period_ns: int) -> bool:
        """Whether an output is due at this time; outputs never go back in host time."""
        index, t_ns = t_sensor_ns // period_ns, self._host_time_ns(t_sensor_ns)
        if index <= self._last_output[0] or t_ns <= self._last_output[1]:
            return False
        self._last_output = (index, t_ns)
        return True
