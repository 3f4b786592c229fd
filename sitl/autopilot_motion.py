"""The emulated estimator's state: motion in the local frame, its variances and its corrections."""

from sitl.autopilot_filter import AxisCovariance, PastState, StateHistory, wrap_angle
from sitl.autopilot_inputs import Quaternion, Vector


class MotionState:
    """Position, velocity and heading as the autopilot believes them.

    The heading is kept as `turn`: the angle from the world's axes to the local frame's axes as the
    estimator believes it, so a wrong heading rotates every acceleration it integrates and every command
    the autopilot gives. Corrections are summed apart from the prediction, so that a late measurement can
    be compared with the state at its own time.

    Attributes:
        p_local, v_local: estimate in the z-up local frame, metres and m/s.
        turn: believed heading minus true heading in the world, radians.
        horizontal, vertical: covariances of one horizontal axis and of the vertical one.
        yaw_variance: rad^2.
        reset_counter: number of jumps of the estimate.
        p_shift: sum of all position jumps, metres, so that a held position can move along.
    """

    def __init__(self, turn: float, process_noise: float) -> None:
        """Start at the local origin.

        Args:
            turn: initial heading error, radians.
            process_noise: acceleration noise density that the covariances assume, m^2/s^3.
        """
        self.p_local: Vector = (0.0, 0.0, 0.0)
        self.v_local: Vector = (0.0, 0.0, 0.0)
        self.turn = turn
        self.horizontal = AxisCovariance(process_noise)
        self.vertical = AxisCovariance(process_noise)
        self.yaw_variance = 0.03
        self.reset_counter = 0
        self.p_shift: Vector = (0.0, 0.0, 0.0)
        self._history = StateHistory()
        self._p_correction = [0.0, 0.0, 0.0]
        self._v_correction = [0.0, 0.0, 0.0]
        self._turn_correction = 0.0

    def remember(self, t_ns: int, q_world_body: Quaternion) -> None:
        """Keep the present prediction for measurements that arrive late."""
        p, v = self._p_correction, self._v_correction
        self._history.append(
            PastState(
                t_ns,
                (self.p_local[0] - p[0], self.p_local[1] - p[1], self.p_local[2] - p[2]),
                (self.v_local[0] - v[0], self.v_local[1] - v[1], self.v_local[2] - v[2]),
                self.turn - self._turn_correction,
                q_world_body,
            )
        )

    def at(self, t_ns: int) -> PastState | None:
        """Return the state at `t_ns` with everything learnt since, None before the first step."""
        past = self._history.at(t_ns)
        if past is None:
            return None
        p, v = self._p_correction, self._v_correction
        return PastState(
            past.t_ns,
            (past.p[0] + p[0], past.p[1] + p[1], past.p[2] + p[2]),
            (past.v[0] + v[0], past.v[1] + v[1], past.v[2] + v[2]),
            past.turn + self._turn_correction,
            past.q_world_body,
        )

    def correct_axis(self, axis: int, d_p: float, d_v: float) -> None:
        """Move one axis's position and velocity, metres and m/s."""
        p, v = list(self.p_local), list(self.v_local)
        p[axis] += d_p
        v[axis] += d_v
        self.p_local, self.v_local = (p[0], p[1], p[2]), (v[0], v[1], v[2])
        self._p_correction[axis] += d_p
        self._v_correction[axis] += d_v

    def correct_turn(self, angle: float) -> None:
        """Rotate the heading by a small angle in radians."""
        self.turn = wrap_angle(self.turn + angle)
        self._turn_correction += angle

    def jump(self, d_p: Vector) -> None:
        """Move the position at once and count the jump."""
        for axis in range(3):
            self.correct_axis(axis, d_p[axis], 0.0)
        shift = self.p_shift
        self.p_shift = (shift[0] + d_p[0], shift[1] + d_p[1], shift[2] + d_p[2])
        self.reset_counter += 1

    def set_turn(self, turn: float, variance: float) -> None:
        """Replace the heading error (radians) and its variance."""
        self.correct_turn(wrap_angle(turn - self.turn))
        self.yaw_variance = variance
