"""The obstacle grid against a slow oracle, and what is left out of it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import rotation
from companion.messages import NeighbourTrack, NeighbourTracks, Odometry, OdometryStatus, RegisteredScan
from companion.perception.occupancy import GridSettings, ObstacleGrid, decode, encode

SETTINGS = GridSettings()
SCAN_NS = 100_000_000


def scan_of(
    points_map: np.ndarray, *, yaw: float = 0.0, roll: float = 0.0, ages_ns: np.ndarray | None = None
) -> RegisteredScan:
    q = rotation.multiply(rotation.from_yaw(yaw), rotation.exp([roll, 0.0, 0.0]))
    odometry = Odometry(
        t_ns=SCAN_NS,
        t_sensor_ns=SCAN_NS,
        p_map=np.array([1.0, -2.0, 1.5]),
        q_map_body=q,
        v_map=np.zeros(3),
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6),
        covariance_velocity=np.eye(3),
        quality=100,
        reset_counter=0,
        status=OdometryStatus.TRACKING,
    )
    points = np.asarray(points_map, dtype=np.float32).reshape(-1, 3)
    ages = np.zeros(len(points), np.int32) if ages_ns is None else ages_ns.astype(np.int32)
    return RegisteredScan(SCAN_NS, 1, points, np.full(len(points), 50, np.uint8), odometry, ages)


def track_at(p_map: list[float], v_map: list[float], *, validated: bool = True) -> NeighbourTracks:
    track = NeighbourTrack(
        track_id=3,
        p_map=np.array(p_map),
        v_map=np.array(v_map),
        covariance=np.eye(6) * 1e-3,
        t_born_ns=0,
        t_seen_ns=SCAN_NS,
        points=9,
        bright_share=0.5,
        validated=validated,
    )
    return NeighbourTracks(SCAN_NS, 1, (track,))


def oracle(scan: RegisteredScan) -> np.ndarray:
    """The grid's definition, one point at a time."""
    ranges = np.full((SETTINGS.azimuths, SETTINGS.elevations), np.inf)
    heading = rotation.from_yaw(-rotation.yaw_of(scan.odometry.q_map_body))
    low, high = np.radians([SETTINGS.lowest_elevation_deg, SETTINGS.highest_elevation_deg])
    for point in scan.points_map.astype(np.float64):
        if not np.isfinite(point).all() or point[2] < SETTINGS.min_height_m:
            continue
        x, y, z = rotation.rotate(heading, point - scan.odometry.p_map)
        distance = float(np.linalg.norm([x, y, z]))
        elevation = np.arctan2(z, np.hypot(x, y))
        if not SETTINGS.min_range_m <= distance <= SETTINGS.max_range_m or not low <= elevation < high:
            continue
        column = int(np.degrees(np.arctan2(y, x)) % 360.0 // (360.0 / SETTINGS.azimuths))
        row = int((elevation - low) / (high - low) * SETTINGS.elevations)
        ranges[column, row] = min(ranges[column, row], distance)
    return ranges


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), yaw=st.floats(-3.1, 3.1), roll=st.floats(-0.4, 0.4))
def test_every_cell_holds_its_nearest_point(seed: int, yaw: float, roll: float) -> None:
    rng = np.random.default_rng(seed)
    points = np.add(rng.uniform(-9.0, 9.0, (200, 3)), [1.0, -2.0, 3.0])
    points[::50] = np.nan
    scan = scan_of(points, yaw=yaw, roll=roll)
    found = ObstacleGrid(SETTINGS).of(scan)
    expected = encode(oracle(scan), SETTINGS.max_range_m)
    # A point within a rounding error of an edge may fall to either side.
    assert np.count_nonzero(np.abs(found - expected).max(axis=0) > 1e-6) <= 2


def test_the_grid_is_level_and_turns_with_the_heading_only() -> None:
    ahead = [[1.0, 1.0, 1.6]]  # 3 m to the left of the body along y
    turned = scan_of(np.array(ahead), yaw=np.pi / 2, roll=0.5)
    grid = ObstacleGrid(SETTINGS).of(turned)
    (column,), (row,) = np.nonzero(grid[1])
    assert column in (0, SETTINGS.azimuths - 1)
    assert row == int((np.degrees(np.arctan2(0.1, 3.0)) + 7.0) / 59.0 * 12)
    assert grid[0, column, row] == pytest.approx(1.0 - np.hypot(3.0, 0.1) / 10.0, abs=1e-6)


@pytest.mark.parametrize(
    "point",
    [[1.1, -2.0, 1.6], [1.0, 9.0, 1.5], [3.0, -2.0, 0.25], [1.0, -2.0, 6.0], [np.nan, 0.0, 1.0]],
    ids=["own body", "too far", "ground", "overhead", "not a number"],
)
def test_what_does_not_concern_the_flight_is_left_out(point: list[float]) -> None:
    assert not ObstacleGrid(SETTINGS).of(scan_of(np.array([point]))).any()


def test_a_validated_neighbour_is_no_obstacle_even_where_it_was_when_its_points_were_measured() -> None:
    body = np.array([[4.0, -2.0, 1.5], [3.81, -2.0, 1.5]])
    ages_ns = np.array([0, 95_000_000])
    tracks = track_at([4.0, -2.0, 1.5], [2.0, 0.0, 0.0])
    narrow = ObstacleGrid(GridSettings(neighbour_radius_m=0.1))
    assert not narrow.of(scan_of(body, ages_ns=ages_ns), tracks).any()
    assert narrow.of(scan_of(body, ages_ns=np.zeros(2)), tracks)[1].sum() == 1


def test_a_body_that_is_not_validated_stays_an_obstacle() -> None:
    body = np.array([[4.0, -2.0, 1.5]])
    candidate = track_at([4.0, -2.0, 1.5], [0.0, 0.0, 0.0], validated=False)
    assert ObstacleGrid(SETTINGS).of(scan_of(body), candidate)[1].sum() == 1


def test_an_empty_scan_gives_an_empty_grid() -> None:
    assert ObstacleGrid(SETTINGS).of(scan_of(np.zeros((0, 3)))).shape == (2, 72, 12)
    assert not ObstacleGrid(SETTINGS).of(scan_of(np.zeros((0, 3)))).any()


def test_ranges_survive_encoding() -> None:
    ranges = np.array([[0.25, 9.9], [np.inf, 12.0]])
    back = decode(encode(ranges, 10.0), 10.0)
    assert np.allclose(back[0], ranges[0], atol=1e-5)
    assert np.isinf(back[1]).all()
