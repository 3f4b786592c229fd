import numpy as np
import pytest

from companion.messages import NeighbourTrack, NeighbourTracks, OdometryStatus, RegisteredScan
from companion.perception.tracking.settings import Tape, TrackingSettings
from companion.perception.tracking.tracker import NeighbourTracker
from tests.perception.tracking.bodies import SENSOR, Post, Thing, Uav, odometry, scan


def follow(
    things: list[Thing], scans: int, tracker: NeighbourTracker | None = None, first: int = 1, seed: int = 1
) -> list[NeighbourTracks]:
    rng = np.random.default_rng(seed)
    tracker = tracker or NeighbourTracker(TrackingSettings())
    return [tracker.observe(scan(first + k, things, rng)) for k in range(scans)]


def validated(tracks: NeighbourTracks) -> list[NeighbourTrack]:
    return [track for track in tracks.tracks if track.validated]


def test_a_hovering_uav_is_validated_and_its_centre_not_its_near_side_is_reported() -> None:
    uav = Uav((4.0, 1.0, 1.8))
    late = follow([uav], 40)[10:]
    errors = []
    for tracks in late:
        (track,) = validated(tracks)
        errors.append(track.p_map - uav.at(0.0))
    assert len({validated(tracks)[0].track_id for tracks in late}) == 1
    assert np.sqrt(np.mean(np.square(np.linalg.norm(errors, axis=1)))) < 0.05
    towards_sensor = (SENSOR - uav.at(0.0)) / np.linalg.norm(SENSOR - uav.at(0.0))
    assert abs(float(np.mean(errors, axis=0) @ towards_sensor)) < 0.02


def test_a_uav_at_ten_metres_is_followed_on_a_point_or_two_a_scan() -> None:
    results = follow([Uav((9.9, 0.0, 2.4))], 100)
    assert np.mean([bool(validated(tracks)) for tracks in results[30:]]) > 0.97


def test_a_passing_uav_has_its_velocity_and_is_where_it_is_at_the_end_of_the_scan() -> None:
    uav = Uav((3.5, -4.0, 1.8), (0.0, 2.0, 0.0))
    errors = [
        [*(track.p_map - uav.at(0.1 * number)), *(track.v_map - [0.0, 2.0, 0.0])]
        for number, tracks in enumerate(follow([uav], 40), start=1)
        for track in validated(tracks)
    ]
    assert len(errors) > 34
    settled = np.array(errors[8:])
    assert np.sqrt(np.mean(np.sum(settled[:, :3] ** 2, axis=1))) < 0.05
    assert np.sqrt(np.mean(np.sum(settled[:, 3:] ** 2, axis=1))) < 0.2
    # A centre late by half a scan would be 0.1 m behind.
    assert abs(settled[:, 1].mean()) < 0.02


def test_tape_on_a_post_is_never_taken_for_a_uav() -> None:
    for seed in range(3):
        for distance in (2.5, 4.0, 6.0, 8.0):
            results = follow([Post(distance, 0.5)], 60, seed=seed)
            assert not any(validated(tracks) for tracks in results)


def test_two_uavs_that_pass_each_other_keep_their_numbers() -> None:
    there, back = Uav((4.0, -2.0, 1.7), (0.0, 1.0, 0.0)), Uav((4.6, 2.0, 1.9), (0.0, -1.0, 0.0))
    results = follow([there, back], 40)

    def number_of(tracks: NeighbourTracks, uav: Uav, t_s: float) -> int:
        return min(
            validated(tracks), key=lambda track: float(np.linalg.norm(track.p_map - uav.at(t_s)))
        ).track_id

    before = [number_of(results[9], uav, 1.0) for uav in (there, back)]
    after = [number_of(results[39], uav, 4.0) for uav in (there, back)]
    assert before == after
    assert len(set(before)) == 2


def test_an_occluded_uav_coasts_becomes_last_seen_and_is_found_again() -> None:
    uav = Uav((4.0, -2.0, 1.8), (0.0, 0.5, 0.0))
    tracker = NeighbourTracker(TrackingSettings())
    number = validated(follow([uav], 20, tracker)[-1])[0].track_id
    hidden = follow([], 15, tracker, first=21)
    for tracks in hidden:
        (track,) = tracks.tracks
        assert track.track_id == number
        assert track.t_seen_ns == 20 * 100_000_000
    assert np.linalg.norm(validated(hidden[1])[0].p_map - uav.at(2.2)) < 0.2
    # Where it is after half a second nobody knows: nobody may rely on it.
    assert not any(validated(tracks) for tracks in hidden[5:])
    again = follow([uav], 10, tracker, first=36)
    assert [track.track_id for track in validated(again[-1])] == [number]


def test_one_who_comes_back_with_its_tape_out_of_sight_is_known_at_once() -> None:
    dim = Uav((4.0, -2.0, 1.8), (0.0, 0.5, 0.0), bright_share=0.0)
    for away, known in ((10, True), (25, True), (35, False)):
        tracker = NeighbourTracker(TrackingSettings())
        number = validated(follow([Uav(dim.p_map, dim.v_map)], 20, tracker)[-1])[0].track_id
        follow([], away, tracker, first=21)
        again = follow([dim], 5, tracker, first=21 + away)
        expected = [number] if known else []
        assert [[track.track_id for track in validated(tracks)] for tracks in again] == [expected] * 5
        for tracks in again:
            for track in validated(tracks):
                assert np.linalg.norm(track.p_map - dim.at(1e-9 * tracks.t_ns)) < 0.15


def test_what_never_wore_tape_is_not_known_where_nobody_was_lost() -> None:
    tracker = NeighbourTracker(TrackingSettings())
    follow([Uav((4.0, -2.0, 1.8), (0.0, 0.5, 0.0))], 20, tracker)
    for tracks in follow([Uav((4.0, 1.5, 1.8), bright_share=0.0)], 20, tracker, first=21):
        assert not any(track.p_map[1] > 0.5 for track in tracks.tracks if track.t_seen_ns == tracks.t_ns)


def test_one_who_sinks_below_the_field_of_view_is_relied_on_longer_than_one_who_vanishes() -> None:
    relied_on = {}
    for z in (1.45, 2.2):
        tracker = NeighbourTracker(TrackingSettings())
        uav = Uav((1.5, -0.9, z), (0.0, 0.3, 0.0))
        assert validated(follow([uav], 20, tracker)[-1])
        relied = [len(validated(tracks)) for tracks in follow([], 22, tracker, first=21)]
        assert relied == sorted(relied, reverse=True)
        relied_on[z] = sum(relied)
    assert 0 < relied_on[2.2] <= 5
    assert 10 <= relied_on[1.45] <= 20


def test_one_who_comes_back_elsewhere_has_the_old_number_once_it_has_proved_itself() -> None:
    tracker = NeighbourTracker(TrackingSettings())
    before = Uav((4.0, -2.0, 1.8), (0.0, 0.5, 0.0))
    number = validated(follow([before], 20, tracker)[-1])[0].track_id
    follow([], 30, tracker, first=21)
    after = follow([Uav((3.0, 2.5, 1.8))], 10, tracker, first=51)
    assert after[0].tracks[-1].track_id != number
    assert {track.track_id for tracks in after for track in validated(tracks)} == {number}
    assert [track.track_id for track in after[-1].tracks] == [number]


def test_a_post_near_where_one_was_lost_does_not_take_its_number() -> None:
    tracker = NeighbourTracker(TrackingSettings())
    number = validated(follow([Uav((4.0, -1.0, 1.8), (0.0, 0.5, 0.0))], 20, tracker)[-1])[0].track_id
    behind = follow([Post(3.6, 0.9)], 25, tracker, first=21)
    assert sum(len(validated(tracks)) for tracks in behind[5:]) <= 1
    again = follow([Uav((4.0, 2.2, 1.8), (0.0, 0.5, 0.0)), Post(3.6, 0.9)], 10, tracker, first=46)
    assert [track.track_id for track in validated(again[-1])] == [number]


def test_one_who_rushes_past_is_known_from_the_streak_it_leaves() -> None:
    uav = Uav((1.2, -2.4, 1.6), (0.0, 5.0, 0.0))
    results = follow([uav], 10)
    found = [bool(validated(tracks)) for tracks in results]
    assert all(found[4:])
    (track,) = validated(results[-1])
    assert np.linalg.norm(track.p_map - uav.at(1.0)) < 0.1
    assert np.linalg.norm(track.v_map - uav.v_map) < 0.5


def test_a_fast_uav_whose_tape_is_out_of_sight_is_still_followed_by_its_dim_parts() -> None:
    tracker = NeighbourTracker(TrackingSettings())
    follow([Uav((2.5, -3.0, 1.7), (0.0, 3.0, 0.0))], 10, tracker)
    dim = Uav((2.5, -3.0, 1.7), (0.0, 3.0, 0.0), bright_share=0.0)
    for number, tracks in enumerate(follow([dim], 6, tracker, first=11), start=11):
        (track,) = validated(tracks)
        assert track.t_seen_ns == number * 100_000_000


def test_an_unobserved_track_dies_after_its_time() -> None:
    tracker = NeighbourTracker(TrackingSettings(last_seen_s=0.0))
    assert validated(follow([Uav((3.0, 0.0, 1.6))], 20, tracker)[-1])
    silent = follow([], 7, tracker, first=21)
    assert [len(tracks.tracks) for tracks in silent] == [1, 1, 1, 1, 1, 0, 0]


def test_covariance_is_true_for_what_moves_as_the_model_says() -> None:
    squares = []
    for seed in range(12):
        uav = Uav((3.0 + 0.3 * seed, -1.5, 1.8), (0.1, 0.8, 0.0))
        for number, tracks in enumerate(follow([uav], 30, seed=seed), start=1):
            for track in validated(tracks) if number % 6 == 0 else []:
                e = track.p_map - uav.at(0.1 * number)
                squares.append(e @ np.linalg.solve(track.covariance[:3, :3], e) / 3.0)
    # The settings leave room for rotors, legs and manoeuvres, which these bodies do not have.
    assert 0.15 < np.mean(squares) < 1.3


def test_a_jump_of_the_map_drops_all_tracks() -> None:
    tracker = NeighbourTracker(TrackingSettings())
    uav, rng = Uav((3.0, 0.0, 1.6)), np.random.default_rng(1)
    assert follow([uav], 20, tracker)[-1].tracks
    jumped = tracker.observe(scan(21, [], rng, odometry(21 * 100_000_000, reset_counter=1)))
    assert jumped.tracks == ()


@pytest.mark.parametrize("status", [OdometryStatus.LOST, OdometryStatus.INITIALISING])
def test_without_odometry_tracks_are_carried_on_unobserved(status: OdometryStatus) -> None:
    tracker = NeighbourTracker(TrackingSettings())
    uav, rng = Uav((3.0, 0.0, 1.6)), np.random.default_rng(1)
    follow([uav], 20, tracker)
    blind = tracker.observe(scan(21, [uav], rng, odometry(21 * 100_000_000, status=status)))
    assert [track.t_seen_ns for track in validated(blind)] == [20 * 100_000_000]


def test_degraded_odometry_widens_the_covariance() -> None:
    variances = []
    for status in (OdometryStatus.TRACKING, OdometryStatus.DEGRADED):
        tracker, rng = NeighbourTracker(TrackingSettings()), np.random.default_rng(1)
        for k in range(1, 20):
            own = odometry(k * 100_000_000, status=status)
            tracks = tracker.observe(scan(k, [Uav((6.0, 0.0, 1.8))], rng, own))
        variances.append(np.trace(tracks.tracks[0].covariance[:3, :3]))
    assert variances[1] > 1.1 * variances[0]


def strange_scans() -> dict[str, RegisteredScan]:
    rng = np.random.default_rng(3)
    empty = scan(1, [], rng)
    holes = scan(1, [Uav((3.0, 0.0, 1.6))], rng)
    holes.points_map[::2] = np.nan
    holes.points_map[1::4] = np.inf
    wall = rng.uniform((3.0, -6.0, 0.0), (3.1, 6.0, 4.0), (20_000, 3)).astype(np.float32)
    shell = rng.normal(size=(20_000, 3))
    shell = (SENSOR + 5.0 * shell / np.linalg.norm(shell, axis=1, keepdims=True)).astype(np.float32)
    clouds = {"wall": wall, "shell": shell, "same": np.full((20_000, 3), 2.0, np.float32)}
    scans = {"empty": empty, "holes": holes}
    for name, points in clouds.items():
        bright = np.full(len(points), 255, np.uint8)
        ages = np.zeros(len(points), np.int32)
        scans[name] = RegisteredScan(1, 1, points, bright, odometry(100_000_000), ages)
    return scans


@pytest.mark.parametrize("name", sorted(strange_scans()))
def test_strange_scans_have_a_defined_answer(name: str) -> None:
    tracker, settings = NeighbourTracker(TrackingSettings()), TrackingSettings()
    given = strange_scans()[name]
    for k in range(1, 8):
        own = odometry(k * 100_000_000)
        tracks = tracker.observe(
            RegisteredScan(k, k, given.points_map, given.reflectivity, own, given.ages_ns)
        )
        assert len(tracks.tracks) <= settings.most_tracks
        assert all(np.isfinite(track.covariance).all() for track in tracks.tracks)
        if name != "holes":
            assert not validated(tracks)


def test_twenty_neighbours_are_all_found() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
    uavs: list[Thing] = [
        Uav((float(r * np.cos(a)), float(r * np.sin(a)), 1.8))
        for r, a in zip(np.resize([3.0, 4.5, 6.0], 20), angles, strict=True)
    ]
    assert len(validated(follow(uavs, 25)[-1])) == 20


def test_equal_scans_give_equal_tracks_and_an_old_scan_changes_nothing() -> None:
    things: list[Thing] = [Uav((3.0, 1.0, 1.7), (0.3, 0.0, 0.0)), Post(5.0, -1.0)]
    tracker = NeighbourTracker(TrackingSettings())
    first, second = follow(things, 20, tracker), follow(things, 20)
    for one, other in zip(first, second, strict=True):
        for a, b in zip(one.tracks, other.tracks, strict=True):
            assert a.track_id == b.track_id
            assert np.array_equal(a.covariance, b.covariance)
            assert np.array_equal(a.p_map, b.p_map)
    again = tracker.observe(scan(12, things, np.random.default_rng(9)))
    assert [track.track_id for track in again.tracks] == [track.track_id for track in first[-1].tracks]
    assert np.array_equal(again.tracks[0].p_map, first[-1].tracks[0].p_map)


def test_the_published_method_finds_near_uavs_and_believes_tape_on_a_post() -> None:
    tracker = NeighbourTracker(TrackingSettings.literal())
    results = follow([Uav((2.5, 0.0, 1.6)), Post(3.0, 3.0, width_m=0.2)], 20, tracker)
    places = [[track.p_map for track in validated(tracks)] for tracks in results[5:]]
    found = [any(np.linalg.norm(p - [2.5, 0.0, 1.6]) < 0.2 for p in now) for now in places]
    fooled = [any(np.linalg.norm(p[:2] - 3.0) < 0.3 for p in now) for now in places]
    assert np.mean(found) > 0.8
    assert np.mean(fooled) > 0.5


def test_without_tape_candidates_are_few_and_a_moving_body_is_still_found_among_them() -> None:
    settings = TrackingSettings(tape=Tape.NONE)
    tracker = NeighbourTracker(settings)
    uav = Uav((3.0, -2.0, 1.8), (0.0, 1.0, 0.0), bright_share=0.0)
    angles = np.linspace(0.4, 5.9, 40)
    litter: list[Thing] = [
        Uav((float(4.5 * np.cos(a)), float(4.5 * np.sin(a)), 1.7), bright_share=0.0) for a in angles
    ]
    results = follow([uav, *litter], 30, tracker)
    assert max(len(tracks.tracks) for tracks in results) <= settings.most_untaped
    (track,) = validated(results[-1])
    assert np.linalg.norm(track.p_map - uav.at(3.0)) < 0.15
