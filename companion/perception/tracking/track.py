"""One followed body: its motion, how it is measured, and how sure it is to be a UAV."""

import math

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.messages import FloatArray, NeighbourTrack
from companion.perception.tracking import region_kernels
from companion.perception.tracking.body import seen_of, sight_axes, whole_body_points
from companion.perception.tracking.clustering import Cluster
from companion.perception.tracking.motion_filter import MotionFilter
from companion.perception.tracking.settings import TrackingSettings
from companion.perception.tracking.validation import Proof

_LEAST_HIDDEN = 0.3
_HIDDEN_SCATTER = 0.6
_RESOLVED_POINTS = 20
_RESOLVED_RADII = 1.5
_SETTLED_SPEED_SIGMA = 0.6
_EXPECTED_SQUARE = 9.0  # squared Mahalanobis distance within which a return surprises nobody


def measurement(
    cluster: Cluster,
    sensor_map: FloatArray,
    hidden: bool,
    jitter: tuple[float, float],
    settings: TrackingSettings,
) -> tuple[FloatArray, FloatArray]:
    """Return the body's centre (3,) as one scan shows it, and its covariance (3, 3).

    Args:
        cluster: with points of the newest scan.
        sensor_map: (3,) m.
        hidden: something may hide a part of it.
        jitter: standard deviations of the own position, m, and attitude, rad, from scan to scan.
        settings: the body's model and the sensor's noise.
    """
    away = cluster.measured_map - sensor_map
    range_m = max(float(np.linalg.norm(away)), 1e-3)
    dim, axes = cluster.fresh - cluster.fresh_bright, sight_axes(away)
    shift, variances = seen_of(dim, cluster.fresh_bright, cluster.tape_map, axes, settings)
    variances += settings.shape_sigma_m**2 * np.array([1.0, 0.25, 1.0])
    if hidden:
        # The middle of the rest is not the body's.
        share = max(_LEAST_HIDDEN, 1.0 - cluster.fresh / whole_body_points(range_m, settings))
        variances += (_HIDDEN_SCATTER * share * settings.body_radius_m) ** 2
    variances += jitter[0] ** 2 + (jitter[1] * range_m) ** 2 * np.array([0.0, 1.0, 1.0])
    R = axes.T @ (variances[:, None] * axes)
    return cluster.measured_map + (shift if settings.body_centre else 0.0), R


class Track:
    """A candidate or a validated neighbour."""

    def __init__(
        self,
        track_id: int,
        t_ns: int,
        cluster: Cluster,
        z_map: FloatArray,
        R: FloatArray,
        settings: TrackingSettings,
    ) -> None:
        """Start with the first observation.

        Args:
            track_id: its number.
            t_ns: host time of the scan's end.
            cluster: what was seen.
            z_map: (3,) measured centre.
            R: (3, 3) its covariance.
            settings: of the tracker.
        """
        self.track_id = track_id
        self.t_born_ns = t_ns
        self.known = False  # whether it was ever taken for a UAV
        self.expected = False  # whether it came into sight where one that was lost might have
        self.hidden = True  # whether all the time since it was last seen there was a reason not to see it
        self._settings = settings
        self._begin(t_ns, cluster, z_map, R)
        self.judge(whole=False)

    def _begin(self, t_ns: int, cluster: Cluster, z_map: FloatArray, R: FloatArray) -> None:
        settings = self._settings
        self.t_seen_ns = t_ns
        self.motion = MotionFilter(
            z_map,
            R,
            min(settings.initial_speed_sigma, cluster.speed_sigma),
            settings.agility(),
            cluster.velocity_map,
        )
        self.motion.predict(round(cluster.age_s, 2))
        self.proof = Proof(settings, self.motion)
        self._newest = cluster

    @property
    def roi_radius_m(self) -> float:
        """Return how far around the prediction its points are looked for."""
        settings = self._settings
        wanted = settings.roi_sigmas * self.sigma_m + settings.body_radius_m
        return max(settings.roi_radius_m, min(wanted, settings.max_roi_radius_m))

    @property
    def is_settled(self) -> bool:
        """Return whether its velocity is known well."""
        P = self.motion.covariance
        return bool(max(P[3, 3], P[4, 4], P[5, 5]) <= _SETTLED_SPEED_SIGMA**2)

    @property
    def is_known_when_dim(self) -> bool:
        """Return whether it is a UAV, or probably one that was lost."""
        return self.proof.validated or (self.expected and self.proof.free >= 0.0)

    def is_awaited(self, t_ns: int) -> bool:
        """Return whether it is a UAV that was lost a short while ago."""
        return self.proof.validated and self.unseen_s(t_ns) <= self._settings.awaited_s

    @property
    def is_still(self) -> bool:
        """Return whether it has hardly moved since it was first seen."""
        return float(np.linalg.norm(self.motion.p_map - self.proof.birth_map)) < self._settings.moved_m

    @property
    def sigma_m(self) -> float:
        """Return the largest standard deviation of an axis of its position, on the safe side."""
        P = self.motion.cautious_covariance
        return math.sqrt(max(P[0, 0], P[1, 1], P[2, 2]))

    def unseen_s(self, t_ns: int) -> float:
        """Return for how long it has not been observed."""
        return (t_ns - self.t_seen_ns) / NANOSECONDS_PER_SECOND

    def predict(self, dt_s: float, v_flock_map: FloatArray | None = None) -> None:
        """Carry it on; of one that was lost all that is known before long is that it flies with the flock.

        Args:
            dt_s: seconds.
            v_flock_map: (3,) mean velocity of the flock, where this one was lost.
        """
        settings = self._settings
        self.motion.predict(dt_s)
        if v_flock_map is not None:
            self.motion.fade(dt_s, settings.lost_fading_s, settings.lost_speed_sigma, v_flock_map)

    def observe(self, t_ns: int, cluster: Cluster, z_map: FloatArray, R: FloatArray) -> None:
        """Take a measurement.

        Args:
            t_ns: host time of the scan's end.
            cluster: what was seen.
            z_map: (3,) see `measurement`.
            R: (3, 3) see `measurement`.
        """
        self.motion.update(z_map, R, cluster.age_s)
        self.t_seen_ns, self.hidden = t_ns, True
        self._newest = cluster

    def expects(self, z_map: FloatArray, R: FloatArray) -> bool:
        """Return whether a lost one might well have come into sight here; see `measurement`."""
        y = z_map - self.motion.p_map
        S = self.motion.covariance[:3, :3] + R
        return (
            float(y @ np.linalg.solve(S, y)) <= _EXPECTED_SQUARE
            and float(np.linalg.norm(y)) <= self._settings.max_return_m
        )

    def become(self, lost: "Track") -> None:
        """Take the number of a lost one: this is who it was all along."""
        self.track_id, self.t_born_ns, self.known = lost.track_id, lost.t_born_ns, True

    def look_around(self, counts: FloatArray, expected: float) -> None:
        """Take what surrounds it; see `Proof.look_around`."""
        if not self.is_settled:
            # Until it is known how it moves, its own points may seem to lie beside it.
            counts = counts.copy()
            counts[region_kernels.BESIDE] = 0.0
        width = math.hypot(float(self._newest.size_m[0]), float(self._newest.size_m[1]))
        resolved = (
            self._newest.fresh >= _RESOLVED_POINTS and width >= _RESOLVED_RADII * self._settings.body_radius_m
        )
        self.proof.look_around(counts, expected, resolved)

    def judge(self, *, whole: bool) -> None:
        """Decide anew whether it is a UAV, after an observation of the whole body or of a part."""
        self.proof.judge(self._newest.points, self._newest.bright, self.motion, whole=whole)
        if self.proof.validated:
            self.motion.distinguish()

    def is_trusted(self, t_ns: int) -> bool:
        """Return whether it is a UAV, and near enough to where it is said to be."""
        settings = self._settings
        if not self.proof.validated or self.t_seen_ns == t_ns:
            return self.proof.validated
        spread = float(np.linalg.eigvalsh(self.motion.cautious_covariance[:3, :3])[-1])
        unseen_s = self.unseen_s(t_ns)
        if self.hidden and unseen_s <= settings.hidden_s and spread <= settings.max_hidden_sigma_m**2:
            return True
        return unseen_s <= settings.inactive_s + 0.01 and spread <= settings.max_coast_sigma_m**2

    def message(self, t_ns: int) -> NeighbourTrack:
        """Return it as others see it at the end of a scan."""
        return NeighbourTrack(
            track_id=self.track_id,
            p_map=self.motion.p_map.copy(),
            v_map=self.motion.v_map.copy(),
            covariance=self.motion.covariance.copy(),
            t_born_ns=self.t_born_ns,
            t_seen_ns=self.t_seen_ns,
            points=self._newest.points,
            bright_share=self.proof.bright_share,
            validated=self.is_trusted(t_ns),
        )
