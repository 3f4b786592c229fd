"""What the published covariance says over a whole flight."""

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray, ImuSample, LidarScan, Odometry
from tests.perception.odometry.conftest import SMALL, Outcome, errors, run
from tests.perception.odometry.simulated_flight import (
    SimulatedFlight,
    Trajectory,
    World,
    hover_trajectory,
    pillar_field,
    room,
)

Events = list[ImuSample | LidarScan]


def _inherited_mm(outcome: Outcome) -> float:
    """Standard deviation of where the map puts the present place, against the start."""
    state = outcome.lio.state
    assert state is not None
    x, y, z = state.p_map
    place = np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
    return 1e3 * float(np.sqrt(np.trace(place @ outcome.lio.anchor.covariance @ place.T)))


def _sigmas(odometry: Odometry) -> FloatArray:
    return np.asarray(np.sqrt(np.diagonal(odometry.covariance_pose)))


def test_in_a_room_that_was_seen_from_the_start_certainty_does_not_fade() -> None:
    flight = SimulatedFlight(room(), hover_trajectory(9.0), seed=4)
    outcome = run(list(flight.events()))
    assert _inherited_mm(outcome) < 0.5
    third, last = outcome.tracked[len(outcome.tracked) // 3], outcome.tracked[-1]
    assert float(_sigmas(last)[:3].max()) < 1.5 * float(_sigmas(third)[:3].max())


def test_new_ground_makes_the_map_less_certain_the_farther_it_goes() -> None:
    knots = np.arange(0.0, 13.0, 0.1)
    u = np.clip((knots - 3.0) / 3.0, 0.0, 1.0)
    ramp = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    way = 0.1 * np.cumsum(2.0 * ramp)
    p_world = np.stack([-10.0 + way, np.full_like(knots, 0.5), 0.2 + 1.5 * ramp], axis=1)
    pillars = pillar_field(np.random.default_rng(8), 60).pillars
    world = World(pillars=pillars[np.abs(pillars[:, 1] - 0.5) > 1.5])
    flight = SimulatedFlight(world, Trajectory(knots, p_world, np.zeros_like(knots)), seed=4)
    settings = SMALL.model_copy(update={"max_range_m": 20.0})
    whole = list(flight.events())
    grown = []
    for duration_s in (6.0, 12.0):
        events = [e for e in whole if _time_s(e) < duration_s]
        outcome = run(events, settings)
        assert outcome.lio.anchor.periods > 1
        grown.append(_inherited_mm(outcome))
    assert grown[1] > 1.5 * grown[0] > 0.0


def _time_s(event: ImuSample | LidarScan) -> float:
    return 1e-9 * (event.t_sensor_ns if isinstance(event, ImuSample) else event.t_sensor_end_ns)


def test_the_lean_of_the_map_is_admitted_and_weighs_with_the_distance(
    room_flight: SimulatedFlight, room_events: Events
) -> None:
    outcome = run(room_events)
    tilts = np.degrees([_sigmas(entry)[3:5].max() for entry in outcome.tracked])
    assert tilts.min() > 0.25
    assert tilts.max() < 0.4
    _, q, _, q_true = errors(room_flight, outcome.tracked)
    lean = np.degrees(rotation.log(rotation.multiply(q, rotation.conjugate(q_true)))[:, :2])
    assert np.mean(np.abs(lean).max(axis=1) < 3.0 * tilts) > 0.95
    for entry in outcome.tracked[::50]:
        distance_m = float(np.linalg.norm(entry.p_map[:2]))
        assert float(_sigmas(entry)[2]) >= distance_m * float(np.radians(0.25))
