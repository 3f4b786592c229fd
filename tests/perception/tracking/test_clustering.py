import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.messages import FloatArray
from companion.perception.tracking import clustering_kernels as kernels
from companion.perception.tracking.clustering import (
    MOST_CLUSTERS,
    FilteredPoints,
    describe,
    epsilons,
    find_clusters,
    is_small,
    least_points,
    trim,
)
from companion.perception.tracking.filtering import rationed
from companion.perception.tracking.settings import TrackingSettings

SETTINGS = TrackingSettings()


def oracle(points: FloatArray, eps: FloatArray, core_points: int) -> list[int]:
    away = np.linalg.norm(points[:, None] - points, axis=2)
    near = away <= 0.5 * (eps[:, None] + eps)
    core = near.sum(axis=1) >= core_points
    labels = np.full(len(points), -1)
    names = 0
    for start in range(len(points)):
        if not core[start] or labels[start] >= 0:
            continue
        todo = [start]
        labels[start] = names
        while todo:
            new = np.flatnonzero(near[todo.pop()] & core & (labels < 0))
            labels[new] = names
            todo.extend(int(j) for j in new)
        names += 1
    cores = labels.copy()
    for i in np.flatnonzero(~core):
        around = np.flatnonzero(near[i] & core)
        if len(around):
            labels[i] = cores[around[np.argmin(away[i, around])]]
    return [int(label) for label in labels]


def partition(labels: list[int]) -> list[int]:
    names: dict[int, int] = {-1: -1}
    return [names.setdefault(label, len(names)) for label in labels]


@given(st.integers(0, 10_000), st.integers(0, 120), st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_density_clusters_agree_with_the_definition(seed: int, count: int, core_points: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-5.0, 5.0, (6, 3))[rng.integers(0, 6, count)] + rng.normal(0.0, 0.15, (count, 3))
    eps = rng.uniform(0.05, 0.2, count)
    labels = np.empty(count, np.int32)
    found = kernels.density_clusters(points, eps, core_points, labels)
    assert found == labels.max(initial=-1) + 1
    assert partition(labels.tolist()) == partition(oracle(points, eps, core_points))


def test_density_clusters_agree_with_open3d() -> None:
    o3d = pytest.importorskip("open3d")
    rng = np.random.default_rng(4)
    points = rng.uniform(-8.0, 8.0, (40, 3))[rng.integers(0, 40, 800)] + rng.uniform(-0.12, 0.12, (800, 3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    theirs = [int(label) for label in cloud.cluster_dbscan(0.1, 2)]
    labels = np.empty(800, np.int32)
    kernels.density_clusters(points, np.full(800, 0.1), 2, labels)
    assert partition(labels.tolist()) == partition(theirs)


def test_epsilon_and_least_points_follow_the_range() -> None:
    assert epsilons(np.array([1.0, 3.0, 10.0]), SETTINGS) == pytest.approx([0.1, 0.1, 0.18], abs=0.01)
    assert [least_points(r, SETTINGS) for r in (1.0, 3.0, 6.0, 12.0)] == [16, 16, 4, 2]


def filtered(
    moved: FloatArray, owners: list[int], bright: list[int] | None = None, tracks: int = 2
) -> FilteredPoints:
    count = len(moved)
    return FilteredPoints(
        measured_map=moved,
        moved_map=moved,
        ages_s=np.full(count, 0.05),
        fresh=np.ones(count, np.uint8),
        bright=np.array(bright or [1] * count, np.uint8),
        owners=np.array(owners, np.int32),
        tracks=tracks,
    )


def test_two_tracks_in_one_cluster_share_it_out() -> None:
    line = np.column_stack([np.arange(10) * 0.05 + 4.0, np.zeros(10), np.zeros(10)])
    labels = find_clusters(filtered(line, [0] * 5 + [1] * 5), np.zeros(3), SETTINGS)
    assert len(set(labels[:5])) == len(set(labels[5:])) == 1
    assert labels[0] != labels[9]


def test_scattered_points_of_one_track_are_one_cluster() -> None:
    far = np.array([[9.0, 0.0, 0.0], [9.0, 0.22, 0.05], [9.1, 0.1, -0.3], [9.0, 3.0, 0.0]])
    labels = find_clusters(filtered(far, [0, 0, 0, -1]), np.zeros(3), SETTINGS)
    assert labels[0] == labels[1] == labels[2] >= 0
    assert labels[3] == -1


def test_a_trusted_body_is_cut_out_of_what_it_touches_and_a_candidate_is_not() -> None:
    wall = np.column_stack([np.full(30, 4.1), np.linspace(-0.9, 0.9, 30), np.zeros(30)])
    body = np.array([[4.0, 0.0, 0.0], [4.0, 0.05, 0.0], [4.0, -0.05, 0.0]])
    points = filtered(np.vstack([wall, body]), [0] * 33, [0] * 30 + [1] * 3, tracks=1)
    for trusted in (True, False):
        labels = np.zeros(33, np.int32)
        trim(labels, points, np.array([trusted]), SETTINGS)
        small = [is_small(cluster, SETTINGS) for cluster in describe(labels, points, np.zeros(3))]
        assert small == [trusted]
        assert (labels[30:] == 0).all()


def test_a_cluster_tells_its_points_and_where_the_newest_were_measured() -> None:
    points = FilteredPoints(
        measured_map=np.array([[3.0, 0.0, 0.0], [3.2, 0.0, 0.0], [2.0, 0.0, 0.0]]),
        moved_map=np.array([[3.1, 0.0, 0.0], [3.3, 0.0, 0.0], [3.2, 0.1, 0.0]]),
        ages_s=np.array([0.02, 0.04, 0.15]),
        fresh=np.array([1, 1, 0], np.uint8),
        bright=np.array([1, 0, 1], np.uint8),
        owners=np.zeros(3, np.int32),
        tracks=1,
    )
    (cluster,) = describe(np.zeros(3, np.int32), points, np.zeros(3))
    assert (cluster.points, cluster.fresh, cluster.bright) == (3, 2, 2)
    assert cluster.measured_map == pytest.approx([3.1, 0.0, 0.0])
    assert cluster.age_s == pytest.approx(0.03)
    assert cluster.centre_map == pytest.approx([3.2, 1 / 30, 0.0])
    assert cluster.size_m == pytest.approx([0.2, 0.1, 0.0])
    assert cluster.fresh_bright == 1
    assert cluster.tape_map == pytest.approx([-0.1, 0.0, 0.0])


def test_no_owner_gets_more_points_than_its_ration() -> None:
    owners = np.repeat(np.array([-1, 0, 1], np.int32), [50, 40, 5])
    keep = rationed(np.random.default_rng(4).permutation(owners), 10, 20)
    shuffled = np.random.default_rng(4).permutation(owners)
    assert [int(np.sum(keep & (shuffled == name))) for name in (-1, 0, 1)] == [20, 10, 5]
    # Evenly taken: from all over, not only the first.
    assert np.flatnonzero(keep & (shuffled == 0))[-1] == np.flatnonzero(shuffled == 0)[-1]
    assert rationed(np.zeros(0, np.int32), 10, 20).shape == (0,)


def test_clusters_at_tracks_are_looked_at_even_behind_many_nearer_ones() -> None:
    many = MOST_CLUSTERS + 20
    places = np.column_stack([np.linspace(1.0, 9.0, many), np.zeros(many), np.zeros(many)])
    owners = np.full(many, -1, np.int32)
    owners[-1] = 0
    points = FilteredPoints(
        places, places, np.zeros(many), np.ones(many, np.uint8), np.ones(many, np.uint8), owners, 1
    )
    clusters = describe(np.arange(many, dtype=np.int32), points, np.zeros(3))
    ranges = [cluster.range_m for cluster in clusters]
    assert len(ranges) == MOST_CLUSTERS
    assert ranges == sorted(ranges)
    assert ranges[-1] == 9.0
    assert ranges[-2] == places[MOST_CLUSTERS - 2, 0]
