"""Which neighbours a controller sees, where, and for how long."""

from dataclasses import replace

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import NeighbourTrack, NeighbourTracks, Odometry, OdometryStatus
from companion.perception.neighbours import NeighbourSettings, NeighbourView, moved, nearest

SCAN_NS = 10_000_000_000
MS = 1_000_000
EGO = Odometry(
    t_ns=SCAN_NS,
    t_sensor_ns=SCAN_NS,
    p_map=np.array([5.0, 5.0, 2.0]),
    q_map_body=rotation.from_yaw(np.pi / 2),
    v_map=np.array([0.0, 1.0, 0.0]),
    omega_body=np.zeros(3),
    covariance_pose=np.eye(6),
    covariance_velocity=np.diag([0.01, 0.02, 0.03]),
    quality=100,
    reset_counter=0,
    status=OdometryStatus.TRACKING,
)


def track(
    track_id: int,
    p_map: tuple[float, float, float],
    v_map: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    seen_ns: int = SCAN_NS,
    validated: bool = True,
) -> NeighbourTrack:
    return NeighbourTrack(
        track_id=track_id,
        p_map=np.array(p_map),
        v_map=np.array(v_map),
        covariance=np.diag([1e-4, 2e-4, 3e-4, 1e-2, 2e-2, 3e-2]),
        t_born_ns=0,
        t_seen_ns=seen_ns,
        points=10,
        bright_share=0.4,
        validated=validated,
    )


def view_of(*tracks: NeighbourTrack, **settings: object) -> NeighbourView:
    view = NeighbourView(NeighbourSettings(**settings))  # type: ignore[arg-type]
    view.observe(NeighbourTracks(SCAN_NS, 1, tracks), EGO)
    return view


def test_positions_and_velocities_are_relative_and_in_the_heading_frame() -> None:
    found = view_of(track(7, (5.0, 8.0, 2.5), (0.0, 1.5, 0.0))).at(EGO, SCAN_NS)
    assert found.track_ids.tolist() == [7] + [-1] * 11
    assert found.states_heading[0] == pytest.approx([3.0, 0.0, 0.5, 0.5, 0.0, 0.0, 1.0])
    assert not found.states_heading[1:].any()


def test_the_nearest_come_first_and_the_rest_is_left_out() -> None:
    tracks = [track(n, (5.0 + n, 5.0, 2.0)) for n in range(9, 0, -1)]
    found = view_of(*tracks, count=4).at(EGO, SCAN_NS)
    assert found.track_ids.tolist() == [1, 2, 3, 4]


def test_candidates_are_not_seen_and_neighbours_unseen_for_long_neither() -> None:
    tracks = track(1, (6, 5, 2), validated=False), track(2, (7, 5, 2), seen_ns=SCAN_NS - 1950 * MS)
    view = view_of(*tracks)
    soon, late = view.at(EGO, SCAN_NS + 40 * MS), view.at(EGO, SCAN_NS + 60 * MS)
    assert soon.track_ids.tolist()[:2] == [2, -1]
    assert soon.ages_s[0] == pytest.approx(1.99)
    assert late.track_ids.tolist()[0] == -1


def test_both_are_carried_on_to_now() -> None:
    later = replace(EGO, t_ns=SCAN_NS + 50 * MS, p_map=EGO.p_map + 0.05 * EGO.v_map)
    found = view_of(track(1, (5.0, 8.0, 2.0), (0.0, -1.0, 0.0))).at(later, SCAN_NS + 200 * MS)
    assert found.t_ns == SCAN_NS + 200 * MS
    assert found.states_heading[0, :3] == pytest.approx([3.0 - 0.2 - 0.2, 0.0, 0.0])


def test_without_compensation_everything_is_as_it_was_when_the_scan_ended() -> None:
    later = replace(EGO, t_ns=SCAN_NS + 150 * MS, p_map=np.add(EGO.p_map, [1.0, 1.0, 0.0]))
    view = view_of(track(1, (5.0, 8.0, 2.0), (0.0, -1.0, 0.0)), compensate_latency=False)
    found = view.at(later, SCAN_NS + 200 * MS)
    assert found.t_ns == SCAN_NS
    assert found.states_heading[0] == pytest.approx([3.0, 0.0, 0.0, -2.0, 0.0, 0.0, 1.0])


def test_the_covariance_turns_with_the_heading_and_grows_with_time() -> None:
    view = view_of(track(1, (5.0, 8.0, 2.0)))
    now = view.at(EGO, SCAN_NS).covariances_heading[0]
    assert np.diag(now)[:3] == pytest.approx([2e-4, 1e-4, 3e-4])
    assert np.diag(now)[3:] == pytest.approx([0.04, 0.02, 0.06])
    later = view.at(EGO, SCAN_NS + 200 * MS).covariances_heading[0]
    assert later[0, 0] == pytest.approx(2e-4 + 0.04 * 2e-2)


def test_a_turning_body_sees_its_neighbours_turn() -> None:
    turning = replace(EGO, omega_body=np.array([0.0, 0.0, 1.0]))
    found = nearest([track(1, (5.0, 8.0, 2.0))], turning, SCAN_NS + 100 * MS, SCAN_NS, 1)
    assert np.arctan2(found.states_heading[0, 1], found.states_heading[0, 0]) == pytest.approx(-0.1)


def test_nobody_gives_zeros() -> None:
    found = NeighbourView(NeighbourSettings()).at(EGO, SCAN_NS)
    assert found.track_ids.tolist() == [-1] * 12
    assert not found.states_heading.any()


def test_carrying_on_is_additive() -> None:
    start = track(1, (0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    once, twice = moved(start, 300 * MS), moved(moved(start, 100 * MS), 200 * MS)
    assert np.allclose(once.p_map, twice.p_map)
    assert np.allclose(once.covariance, twice.covariance)
