import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.logs import metrics
from companion.logs.metrics import UnusableFlightError, measure
from companion.messages import FloatArray
from tests.logs import metrics_oracle as oracle


@st.composite
def flights(draw: st.DrawFn) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times, positions, velocities and obstacle points of a random swarm, some of it standing still."""
    samples, vehicles = draw(st.integers(2, 12)), draw(st.integers(2, 6))
    coordinate = st.floats(-50.0, 50.0, allow_subnormal=False)
    p = draw(arrays(np.float64, (samples, vehicles, 3), elements=coordinate))
    speed = st.one_of(st.just(0.0), st.floats(-3.0, 3.0, allow_subnormal=False))
    v = draw(arrays(np.float64, (samples, vehicles, 3), elements=speed))
    points = draw(arrays(np.float64, (draw(st.integers(1, 8)), 3), elements=coordinate))
    steps = draw(arrays(np.float64, samples, elements=st.floats(1e-3, 2.0)))
    return np.cumsum(steps), p, v, points


def same(found: float, expected: float) -> bool:
    return math.isclose(found, expected, rel_tol=0.0, abs_tol=1e-9) or (
        math.isnan(found) and math.isnan(expected)
    )


@given(flights(), st.floats(0.5, 60.0))
@settings(deadline=None, max_examples=150)
def test_every_metric_is_what_loops_over_its_formula_give(
    flight: tuple[FloatArray, FloatArray, FloatArray, FloatArray], cap_m: float
) -> None:
    t, p, v, points = flight
    distances = np.linalg.norm(p[:, :, None] - points, axis=3).min(axis=2)
    found = measure(t, p, v, distances, cap_m=cap_m)
    assert same(found.FR.mean, oracle.flock_radius(p.tolist()))
    assert same(found.MS.mean, oracle.minimum_separation(p.tolist()))
    assert same(found.AL.mean, oracle.alignment(v.tolist()))
    if not np.any(np.isclose(distances, cap_m, rtol=0.0, atol=1e-9)):
        assert same(found.MDO.mean, oracle.obstacle_distance(p.tolist(), points.tolist(), cap_m))


@given(
    arrays(np.float64, 3, elements=st.floats(-50, 50)),
    arrays(np.float64, 3, elements=st.floats(-50, 50)),
    arrays(np.float64, (3, 3), elements=st.floats(-80, 80)),
)
@settings(deadline=None)
def test_progress_is_what_loops_over_its_formula_give(
    start: FloatArray, goal: FloatArray, ends: FloatArray
) -> None:
    if np.linalg.norm(start - goal) < 1e-3:
        return
    found = [metrics.mission_progress_percent(start, goal, end) for end in ends]
    expected = oracle.mission_progress(start.tolist(), goal.tolist(), ends.tolist())
    assert same(sum(found) / 3.0, expected)


@given(flights(), st.floats(-np.pi, np.pi))
@settings(deadline=None, max_examples=40)
def test_no_metric_depends_on_the_frame(
    flight: tuple[FloatArray, FloatArray, FloatArray, FloatArray], yaw: float
) -> None:
    t, p, v, _ = flight
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    here, there = measure(t, p, v), measure(t, p @ turn.T + [3.0, -7.0, 1.0], v @ turn.T)
    assert here.FR.mean == pytest.approx(there.FR.mean, abs=1e-9)
    assert here.MS.mean == pytest.approx(there.MS.mean, abs=1e-9)


class TestByHand:
    def test_a_square_has_half_its_diagonal_as_radius_and_its_side_as_separation(self) -> None:
        p = np.array([[[0, 0, 1], [2, 0, 1], [2, 2, 1], [0, 2, 1]]] * 3, dtype=float)
        found = measure([0.0, 0.05, 0.1], p, np.ones_like(p))
        assert found.FR.mean == pytest.approx(math.sqrt(2.0))
        assert found.MS.mean == pytest.approx(2.0)
        assert found.AL.mean == pytest.approx(1.0)
        assert found.FR.sd == pytest.approx(0.0)

    def test_vehicles_that_stand_still_have_no_direction(self) -> None:
        v = np.array([[[1.0, 0, 0], [0.049, 0, 0], [0, -1.0, 0]]])
        mean = np.array([1.049, -1.0, 0.0])
        expected = (mean[0] - mean[1]) / 2.0 / np.linalg.norm(mean)
        assert metrics.alignment(v)[0] == pytest.approx(expected)

    def test_a_swarm_that_hovers_has_no_alignment(self) -> None:
        found = measure([0.0, 1.0], np.arange(12.0).reshape(2, 2, 3), np.zeros((2, 2, 3)))
        assert np.all(np.isnan(found.alignment))
        assert math.isnan(found.AL.mean)
        assert found.AL.samples == 0

    def test_velocities_that_cancel_have_no_common_direction(self) -> None:
        assert np.isnan(metrics.alignment(np.array([[[1.0, 0, 0], [-1.0, 0, 0]]]))[0])

    def test_only_samples_with_an_obstacle_nearer_than_the_cap_count(self) -> None:
        distances = np.array([[1.0, 3.0], [4.0, 9.0], [np.inf, np.inf], [3.0, 3.999]])
        nearest = metrics.obstacle_distance_m(distances, 4.0)
        assert nearest[[0, 3]].tolist() == [1.0, 3.0]
        assert np.isnan(nearest[[1, 2]]).all()
        assert np.isnan(metrics.obstacle_distance_m([[np.inf, np.inf]], math.inf)).all()
        assert metrics.obstacle_distance_m([[7.0, 9.0]], math.inf).tolist() == [7.0]

    def test_without_obstacles_known_there_is_no_distance_to_them(self) -> None:
        found = measure([0.0, 1.0], np.arange(12.0).reshape(2, 2, 3), np.ones((2, 2, 3)))
        assert math.isnan(found.MDO.mean)

    @pytest.mark.parametrize(
        ("end", "success", "expected"),
        [
            ((0, 0, 0), False, 0.0),
            ((7.5, 0, 0), False, 75.0),
            ((-5, 0, 0), False, 0.0),
            ((9.7, 0, 0), False, 97.0),
            ((9.7, 0, 0), True, 100.0),
        ],
    )
    def test_progress_is_clamped_and_complete_on_success(
        self, end: Any, success: bool, expected: float
    ) -> None:
        found = metrics.mission_progress_percent((0, 0, 0), (10, 0, 0), end, success=success)
        assert found == pytest.approx(expected)

    def test_the_success_rate_is_in_percent(self) -> None:
        assert metrics.success_rate_percent(97, 100) == pytest.approx(97.0)


class TestRefusals:
    t = np.array([0.0, 0.05, 0.1])
    p = np.arange(18.0).reshape(3, 2, 3)
    v = np.ones((3, 2, 3))

    def refused(self, *flight: Any, **more: Any) -> str:
        with pytest.raises(UnusableFlightError) as caught:
            measure(*flight, **more)
        text = str(caught.value)
        assert "\n" not in text
        assert not text.endswith(".")
        return text

    def test_a_missing_number_is_named(self) -> None:
        p = self.p.copy()
        p[1, 0, 2] = np.nan
        assert "positions of UAV 0 in sample 1" in self.refused(self.t, p, self.v)
        v = self.v.copy()
        v[2, 1, 0] = np.inf
        assert "velocities in sample 2" in self.refused(self.t, self.p, v)
        assert "distances in sample 0" in self.refused(self.t, self.p, self.v, np.full((3, 2), np.nan))
        assert "time of sample 1" in self.refused([0.0, np.nan, 1.0], self.p, self.v)

    def test_one_vehicle_is_no_swarm(self) -> None:
        assert "no swarm" in self.refused(self.t, self.p[:, :1], self.v[:, :1])

    def test_a_flight_of_zero_length_is_refused(self) -> None:
        empty = np.zeros((0, 2, 3))
        assert "zero length" in self.refused([], empty, empty)
        assert "zero length" in self.refused(self.t[:1], self.p[:1], self.v[:1])

    def test_shapes_must_agree(self) -> None:
        assert "(3, 2, 3) is needed" in self.refused(self.t, self.p, self.v[:2])
        assert "(3, 2) is needed" in self.refused(self.t, self.p, self.v, np.ones((3, 3)))
        assert "one time a sample" in self.refused(self.t[:2], self.p, self.v)
        assert "(T, N, 3) is needed" in self.refused(self.t, self.p[:, 0], self.v)

    def test_times_must_rise(self) -> None:
        assert "sample 2 does not come after" in self.refused([0.0, 0.1, 0.1], self.p, self.v)

    def test_a_cap_must_leave_something(self) -> None:
        assert "cap of 0 m" in self.refused(self.t, self.p, self.v, np.ones((3, 2)), cap_m=0.0)

    def test_a_way_of_zero_length_has_no_progress(self) -> None:
        with pytest.raises(UnusableFlightError, match="zero length"):
            metrics.mission_progress_percent((1, 2, 3), (1, 2, 3), (0, 0, 0))
        with pytest.raises(UnusableFlightError, match="the end of the way"):
            metrics.mission_progress_percent((1, 2, 3), (1, 2, 4), (0, 0, np.nan))

    @pytest.mark.parametrize(("successes", "trials"), [(0, 0), (3, 2), (-1, 5)])
    def test_impossible_counts_make_no_success_rate(self, successes: int, trials: int) -> None:
        with pytest.raises(UnusableFlightError, match="no success rate"):
            metrics.success_rate_percent(successes, trials)
