"""Whatever is asked for, what leaves is finite and within the limits."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.messages import FloatArray
from companion.safety.limits import VelocityLimiter
from companion.safety.settings import SafetySettings

SETTINGS = SafetySettings()
PERIOD_NS = 20_000_000
anything = st.floats(allow_nan=True, allow_infinity=True)


@given(
    st.lists(st.tuples(arrays(np.float64, (3,), elements=anything), anything), min_size=2, max_size=12),
)
def test_no_wish_breaks_a_limit(wishes: list[tuple[FloatArray, float]]) -> None:
    limiter = VelocityLimiter(SETTINGS)
    previous: FloatArray = np.zeros(3)
    for index, (wish, height) in enumerate(wishes):
        v_map = limiter.limit(wish, height, index * PERIOD_NS)
        assert np.isfinite(v_map).all()
        assert math.hypot(v_map[0], v_map[1]) <= SETTINGS.max_speed_mps + 1e-9
        assert -SETTINGS.max_descent_mps - 1e-9 <= v_map[2] <= SETTINGS.max_climb_mps + 1e-9
        step = float(np.linalg.norm(v_map - previous))
        assert step <= SETTINGS.max_acceleration_mps2 * 0.02 + 1e-9
        previous = v_map


def test_the_first_setpoint_after_taking_control_is_zero() -> None:
    limiter = VelocityLimiter(SETTINGS)
    limiter.restart(np.zeros(3))
    np.testing.assert_array_equal(limiter.limit(np.array([2.0, 0.0, 0.0]), 1.5, 0), np.zeros(3))


def test_speed_is_reached_at_the_permitted_acceleration() -> None:
    limiter = VelocityLimiter(SETTINGS)
    for index in range(26):
        v_map = limiter.limit(np.array([5.0, 0.0, 0.0]), 1.5, index * PERIOD_NS)
    np.testing.assert_allclose(v_map, [2.0, 0.0, 0.0])


def test_altitude_limits_stop_climb_and_descent() -> None:
    def settled(v_up: float, height: float) -> float:
        limiter = VelocityLimiter(SETTINGS)
        for index in range(60):
            v_map = limiter.limit(np.array([0.0, 0.0, v_up]), height, index * PERIOD_NS)
        return float(v_map[2])

    assert settled(1.0, SETTINGS.max_altitude_m + 0.1) == 0.0
    assert settled(-0.5, SETTINGS.min_altitude_m - 0.1) == 0.0
    assert settled(-0.5, SETTINGS.max_altitude_m + 0.1) == -0.5
    assert settled(1.0, 1.5) == 1.0


@given(anything)
def test_turn_rate_is_bounded(yaw_rate: float) -> None:
    limited = VelocityLimiter(SETTINGS).limit_yaw_rate(yaw_rate)
    assert abs(limited) <= math.radians(SETTINGS.max_yaw_rate_deg_s)
