"""From filtered points to clusters that may be UAVs: density, number of points, size and shape."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from companion.messages import ByteArray, FloatArray
from companion.perception.tracking import clustering_kernels as kernels
from companion.perception.tracking.settings import TrackingSettings

MOST_CLUSTERS = 48
"""Beyond this number only those at tracks, and then the nearest clusters, are looked at."""

_REACH_BEYOND_BODY_M = 0.1  # rotors and legs


@dataclass(frozen=True, slots=True, eq=False)
class FilteredPoints:
    """Points to be clustered.

    Attributes:
        measured_map: (n, 3) where they were measured, m.
        moved_map: (n, 3) where what they belong to is expected now, m.
        ages_s: (n,) how long ago they were measured.
        fresh: (n,) 1 for points of the newest scan.
        bright: (n,) 1 for bright points.
        owners: (n,) track each one lies at, from `tracks` on a place where a new one may be, or -1.
        tracks: number of tracks.
    """

    measured_map: FloatArray
    moved_map: FloatArray
    ages_s: FloatArray
    fresh: ByteArray
    bright: ByteArray
    owners: NDArray[np.int32]
    tracks: int


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Points that belong together.

    Attributes:
        points: their number in the stack.
        fresh: number of those from the newest scan.
        bright: number of bright ones in the stack.
        centre_map: (3,) mean of the whole stack, moved to now.
        size_m: (3,) extent along the map's axes, moved to now.
        fresh_bright: number of bright ones from the newest scan.
        measured_map: (3,) mean of the newest scan's points where they were measured; without
            any, the same as `centre_map`.
        tape_map: (3,) from the mean of the newest scan's points to that of the bright ones among them.
        age_s: how long ago they were measured, on average.
        range_m: from the sensor to `centre_map`.
        velocity_map: (3,) as the points themselves show it, zero where they do not, m/s.
        speed_sigma: its standard deviation on each axis, infinite where they do not.
    """

    points: int
    fresh: int
    bright: int
    fresh_bright: int
    centre_map: FloatArray
    size_m: FloatArray
    measured_map: FloatArray
    tape_map: FloatArray
    age_s: float
    range_m: float
    velocity_map: FloatArray = field(default_factory=lambda: np.zeros(3))
    speed_sigma: float = math.inf

    @property
    def bright_share(self) -> float:
        """Return the share of bright points."""
        return self.bright / self.points


def epsilons(ranges_m: FloatArray, settings: TrackingSettings) -> FloatArray:
    """Return how near to each other points at these ranges (n,) must be to belong together, m."""
    density = settings.points_per_steradian * settings.stacked_scans
    return np.maximum(settings.epsilon_m, settings.epsilon_spacings / math.sqrt(density) * ranges_m)


def least_points(range_m: float, settings: TrackingSettings) -> int:
    """Return how many points of the stack a new neighbour must show at this range."""
    nearer = settings.min_points_range_m / max(range_m, 1e-3)
    wanted = round(settings.min_points * nearer**2)
    return int(min(max(wanted, settings.min_points_floor), settings.min_points))


def is_enough(cluster: Cluster, settings: TrackingSettings) -> bool:
    """Return whether a cluster has the points of a new neighbour.

    What moves fast leaves its points of each scan at another place, so the newest ones may stand for all.
    """
    most = max(cluster.points, cluster.fresh * settings.stacked_scans)
    return most >= least_points(cluster.range_m, settings)


def find_clusters(
    points: FilteredPoints, sensor_map: FloatArray, settings: TrackingSettings
) -> NDArray[np.int32]:
    """Return the cluster (n,) of each point, -1 for none."""
    ranges = np.linalg.norm(points.moved_map - sensor_map, axis=1)
    labels = np.empty(len(ranges), np.int32)
    count = kernels.density_clusters(
        points.moved_map, epsilons(ranges, settings), settings.core_points, labels
    )
    count = _share_out(labels, count, points)
    if settings.sparse_updates:
        _gather(labels, count, points, settings)
    return labels


def _share_out(labels: NDArray[np.int32], count: int, points: FilteredPoints) -> int:
    """Divide clusters in which several tracks have points: bodies that pass closely look like one."""
    claimed = (labels >= 0) & (points.owners >= 0) & (points.owners < points.tracks)
    keys = np.unique(labels[claimed].astype(np.int64) * max(points.tracks, 1) + points.owners[claimed])
    pairs = np.column_stack(np.divmod(keys, max(points.tracks, 1)))
    for label in np.flatnonzero(np.bincount(pairs[:, 0], minlength=1) > 1):
        inside = np.flatnonzero(labels == label)
        owners, moved = points.owners[inside], points.moved_map[inside]
        names = pairs[pairs[:, 0] == label, 1]
        middles = np.array([moved[owners == name].mean(axis=0) for name in names])
        nearest = names[np.argmin(np.linalg.norm(moved[:, None] - middles, axis=2), axis=1)]
        mine = np.where(owners >= 0, owners, nearest)
        for name in names[1:]:
            labels[inside[mine == name]] = count
            count += 1
    return count


def _gather(
    labels: NDArray[np.int32], count: int, points: FilteredPoints, settings: TrackingSettings
) -> None:
    """Put together what lies at one track and is no larger than a body, single points included.

    Far away a body's points are farther apart than any epsilon that could still tell two bodies apart.
    """
    largest_m = 2.0 * (settings.body_radius_m + _REACH_BEYOND_BODY_M)
    owned = np.flatnonzero(points.owners >= 0)
    owned = owned[np.argsort(points.owners[owned], kind="stable")]
    if not len(owned):
        return
    starts = np.flatnonzero(np.diff(points.owners[owned], prepend=-1))
    lowest = np.minimum.reduceat(labels[owned], starts)
    several = (lowest < 0) | (lowest < np.maximum.reduceat(labels[owned], starts))
    pieces = np.split(owned, starts[1:])
    for mine in [pieces[k] for k in np.flatnonzero(several)]:
        names, sizes = np.unique(labels[mine], return_counts=True)
        if np.all(np.ptp(points.moved_map[mine], axis=0) <= largest_m):
            clusters = names >= 0
            if clusters.any():
                labels[mine] = names[clusters][np.argmax(sizes[clusters])]
            else:
                labels[mine] = count
                count += 1


def trim(
    labels: NDArray[np.int32],
    points: FilteredPoints,
    trusted: NDArray[np.bool_],
    settings: TrackingSettings,
) -> None:
    """Cut clusters of trusted tracks that are too large back to what lies around their bright points.

    A proven UAV that passes closely by something solid grows together with it.

    Args:
        labels: (n,) in and out.
        points: what was clustered.
        trusted: (t,) which tracks are proven.
        settings: size limits.
    """
    if not settings.size_gate or not trusted.any():
        return
    reach_m = settings.body_radius_m + _REACH_BEYOND_BODY_M
    of_trusted = (points.owners >= 0) & (points.owners < points.tracks)
    of_trusted[of_trusted] = trusted[points.owners[of_trusted]]
    for label in np.unique(labels[of_trusted & (labels >= 0)]):
        inside = np.flatnonzero(labels == label)
        moved = points.moved_map[inside]
        if _fits(np.ptp(moved, axis=0), settings):
            continue
        bright = points.bright[inside] != 0
        if not bright.any():
            continue
        away = moved - np.median(moved[bright], axis=0)
        labels[inside[np.linalg.norm(away, axis=1) > reach_m]] = -1


def describe(
    labels: NDArray[np.int32],
    points: FilteredPoints,
    sensor_map: FloatArray,
    velocities: dict[int, tuple[FloatArray, float]] | None = None,
) -> list[Cluster]:
    """Return what there is to know of each cluster, the nearest first.

    Args:
        labels: (n,) cluster of each point, -1 for none.
        points: what was clustered.
        sensor_map: (3,) m.
        velocities: of some clusters, see `smear.straighten`.
    """
    count = int(labels.max(initial=-1)) + 1
    still = (np.zeros(3), math.inf)
    table = np.empty((count, kernels.SUMMARY_WIDTH))
    kernels.summarise(
        labels, points.measured_map, points.moved_map, points.ages_s, points.fresh, points.bright, table
    )
    names = np.flatnonzero(table[:, kernels.COUNT] > 0.0)
    table = table[names]
    middles = table[:, kernels.SUM] / table[:, kernels.COUNT, None]
    ranges = np.linalg.norm(middles - sensor_map, axis=1)
    order = np.argsort(ranges, kind="stable")
    if len(order) > MOST_CLUSTERS:
        at_track = (points.owners >= 0) & (points.owners < points.tracks) & (labels >= 0)
        followed = np.isin(names, labels[at_track])
        first = np.lexsort((ranges, ~followed))[:MOST_CLUSTERS]
        order = first[np.argsort(ranges[first], kind="stable")]
    clusters = []
    for k in order:
        row = table[k]
        fresh, bright = row[kernels.FRESH], row[kernels.FRESH_BRIGHT]
        tape_map = np.zeros(3)
        if bright:
            tape_map = row[kernels.FRESH_BRIGHT_SUM] / bright - row[kernels.FRESH_MOVED_SUM] / fresh
        velocity_map, speed_sigma = (velocities or {}).get(int(names[k]), still)
        clusters.append(
            Cluster(
                points=int(row[kernels.COUNT]),
                fresh=int(fresh),
                bright=int(row[kernels.BRIGHT]),
                centre_map=middles[k],
                size_m=row[kernels.HIGH] - row[kernels.LOW],
                fresh_bright=int(bright),
                measured_map=row[kernels.FRESH_SUM] / fresh if fresh else middles[k],
                tape_map=tape_map,
                age_s=float(row[kernels.FRESH_AGE] / fresh) if fresh else 0.0,
                range_m=float(ranges[k]),
                velocity_map=velocity_map,
                speed_sigma=speed_sigma,
            )
        )
    return clusters


def is_small(cluster: Cluster, settings: TrackingSettings) -> bool:
    """Return whether a cluster is no larger than a UAV."""
    return not settings.size_gate or _fits(cluster.size_m, settings)


def _fits(size_m: FloatArray, settings: TrackingSettings) -> bool:
    width = math.hypot(float(size_m[0]), float(size_m[1]))
    return width <= settings.max_width_m and float(size_m[2]) <= settings.max_height_m
