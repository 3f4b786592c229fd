"""One followed body: its motion, how it is measured, and how sure it is to be a UAV."""

import math

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.messages import FloatArray, NeighbourTrack
from companion.perception.tracking.body import visible_surface
from companion.perception.tracking.clustering import Cluster
from companion.perception.tracking.motion_filter import MotionFilter
from companion.perception.tracking.settings import TrackingSettings
from companion.perception.tracking.validation import Proof

_SURPRISE_MEMORY = 0.6
_CALM, _WILD = 1.3, 3.5  # mean normalised innovation squared per axis: even flight, hard manoeuvre


def measurement(
    cluster: Cluster, sensor_map: FloatArray, jitter: tuple[float, float], settings: TrackingSettings
) -> tuple[FloatArray, FloatArray]:
    """Return the body's centre (3,) as one scan shows it, and its covariance (3, 3).

    Args:
        cluster: with points of the newest scan.
        sensor_map: (3,) m.
        jitter: standard deviations of the own position, m, and attitude, rad, from scan to scan.
        settings: the body's model and the sensor's noise.
    """
    away = cluster.measured_map - sensor_map
    range_m = max(float(np.linalg.norm(away)), 1e-3)
    offset, scatter = visible_surface(away, settings.body_radius_m, settings.body_height_m)
    count = max(cluster.fresh, 1)
    R = (settings.shape_share * scatter + settings.range_sigma_m**2 * np.eye(3)) / count
    R += settings.shape_sigma_m**2 * np.eye(3)
    along = away / range_m
    R += jitter[0] ** 2 * np.eye(3)
    R += (jitter[1] * range_m) ** 2 * (np.eye(3) - np.outer(along, along))
    return cluster.measured_map - (offset if settings.body_centre else 0.0), R


class Track:
    """A candidate or a validated neighbour."""

    def __init__(
        self, track_id: int, t_ns: int, z_map: FloatArray, R: FloatArray, settings: TrackingSettings
    ) -> None:
        """Start with the first observation.

        Args:
            track_id: its number.
            t_ns: host time of the scan's end.
            z_map: (3,) measured centre.
            R: (3, 3) its covariance.
            settings: of the tracker.
        """
        self.track_id = track_id
        self.t_born_ns = self.t_seen_ns = t_ns
        self.points = 0
        self.motion = MotionFilter(z_map, R, settings.initial_speed_sigma)
        self.proof = Proof(settings, z_map)
        self._settings = settings
        self._surprise = 1.0

    @property
    def roi_radius_m(self) -> float:
        """Return how far around the prediction its points are looked for."""
        settings = self._settings
        wanted = settings.roi_sigmas * self.sigma_m + settings.body_radius_m
        return max(settings.roi_radius_m, min(wanted, settings.max_roi_radius_m))

    @property
    def sigma_m(self) -> float:
        """Return the largest standard deviation of an axis of its position."""
        return math.sqrt(float(np.max(np.diagonal(self.motion.covariance)[:3])))

    def unseen_s(self, t_ns: int) -> float:
        """Return for how long it has not been observed."""
        return (t_ns - self.t_seen_ns) / NANOSECONDS_PER_SECOND

    def predict(self, dt_s: float) -> None:
        """Carry it on; the more its last measurements surprised, the more it may accelerate."""
        low, high = self._settings.acceleration_density, self._settings.manoeuvre_density
        wild = min(max((self._surprise - _CALM) / (_WILD - _CALM), 0.0), 1.0)
        self.motion.predict(dt_s, low * (high / low) ** wild)

    def observe(
        self, t_ns: int, cluster: Cluster, z_map: FloatArray, R: FloatArray, *, born: bool = False
    ) -> None:
        """Take a measurement.

        Args:
            t_ns: host time of the scan's end.
            cluster: what was seen.
            z_map: (3,) see `measurement`.
            R: (3, 3) see `measurement`.
            born: it is the one that began the track.
        """
        if not born:
            y, S = self.motion.innovation(z_map, R, cluster.age_s)
            square = float(y @ np.linalg.solve(S, y)) / 3.0
            self._surprise += (1.0 - _SURPRISE_MEMORY) * (min(square, 2.0 * _WILD) - self._surprise)
            self.motion.update(z_map, R, cluster.age_s)
        self.t_seen_ns = t_ns
        self.points = cluster.points
        self.proof.judge(cluster.points, cluster.bright, self.motion.p_map, self.motion.v_map, self.sigma_m)

    def message(self) -> NeighbourTrack:
        """Return it as others see it."""
        return NeighbourTrack(
            track_id=self.track_id,
            p_map=self.motion.p_map.copy(),
            v_map=self.motion.v_map.copy(),
            covariance=self.motion.covariance.copy(),
            t_born_ns=self.t_born_ns,
            t_seen_ns=self.t_seen_ns,
            points=self.points,
            bright_share=self.proof.bright_share,
            validated=self.proof.validated,
        )
