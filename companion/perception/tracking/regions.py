"""Where to look: around predicted tracks, and around whatever may be a new neighbour."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray, PointArray
from companion.perception.tracking import clustering_kernels, region_kernels
from companion.perception.tracking.body import outline_m
from companion.perception.tracking.clustering import FilteredPoints, epsilons
from companion.perception.tracking.filtering import StackedPoints, rationed, thinned
from companion.perception.tracking.settings import Tape, TrackingSettings
from companion.perception.tracking.track import Track
from companion.perception.tracking.untaped import compact_bodies

_FASTEST = 20.0
_EDGE_M = 0.15
_GAP_M = 0.4
# Where everything is bright, or much lies at one place, this bounds the time that it takes.
_REGION_POINTS = 600
_BRIGHT_POINTS = 400


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """Balls that move evenly.

    Attributes:
        centres_map: (k, 3) now, m.
        velocities_map: (k, 3) m/s.
        radii_m: (k,).
    """

    centres_map: FloatArray
    velocities_map: FloatArray
    radii_m: FloatArray

    @classmethod
    def around(cls, tracks: list[Track]) -> "Regions":
        """Return the regions of predicted tracks."""
        velocities = np.array([track.motion.v_map for track in tracks]).reshape(-1, 3)
        return cls(
            np.array([track.motion.p_map for track in tracks]).reshape(-1, 3),
            np.clip(velocities, -_FASTEST, _FASTEST),
            np.array([track.roi_radius_m for track in tracks]),
        )

    def with_resting(self, centres_map: FloatArray, radius_m: float) -> "Regions":
        """Return these regions and more that do not move."""
        return Regions(
            np.concatenate([self.centres_map, centres_map]),
            np.concatenate([self.velocities_map, np.zeros_like(centres_map)]),
            np.concatenate([self.radii_m, np.full(len(centres_map), radius_m)]),
        )


class RegionSearch:
    """Finds the points of regions."""

    def __init__(self, settings: TrackingSettings) -> None:
        """Take the memory for the grid."""
        self._settings = settings
        self._grid = np.zeros((region_kernels.GRID,) * 3, np.uint8)

    def filtered(self, stack: StackedPoints, tracks: list[Track], sensor_map: FloatArray) -> FilteredPoints:
        """Return the bright points, and all points around tracks and around what may be new.

        Args:
            stack: all near points.
            tracks: predicted to now; a point's owner is its index here.
            sensor_map: (3,) m.
        """
        regions = Regions.around(tracks)
        if self._settings.tape is Tape.NONE:
            seeds = compact_bodies(stack, sensor_map, self._settings)
        else:
            seeds = self._bright_seeds(stack, regions, sensor_map)
        everywhere = regions.with_resting(seeds, self._settings.roi_radius_m)
        owners = self._owners(stack.points_map, stack.ages_s, sensor_map, everywhere)
        wanted = owners >= 0
        if self._settings.tape is Tape.REFLECTIVE:
            wanted |= stack.bright != 0
        chosen = np.flatnonzero(wanted)
        if self._settings.tape is Tape.REFLECTIVE:
            chosen = chosen[rationed(owners[chosen], _REGION_POINTS, _BRIGHT_POINTS)]
        chosen = thinned(chosen, self._settings.most_points)
        measured = stack.points_map[chosen].astype(np.float64)
        ages, owners = stack.ages_s[chosen], owners[chosen]
        moved = measured.copy()
        owned = owners >= 0
        moved[owned] += everywhere.velocities_map[owners[owned]] * ages[owned, None]
        return FilteredPoints(
            measured_map=measured,
            moved_map=moved,
            ages_s=ages,
            fresh=(chosen < stack.fresh).astype(np.uint8),
            bright=stack.bright[chosen],
            owners=owners,
            tracks=len(tracks),
        )

    def survey(
        self,
        stack: StackedPoints,
        bodies: Regions,
        names: list[int],
        tracks: list[Track],
        sensor_map: FloatArray,
    ) -> FloatArray:
        """Return what the newest scan shows on and around bodies; see `region_kernels.survey`.

        Args:
            stack: all near points.
            bodies: where they are.
            names: index of the track each one belongs to, or -1.
            tracks: at whose points a body that is not theirs does not end.
            sensor_map: (3,) m.
        """
        points, ages = stack.points_map[: stack.fresh], stack.ages_s[: stack.fresh]
        counts = np.zeros((len(bodies.radii_m), region_kernels.SURROUNDINGS_WIDTH))
        region_kernels.survey(
            points,
            ages,
            self._owners(points, ages, sensor_map, Regions.around(tracks)),
            sensor_map,
            bodies.centres_map,
            bodies.velocities_map,
            np.array(names, np.int32),
            *outline_m(self._settings),
            self._settings.surroundings_m,
            self._settings.beside_m,
            np.array([track.proof.validated for track in tracks], np.uint8),
            self._grid,
            counts,
        )
        return counts

    def shaded(self, stack: StackedPoints, centres_map: FloatArray, sensor_map: FloatArray) -> FloatArray:
        """Return how many points of the newest scan (k,) stand before bodies or the edges of them."""
        counts = np.zeros(len(centres_map))
        region_kernels.shade(
            stack.points_map[: stack.fresh],
            sensor_map,
            centres_map,
            self._settings.body_radius_m + _EDGE_M,
            _GAP_M,
            counts,
        )
        return counts

    def _owners(
        self, points: PointArray, ages_s: FloatArray, sensor_map: FloatArray, regions: Regions
    ) -> NDArray[np.int32]:
        owners = np.empty(len(points), np.int32)
        region_kernels.claim(
            points, ages_s, sensor_map,
            regions.centres_map, regions.velocities_map, regions.radii_m, self._grid, owners,
        )  # fmt: skip
        return owners

    def _bright_seeds(self, stack: StackedPoints, regions: Regions, sensor_map: FloatArray) -> FloatArray:
        """Return the middles (k, 3) of bright clusters that no track explains, the nearest ones."""
        bright = thinned(np.flatnonzero(stack.bright), self._settings.most_points)
        points, ages = stack.points_map[bright], stack.ages_s[bright]
        unexplained = np.flatnonzero(self._owners(points, ages, sensor_map, regions) < 0)
        new = points[thinned(unexplained, _BRIGHT_POINTS)].astype(np.float64)
        ranges = np.linalg.norm(new - sensor_map, axis=1)
        labels = np.empty(len(new), np.int32)
        count = clustering_kernels.density_clusters(new, epsilons(ranges, self._settings), 1, labels)
        sums = np.zeros((count, 3))
        np.add.at(sums, labels, new)
        middles = sums / np.bincount(labels, minlength=count)[:, None]
        order = np.argsort(np.linalg.norm(middles - sensor_map, axis=1), kind="stable")
        return middles[order[: self._settings.most_tracks]]
