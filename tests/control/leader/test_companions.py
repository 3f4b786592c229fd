"""Followers are not obstacles to the leader; whatever is not proved to be one is."""

from dataclasses import replace

import numpy as np

from companion.control.leader.companions import without_companions
from companion.messages import FloatArray, NeighbourTrack, NeighbourTracks
from tests.control.leader.flight import odometry_at, scan_of

FOLLOWER = NeighbourTrack(
    track_id=1,
    p_map=np.array([3.0, 0.0, 1.5]),
    v_map=np.array([2.0, 0.0, 0.0]),
    covariance=np.eye(6),
    t_born_ns=0,
    t_seen_ns=0,
    points=10,
    bright_share=0.5,
    validated=True,
)


def tracks(*found: NeighbourTrack) -> NeighbourTracks:
    return NeighbourTracks(0, 0, found)


def left(points: FloatArray, ages_ns: list[int], *found: NeighbourTrack) -> list[list[float]]:
    scan = replace(scan_of(points, odometry_at(0, np.zeros(3))), ages_ns=np.array(ages_ns, np.int32))
    rest = without_companions(scan, tracks(*found), 0.3)
    assert len(rest.points_map) == len(rest.reflectivity) == len(rest.ages_ns)
    return [[round(float(value), 3) for value in point] for point in rest.points_map]


def test_a_followers_points_are_left_out_and_a_pillars_stay() -> None:
    assert left(np.array([[3.1, 0.0, 1.5], [3.0, 1.0, 1.5]]), [0, 0], FOLLOWER) == [[3.0, 1.0, 1.5]]


def test_a_moving_follower_is_looked_for_where_it_was_when_its_points_were_measured() -> None:
    where_it_was = np.array([[2.8, 0.29, 1.5], [2.8, 0.29, 1.5]])
    assert left(where_it_was, [100_000_000, 0], FOLLOWER) == [[2.8, 0.29, 1.5]]


def test_a_body_that_is_not_proved_to_be_a_follower_is_an_obstacle() -> None:
    candidate = replace(FOLLOWER, validated=False)
    assert left(np.array([[3.1, 0.0, 1.5]]), [0], candidate) == [[3.1, 0.0, 1.5]]


def test_without_followers_a_scan_passes_untouched() -> None:
    scan = scan_of(np.ones((3, 3)), odometry_at(0, np.zeros(3)))
    assert without_companions(scan, None, 0.3) is scan
    assert without_companions(scan, tracks(), 0.3) is scan
