"""Fusion of external vision: what is taken, what is rejected and what resets the emulated estimator."""

from sitl.autopilot_filter import Aid, PastState, rotate_by, turn_about_z, wrap_angle, yaw_of
from sitl.autopilot_inputs import ExternalVision, Vector, VisionFrame
from sitl.autopilot_motion import MotionState
from sitl.autopilot_parameters import Parameters

_SAMPLE_AGE_MAX_NS = 300_000_000
# PX4 keeps a sample from the future until its filter's horizon gets there. Here it is compared with the
# newest state, which is harder on whoever sent it.
_SAMPLE_LEAD_MAX_NS = 100_000_000
_HORIZONTAL, _VERTICAL, _VELOCITY, _YAW = 1, 2, 4, 8
_YAW_GAIN = 0.1
_MAG_TYPE_NONE = 5


class VisionFusion:
    """Four independent aids fed by external vision, as EKF2_EV_CTRL selects them.

    Attributes:
        position, height, velocity, yaw: the aids.
        dropped: samples refused whole (stale, from the future, of low quality, of a conflicting frame).
        rejected: measurements that failed their innovation test.
    """

    def __init__(self, motion: MotionState, parameters: Parameters) -> None:
        """Work on `motion`, reading `parameters` anew at every sample."""
        self._motion = motion
        self._parameters = parameters
        self.position, self.height, self.velocity, self.yaw = Aid(), Aid(), Aid(), Aid()
        self.dropped = 0
        self.rejected = 0
        self._reset_counter: int | None = None
        self._frd_used = False
        self._frames_mixed = False

    def fuse(self, t_ns: int, sample: ExternalVision, gnss_active: bool) -> None:
        """Fuse one sample that arrives at `t_ns`.

        Samples older than 300 ms or more than 100 ms ahead, below EKF2_EV_QMIN, or in a north-aligned frame
        after an odometry frame was used, are dropped. GNSS takes precedence for position.
        """
        t_sample_ns = sample.t_ns - int(float(self._parameters["EKF2_EV_DELAY"]) * 1.0e6)
        past = self._motion.at(t_sample_ns)
        quality_min = int(self._parameters["EKF2_EV_QMIN"])
        self._frames_mixed |= sample.frame is VisionFrame.NORTH and self._frd_used
        if (
            past is None
            or not -_SAMPLE_LEAD_MAX_NS <= t_ns - t_sample_ns <= _SAMPLE_AGE_MAX_NS
            or (quality_min > 0 and sample.quality < quality_min)
            or self._frames_mixed
        ):
            self.dropped += 1
            return
        control = int(self._parameters["EKF2_EV_CTRL"])
        jumped = self._reset_counter is not None and sample.reset_counter != self._reset_counter
        self._reset_counter = sample.reset_counter
        if control & _YAW and sample.q_local_body is not None:
            self._fuse_yaw(
                t_ns, sample, yaw_of(sample.q_local_body) - yaw_of(past.q_world_body), past, jumped
            )
        if not self.yaw.active and int(self._parameters["EKF2_MAG_TYPE"]) == _MAG_TYPE_NONE:
            return
        # A heading correction turns what a body velocity means, so the past is read anew.
        past = self._motion.at(t_sample_ns) or past
        if control & _VELOCITY and sample.v is not None:
            self._fuse_velocity(t_ns, sample, _velocity(sample, sample.v, past), past)
        if sample.p_local is not None:
            past = self._motion.at(t_sample_ns) or past
            if control & _HORIZONTAL and not gnss_active:
                self._fuse_position(t_ns, sample, sample.p_local, past, jumped)
            if control & _VERTICAL and int(self._parameters["EKF2_HGT_REF"]) == 3:
                self._fuse_height(t_ns, sample, sample.p_local[2], past, jumped)

    def stop_silent(self, t_ns: int) -> bool:
        """Stop every aid whose data has stopped; return whether the heading lost its source."""
        for aid in (self.position, self.height, self.velocity):
            aid.stop_if_silent(t_ns)
        return self.yaw.stop_if_silent(t_ns)

    def _fuse_yaw(
        self, t_ns: int, sample: ExternalVision, measured: float, past: PastState, jumped: bool
    ) -> None:
        motion = self._motion
        starts = self.yaw.offer(t_ns)
        if not self.yaw.active:
            return
        innovation = wrap_angle(measured - past.turn)
        total = motion.yaw_variance + self._noise(sample.yaw_variance, "EKF2_EVA_NOISE")
        gate = float(self._parameters["EKF2_HDG_GATE"])
        passes = innovation * innovation <= gate * gate * total
        if starts or jumped or self.yaw.judge(t_ns, passes):
            self._frd_used |= sample.frame is VisionFrame.ODOMETRY
            motion.reset_counter += int(starts or abs(innovation) > 1.0e-3)
            motion.correct_turn(innovation)
            motion.yaw_variance = 1.0e-3
            self.yaw.fused(t_ns)
        elif passes:
            motion.correct_turn(_YAW_GAIN * innovation)
        else:
            self.rejected += 1

    def _fuse_position(
        self, t_ns: int, sample: ExternalVision, p_local: Vector, past: PastState, jumped: bool
    ) -> None:
        motion = self._motion
        variance = self._noise(_mean(sample.position_variance), "EKF2_EVP_NOISE")
        d_x, d_y = p_local[0] - past.p[0], p_local[1] - past.p[1]
        starts = self.position.offer(t_ns)
        if not self.position.active:
            return
        gate = float(self._parameters["EKF2_EVP_GATE"])
        passes = d_x * d_x + d_y * d_y <= gate * gate * (motion.horizontal.position + variance)
        if starts or jumped or self.position.judge(t_ns, passes):
            motion.jump((d_x, d_y, 0.0))
            motion.horizontal.reset(variance, max(motion.horizontal.velocity, 0.01))
            self.position.fused(t_ns)
            if starts and not self.velocity.active:
                v = (0.0, 0.0, 0.0) if sample.v is None else _velocity(sample, sample.v, past)
                motion.correct_axis(0, 0.0, v[0] - motion.v_local[0])
                motion.correct_axis(1, 0.0, v[1] - motion.v_local[1])
                motion.reset_counter += 1
        elif passes:
            gain_p, gain_v = motion.horizontal.update_position(variance)
            motion.correct_axis(0, gain_p * d_x, gain_v * d_x)
            motion.correct_axis(1, gain_p * d_y, gain_v * d_y)
        else:
            self.rejected += 1

    def _fuse_height(
        self, t_ns: int, sample: ExternalVision, z: float, past: PastState, jumped: bool
    ) -> None:
        motion = self._motion
        measured = None if sample.position_variance is None else sample.position_variance[2]
        variance = self._noise(measured, "EKF2_EVP_NOISE")
        d_z = z - past.p[2]
        starts = self.height.offer(t_ns)
        if not self.height.active:
            return
        gate = float(self._parameters["EKF2_EVP_GATE"])
        passes = d_z * d_z <= gate * gate * (motion.vertical.position + variance)
        if starts or jumped or self.height.judge(t_ns, passes):
            motion.jump((0.0, 0.0, d_z))
            motion.vertical.reset(variance, max(motion.vertical.velocity, 0.01))
            self.height.fused(t_ns)
        elif passes:
            gain_p, gain_v = motion.vertical.update_position(variance)
            motion.correct_axis(2, gain_p * d_z, gain_v * d_z)
        else:
            self.rejected += 1

    def _fuse_velocity(self, t_ns: int, sample: ExternalVision, v: Vector, past: PastState) -> None:
        motion = self._motion
        variance = self._noise(_mean(sample.velocity_variance), "EKF2_EVV_NOISE")
        d = [v[axis] - past.v[axis] for axis in range(3)]
        starts = self.velocity.offer(t_ns)
        if not self.velocity.active:
            return
        gate = float(self._parameters["EKF2_EVV_GATE"])
        passes = d[0] * d[0] + d[1] * d[1] <= gate * gate * (motion.horizontal.velocity + variance)
        if starts or self.velocity.judge(t_ns, passes):
            for axis in range(3):
                motion.correct_axis(axis, 0.0, d[axis])
            motion.horizontal.reset(motion.horizontal.position, variance)
            self.velocity.fused(t_ns)
            motion.reset_counter += 1
        elif passes:
            gains, gains_z = (
                motion.horizontal.update_velocity(variance),
                motion.vertical.update_velocity(variance),
            )
            for axis, (gain_p, gain_v) in enumerate((gains, gains, gains_z)):
                motion.correct_axis(axis, gain_p * d[axis], gain_v * d[axis])
        else:
            self.rejected += 1

    def _noise(self, variance: float | None, parameter: str) -> float:
        """Return the variance to fuse with: the sender's, but never below the parameter's."""
        floor = float(self._parameters[parameter]) ** 2
        if variance is None or int(self._parameters["EKF2_EV_NOISE_MD"]) == 1:
            return floor
        return max(variance, floor)


def _velocity(sample: ExternalVision, v: Vector, past: PastState) -> Vector:
    if not sample.v_in_body:
        return v
    return turn_about_z(past.turn, rotate_by(past.q_world_body, v))


def _mean(variance: Vector | None) -> float | None:
    return None if variance is None else 0.5 * (variance[0] + variance[1])
