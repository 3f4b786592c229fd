import heapq

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.hil_state import HilStatePublisher, HilStateSettings
from sitl.px4_truth import STEP_NS, Px4Truth, Px4TruthSettings
from sitl.px4_truth_clock import ClockMap
from sitl.vehicle_truth import VehicleTruth
from tests.sitl.smooth_flight import truth_at


class Chase:
    """A published flight, delivered with jitter, and the trajectory that follows it."""

    def __init__(self, seed: int = 3, clock_slow: float = 0.007) -> None:
        self.publisher = HilStatePublisher(HilStateSettings(clock_slow=clock_slow))
        self.truth = Px4Truth(Px4TruthSettings(), p_start_world=truth_at(0).p_world)
        self.t_ns = 0
        self.silent = False
        self._rng = np.random.default_rng(seed)
        self._mail: list[tuple[int, bytes]] = []

    def run(self, seconds: float) -> list[tuple[VehicleTruth, VehicleTruth]]:
        """Return (followed, true) states every 5 ms."""
        pairs = []
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.t_ns += STEP_NS
            true = truth_at(self.t_ns)
            frame = self.publisher.poll(self.t_ns, true)
            if frame is not None and not self.silent:
                delay_ns = 1_000_000 + round(4e6 * float(self._rng.exponential()))
                heapq.heappush(self._mail, (self.t_ns + delay_ns, frame))
            while self._mail and self._mail[0][0] <= self.t_ns:
                t_ns, data = heapq.heappop(self._mail)
                self.truth.receive(data, t_ns)
            followed = self.truth.state_at(self.t_ns)
            if followed is not None:
                pairs.append((followed, true))
        return pairs


def _rms(values: list[FloatArray]) -> float:
    return float(np.sqrt(np.mean(np.square(np.stack(values)))))


@pytest.fixture(scope="module")
def flight() -> list[tuple[VehicleTruth, VehicleTruth]]:
    chase = Chase()
    chase.run(4.0)
    return chase.run(16.0)


def test_a_quantised_jittered_slow_stream_is_followed_within_a_centimetre(
    flight: list[tuple[VehicleTruth, VehicleTruth]],
) -> None:
    speeds = [float(np.linalg.norm(true.v_world)) for _, true in flight]
    errors = [followed.p_world - true.p_world for followed, true in flight]
    assert max(speeds) > 2.0
    assert float(np.sqrt(np.mean([e @ e for e in errors]))) < 0.010, "8 mm of it is the mean delay"
    assert max(float(np.linalg.norm(e)) for e in errors) < 0.020
    assert _rms([followed.v_world - true.v_world for followed, true in flight]) < 0.01


def test_quantisation_adds_less_than_a_tenth_of_a_metre_per_second_squared(
    flight: list[tuple[VehicleTruth, VehicleTruth]],
) -> None:
    assert _rms([followed.accel_world - true.accel_world for followed, true in flight]) < 0.1


def test_attitude_and_rate_follow_without_shaking(flight: list[tuple[VehicleTruth, VehicleTruth]]) -> None:
    angles = [float(rotation.angle_between(f.q_world_body, t.q_world_body)) for f, t in flight]
    assert max(angles) < np.radians(0.15)
    assert _rms([followed.omega_body - true.omega_body for followed, true in flight]) < 0.003


def test_velocity_and_acceleration_are_derivatives_of_the_position_at_every_time() -> None:
    chase = Chase()
    chase.run(8.0)
    h_ns = 200_000
    for t_ns in range(chase.t_ns - 300_000_000, chase.t_ns - 1_000_000, 1_370_000):
        before, now, after = (_state(chase.truth, t_ns + shift) for shift in (-h_ns, 0, h_ns))
        h = h_ns * 1e-9
        assert (after.p_world - before.p_world) / (2 * h) == pytest.approx(now.v_world, abs=1e-5)
        assert (after.v_world - before.v_world) / (2 * h) == pytest.approx(now.accel_world, abs=5e-3)
        turn = rotation.log(rotation.multiply(rotation.conjugate(before.q_world_body), after.q_world_body))
        assert turn / (2 * h) == pytest.approx(now.omega_body, abs=1e-4)


def test_corrections_never_jump() -> None:
    chase = Chase()
    chase.run(6.0)
    states = [_state(chase.truth, t) for t in range(chase.t_ns - 800_000_000, chase.t_ns, 1_000_000)]
    for name, limit in (("p_world", 0.004), ("v_world", 0.006), ("accel_world", 0.05), ("omega_body", 0.02)):
        values = np.stack([getattr(state, name) for state in states])
        assert np.abs(np.diff(values, axis=0)).max() < limit, name


def test_what_was_once_given_out_never_changes() -> None:
    chase = Chase()
    chase.run(5.0)
    t_ns = chase.t_ns - 123_456
    first = _state(chase.truth, t_ns)
    chase.run(0.5)
    again = _state(chase.truth, t_ns)
    assert np.array_equal(first.p_world, again.p_world)
    assert np.array_equal(first.accel_world, again.accel_world)
    with pytest.raises(ValueError, match="no trajectory before"):
        chase.truth.state_at(chase.t_ns - 5_000_000_000)


def test_silence_lets_the_motion_go_on_straight_and_not_explode() -> None:
    chase = Chase()
    chase.run(10.0)
    chase.silent = True
    start = _state(chase.truth, chase.t_ns)
    chase.run(1.5)
    end = _state(chase.truth, chase.t_ns)
    assert np.linalg.norm(end.p_world - start.p_world) < 6.0
    assert np.linalg.norm(end.accel_world) < 0.1
    age_ns = chase.truth.age_ns(chase.t_ns)
    assert age_ns is not None
    assert age_ns > 1_400_000_000


def test_nothing_is_known_before_the_first_message_and_garbage_changes_nothing() -> None:
    truth = Px4Truth(Px4TruthSettings())
    truth.receive(b"\xfd" * 500 + bytes(range(256)), 5)
    assert truth.state_at(10) is None
    assert truth.age_ns(10) is None


def test_a_restarted_simulator_begins_anew_without_raising() -> None:
    chase = Chase()
    chase.run(4.0)
    chase.publisher = HilStatePublisher(HilStateSettings(), boot_ns=chase.t_ns)
    chase.run(2.0)
    assert chase.truth.restarts == 1
    pairs = chase.run(0.5)
    assert np.linalg.norm(pairs[-1][0].p_world - pairs[-1][1].p_world) < 0.1


def test_the_clock_map_finds_a_slow_clock_behind_jitter() -> None:
    rng = np.random.default_rng(1)
    clock = ClockMap(0, 1_000_000_000)
    errors = []
    for index in range(1, 750):
        host_ns = 1_000_000_000 + index * 40_000_000
        arrival_ns = host_ns + round(3e6 * float(rng.standard_normal()))
        mapped_ns = clock.update(round(index * 40_000 * 0.993), arrival_ns)
        errors.append((mapped_ns - host_ns) * 1e-9)
    assert clock.rate == pytest.approx(0.993, abs=2e-4)
    assert max(abs(error) for error in errors[250:]) < 1.5e-3


def _state(truth: Px4Truth, t_ns: int) -> VehicleTruth:
    state = truth.state_at(t_ns)
    assert state is not None
    return state
