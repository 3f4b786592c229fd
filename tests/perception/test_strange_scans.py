"""Whatever a scan holds, tracker, neighbours and grid give a defined answer and stay within their bounds."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from companion.messages import FloatArray, Neighbours, NeighbourTracks, Odometry, RegisteredScan
from companion.perception.neighbours import NeighbourSettings, NeighbourView
from companion.perception.occupancy import GridSettings, ObstacleGrid
from companion.perception.tracking.settings import Tape, TrackingSettings
from companion.perception.tracking.tracker import NeighbourTracker
from tests.perception.tracking.bodies import SCAN_NS, SENSOR, Thing, Uav, odometry, scan

UAV = Uav((3.0, 0.5, 1.8), (0.2, 0.0, 0.0))
ABOVE = np.array([0.0, 0.0, 3.5])
RNG = np.random.default_rng(8)


def cloud(points: FloatArray, reflectivity: int = 255) -> RegisteredScan:
    """Return a scan of these points, measured evenly over its time."""
    ages = np.linspace(0.1e9, 0.0, len(points)).astype(np.int32)
    return RegisteredScan(
        0, 0, points.astype(np.float32), np.full(len(points), reflectivity, np.uint8), odometry(0), ages
    )


def shell(count: int, radius_m: float) -> FloatArray:
    directions = RNG.normal(size=(count, 3))
    return np.asarray(SENSOR + radius_m * directions / np.linalg.norm(directions, axis=1, keepdims=True))


def with_uav(change: str) -> RegisteredScan:
    """Return a scan of one UAV with something wrong about it."""
    seen = scan(1, [UAV], np.random.default_rng(1))
    points, ages, reflectivity = seen.points_map.copy(), seen.ages_ns.copy(), seen.reflectivity.copy()
    if change == "all retro":
        reflectivity[:] = 255
    if change == "not numbers":
        points[::3], points[1::3] = np.nan, np.inf
    if change == "minus infinity":
        points[::2, 2] = -np.inf
    if change == "huge numbers":
        points[::2] = 3e38
    if change == "ages reversed":
        ages = (SCAN_NS - ages).astype(np.int32)
    if change == "ages before and after":
        ages = np.where(np.arange(len(ages)) % 2, -2_000_000_000, 2_000_000_000).astype(np.int32)
    if change == "fewer ages than points":
        ages = ages[: len(ages) // 2]
    if change == "fewer reflectivities than points":
        reflectivity = reflectivity[: len(reflectivity) // 2]
    if change == "no pose":
        return replace(seen, odometry=odometry(SCAN_NS, p_map=np.full(3, np.nan)))
    if change == "no attitude":
        return replace(seen, odometry=odometry(SCAN_NS, q_map_body=np.full(4, np.nan)))
    return replace(seen, points_map=points, ages_ns=ages, reflectivity=reflectivity)


def strange_scans() -> dict[str, RegisteredScan]:
    changes = (
        "all retro", "not numbers", "minus infinity", "huge numbers", "ages reversed",
        "ages before and after", "fewer ages than points", "fewer reflectivities than points", "no pose",
        "no attitude",
    )  # fmt: skip
    clouds = {
        "no point": cloud(np.zeros((0, 3))),
        "one point": cloud(np.array([[2.0, 0.0, 1.5]])),
        "all at one place": cloud(np.full((20_000, 3), 2.0)),
        "all straight above": cloud(np.full((5_000, 3), ABOVE)),
        "all at the sensor": cloud(np.tile(SENSOR, (5_000, 1))),
        "retro shell": cloud(shell(20_000, 5.0)),
        "retro fog": cloud(shell(20_000, 1.0) * RNG.uniform(0.5, 3.0, (20_000, 1))),
        "many points": cloud(shell(120_000, 4.0)),
        "many dim points": cloud(shell(120_000, 4.0), 20),
        "only not numbers": cloud(np.full((20_000, 3), np.nan)),
    }
    return clouds | {f"uav, {change}": with_uav(change) for change in changes}


STRANGE = strange_scans()


def numbered(given: RegisteredScan, k: int) -> RegisteredScan:
    """Return a scan as the k-th one."""
    return replace(given, t_ns=k * SCAN_NS, sequence=k, odometry=replace(given.odometry, t_ns=k * SCAN_NS))


def is_defined(neighbours: Neighbours) -> bool:
    present = neighbours.states_heading[:, 6] == 1.0
    rest = neighbours.states_heading[~present]
    return bool(
        np.isfinite(neighbours.states_heading).all()
        and np.isfinite(neighbours.covariances_heading).all()
        and np.isfinite(neighbours.ages_s).all()
        and np.all((neighbours.track_ids >= 0) == present)
        and not rest.any()
    )


def check(tracks: NeighbourTracks, settings: TrackingSettings) -> None:
    assert len(tracks.tracks) <= settings.most_tracks
    assert len({track.track_id for track in tracks.tracks}) == len(tracks.tracks)
    for track in tracks.tracks:
        assert np.isfinite(track.p_map).all()
        assert np.isfinite(track.v_map).all()
        assert np.linalg.eigvalsh(track.covariance).min() > 0.0
        assert 0.0 <= track.bright_share <= 1.0
        assert track.t_born_ns <= track.t_seen_ns <= tracks.t_ns


@pytest.mark.parametrize("tape", Tape)
@pytest.mark.parametrize("name", sorted(STRANGE))
def test_every_stage_has_a_defined_answer_before_among_and_after_good_scans(name: str, tape: Tape) -> None:
    settings = TrackingSettings(tape=tape)
    tracker, view, grid = NeighbourTracker(settings), NeighbourView(NeighbourSettings()), ObstacleGrid(GRID)
    rng = np.random.default_rng(2)
    for k in range(1, 13):
        strange = k in (1, 2, 7, 8)
        given = numbered(STRANGE[name], k) if strange else scan(k, [UAV], rng)
        tracks = tracker.observe(given)
        check(tracks, settings)
        view.observe(tracks, given.odometry)
        for late_ns in (0, 50_000_000, 400_000_000):
            assert is_defined(view.at(given.odometry, k * SCAN_NS + late_ns))
        cells = grid.of(given, tracks)
        assert cells.shape == (2, 72, 12)
        assert np.isfinite(cells).all()
        assert cells.min() >= 0.0
        assert cells.max() <= 1.0


GRID = GridSettings()


@pytest.mark.parametrize("name", sorted(STRANGE))
def test_a_known_uav_survives_two_strange_scans(name: str) -> None:
    tracker = NeighbourTracker(TrackingSettings())
    rng = np.random.default_rng(3)
    for k in range(1, 31):
        tracks = tracker.observe(
            numbered(STRANGE[name], k) if k in (21, 22) else scan(k, [UAV], rng),
        )
    near = [t for t in tracks.tracks if t.validated and np.linalg.norm(t.p_map - UAV.at(3.0)) < 0.3]
    assert len(near) == 1


@pytest.mark.parametrize("name", ["retro shell", "retro fog", "all at one place", "all straight above"])
def test_a_world_of_tape_holds_no_uav(name: str) -> None:
    tracker = NeighbourTracker(TrackingSettings())
    for k in range(1, 16):
        tracks = tracker.observe(numbered(STRANGE[name], k))
        assert not any(track.validated for track in tracks.tracks)


def test_memory_is_bounded_by_the_points_of_a_scan_and_does_not_grow() -> None:
    tracker, grid = NeighbourTracker(TrackingSettings()), ObstacleGrid(GRID)
    large = cloud(shell(400_000, 4.0))
    tracemalloc.start()
    try:
        peaks = []
        for k in range(1, 13):
            tracemalloc.reset_peak()
            grid.of(numbered(large, k), tracker.observe(numbered(large, k)))
            peaks.append(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    assert max(peaks) < 100e6
    assert max(peaks[6:]) < 1.1 * max(peaks[:6])


def test_scans_in_reverse_order_change_nothing_after_the_first() -> None:
    tracker = NeighbourTracker(TrackingSettings())
    rng = np.random.default_rng(4)
    scans = [scan(k, [UAV], rng) for k in range(1, 11)]
    for given in scans:
        forward = tracker.observe(given)
    for given in reversed(scans):
        back = tracker.observe(given)
        assert back.t_ns == forward.t_ns
        assert [track.track_id for track in back.tracks] == [track.track_id for track in forward.tracks]
        np.testing.assert_array_equal(back.tracks[0].p_map, forward.tracks[0].p_map)


def test_nobody_there_is_nobody_seen() -> None:
    tracker, view = NeighbourTracker(TrackingSettings()), NeighbourView(NeighbourSettings())
    wall = np.column_stack([np.full(3000, 4.0), RNG.uniform(-5.0, 5.0, 3000), RNG.uniform(0.0, 4.0, 3000)])
    for k in range(1, 21):
        tracks = tracker.observe(numbered(cloud(wall, 30), k))
        view.observe(tracks, odometry(k * SCAN_NS))
        assert not tracks.tracks
    assert not view.at(odometry(20 * SCAN_NS), 20 * SCAN_NS).states_heading.any()


def test_of_twenty_neighbours_the_nearest_six_are_passed_on_and_none_is_an_obstacle() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
    radii = 3.0 + 0.17 * np.arange(20)
    uavs: list[Thing] = [
        Uav((float(r * np.cos(a)), float(r * np.sin(a)), 1.8)) for r, a in zip(radii, angles, strict=True)
    ]
    tracker, view = NeighbourTracker(TrackingSettings()), NeighbourView(NeighbourSettings(count=6))
    rng = np.random.default_rng(5)
    for k in range(1, 26):
        seen = scan(k, uavs, rng)
        tracks = tracker.observe(seen)
        view.observe(tracks, seen.odometry)
    found = view.at(seen.odometry, 25 * SCAN_NS)
    distances = np.linalg.norm(found.states_heading[:, :3], axis=1)
    assert found.states_heading[:, 6].all()
    assert np.all(np.diff(distances) > 0.0)
    expected = np.hypot(radii[:6], 0.3)
    np.testing.assert_allclose(distances, expected, atol=0.15)
    assert not ObstacleGrid(GRID).of(seen, tracks).any()
    assert ObstacleGrid(GRID).of(seen).any()


def view_of_one(**changes: object) -> tuple[NeighbourView, Odometry]:
    tracker, view = NeighbourTracker(TrackingSettings()), NeighbourView(NeighbourSettings())
    rng = np.random.default_rng(6)
    for k in range(1, 16):
        tracks = tracker.observe(scan(k, [UAV], rng))
    view.observe(tracks, odometry(15 * SCAN_NS))
    assert view.at(odometry(15 * SCAN_NS), 15 * SCAN_NS).states_heading[0, 6] == 1.0
    return view, odometry(15 * SCAN_NS, **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"p_map": np.full(3, np.nan)},
        {"v_map": np.array([np.inf, 0.0, 0.0])},
        {"q_map_body": np.full(4, np.nan)},
        {"omega_body": np.full(3, np.nan)},
        {"covariance_velocity": np.full((3, 3), np.nan)},
    ],
    ids=["position", "velocity", "attitude", "rate", "covariance"],
)
def test_who_does_not_know_where_he_is_sees_nobody(changes: dict[str, object]) -> None:
    view, lost = view_of_one(**changes)
    found = view.at(lost, 15 * SCAN_NS)
    assert is_defined(found)
    assert not found.states_heading.any()


def test_nobody_is_seen_in_another_map_than_he_was_seen_in() -> None:
    view, elsewhere = view_of_one(reset_counter=1)
    assert not view.at(elsewhere, 15 * SCAN_NS).states_heading.any()


def test_the_grid_of_an_unknown_place_is_empty() -> None:
    seen = cloud(shell(2_000, 4.0))
    for changes in ({"p_map": np.full(3, np.nan)}, {"q_map_body": np.full(4, np.nan)}):
        assert not ObstacleGrid(GRID).of(replace(seen, odometry=odometry(0, **changes))).any()


def test_a_grid_without_height_or_depth_is_refused() -> None:
    with pytest.raises(ValueError, match="lowest_elevation_deg"):
        GridSettings(lowest_elevation_deg=30.0, highest_elevation_deg=30.0)
    with pytest.raises(ValueError, match="min_range_m"):
        GridSettings(min_range_m=2.0, max_range_m=1.0)


def test_the_heading_of_the_grid_may_be_any_number_of_turns() -> None:
    seen, grid = cloud(shell(2_000, 4.0)), ObstacleGrid(GRID)
    once = grid.ranges(seen, None, SENSOR, 0.3)
    assert np.isfinite(once).mean() > 0.5
    # Points on the edge of a cell may fall to either side.
    assert np.mean(once == grid.ranges(seen, None, SENSOR, 0.3 + 200.0 * np.pi)) > 0.97
