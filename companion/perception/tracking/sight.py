"""What one scan shows of bodies: how they are measured, what hides them and what they hang on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray, Odometry, OdometryStatus
from companion.perception.tracking import region_kernels
from companion.perception.tracking.body import whole_body_points
from companion.perception.tracking.clustering import Cluster
from companion.perception.tracking.filtering import StackedPoints
from companion.perception.tracking.regions import Regions, RegionSearch
from companion.perception.tracking.settings import TrackingSettings
from companion.perception.tracking.track import Track, measurement
from companion.perception.tracking.validation import Surroundings

Measured = tuple[FloatArray, FloatArray]
"""Position of a body's centre (3,), m, and its covariance (3, 3)."""

_SOLID_SHARE = 0.3  # points around a body, for each one on it, above which it is a part of something


@dataclass(frozen=True, slots=True)
class Sight:
    """One look of the tracker at the world.

    Attributes:
        settings: of the tracker.
        search: for points in regions.
        surroundings: what of bodies lies in the field of view.
        stack: all near points.
        odometry: at the scan's end.
        sensor_map: (3,) m.
    """

    settings: TrackingSettings
    search: RegionSearch
    surroundings: Surroundings
    stack: StackedPoints
    odometry: Odometry
    sensor_map: FloatArray

    def shaded(self, clusters: Sequence[Cluster]) -> NDArray[np.bool_]:
        """Return of which clusters (k,) something nearer may hide a part."""
        return np.asarray(self.search.shaded(self.stack, _centres(clusters), self.sensor_map) > 0.0)

    def hidden(self, tracks: Sequence[Track]) -> list[bool]:
        """Return of which tracks the body, or a part of it, is behind something or out of view."""
        centres = np.array([track.motion.p_map for track in tracks]).reshape(-1, 3)
        hidden = self.search.shaded(self.stack, centres, self.sensor_map) > 0.0
        hidden |= self._cut_off(centres)
        return [bool(part) for part in hidden]

    def measured(self, clusters: Sequence[Cluster], shaded: NDArray[np.bool_]) -> list[Measured]:
        """Return where the bodies are that clusters show."""
        settings = self.settings
        factor = settings.degraded_factor if self.odometry.status is OdometryStatus.DEGRADED else 1.0
        turn = math.radians(settings.ego_rotation_sigma_deg)
        jitter = factor * settings.ego_position_sigma_m, factor * turn
        hidden = shaded | self._cut_off(_centres(clusters))
        return [
            measurement(cluster, self.sensor_map, bool(part), jitter, settings)
            for cluster, part in zip(clusters, hidden, strict=True)
        ]

    def attached(
        self,
        asked: Sequence[int],
        clusters: Sequence[Cluster],
        measured: Sequence[Measured],
        shaded: NDArray[np.bool_],
        tracks: Sequence[Track],
    ) -> NDArray[np.bool_]:
        """Return which clusters (k,) are but the visible part of something larger.

        Args:
            asked: indices of the clusters that matter; the others are not.
            clusters: all of them.
            measured: see `measured`.
            shaded: see `shaded`.
            tracks: whose motion the clusters may share, and whose points are their own.
        """
        attached = np.zeros(len(clusters), np.bool_)
        if not self.settings.size_gate or not asked or not tracks:
            return attached
        z = np.array([measured[j][0] for j in asked])
        p = np.array([track.motion.p_map for track in tracks])
        nearest = np.argmin(np.linalg.norm(z[:, None] - p, axis=2), axis=1)
        velocities = np.array([track.motion.v_map for track in tracks])[nearest]
        ages = np.array([[clusters[j].age_s] for j in asked])
        bodies = Regions(z + ages * velocities, velocities, np.zeros(len(z)))
        counts = self.search.survey(self.stack, bodies, nearest.tolist(), list(tracks), self.sensor_map)
        around = counts[:, region_kernels.BELOW :].sum(axis=1)
        # Little of a body behind an edge cannot be told from points that straddle that edge.
        little = [
            clusters[j].fresh < 0.5 * whole_body_points(clusters[j].range_m, self.settings) for j in asked
        ]
        indices = np.array(asked)
        attached[indices] = around > 1.0 + _SOLID_SHARE * counts[:, region_kernels.BODY]
        attached[indices] |= shaded[indices] & little
        return attached

    def look_around(self, seen: Sequence[Track]) -> None:
        """Let tracks that are seen now gather evidence of what is around them."""
        bodies = Regions.around(list(seen))
        names = list(range(len(seen)))
        counts = self.search.survey(self.stack, bodies, names, list(seen), self.sensor_map)
        expected = self.surroundings.expected_foot(
            bodies.centres_map, self.sensor_map, self.odometry.q_map_body
        )
        for track, count, foot in zip(seen, counts, expected, strict=True):
            track.look_around(count, float(foot))

    def _cut_off(self, centres_map: FloatArray) -> NDArray[np.bool_]:
        return self.surroundings.cut_off(centres_map, self.sensor_map, self.odometry.q_map_body)


def _centres(clusters: Sequence[Cluster]) -> FloatArray:
    return np.array([cluster.centre_map for cluster in clusters]).reshape(-1, 3)
