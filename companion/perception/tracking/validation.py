"""Whether a track is a UAV: bright for long enough, and floating or moving freely.

A sign, a vest or tape on a pole is as bright as a UAV's tape. What tells them apart is what surrounds
them: under a UAV, and around it, there is nothing, while they stand on, or hang on, something that
returns points too. What floats at rest on nothing that the sensor can see (a sign on a thread, a post
that hides behind something nearer) cannot be told from a UAV that hovers.
"""

import math

import numpy as np
from numpy.typing import NDArray

from companion.clock import seconds_to_ns
from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.tracking import region_kernels
from companion.perception.tracking.body import outline_m
from companion.perception.tracking.motion_filter import MotionFilter
from companion.perception.tracking.settings import Tape, TrackingSettings

# In thresholds of evidence:
_MOST_EVIDENCE = 4.0  # what is proven can still be disproven
_MOTION = 2.0  # what moved may pass by solid things for a while
_EXPECTED = 0.5  # what one begins with who seems to have come back
_DOUBT = 0.25  # what seems attached by more than this cannot prove itself by moving
# Of one scan:
_MOST_AGAINST = 3.0  # attached points that count
_MOST_WEIGHT = 2.0  # of each of them
_LEAST_EXPECTED, _MOST_EXPECTED = 0.5, 1.5  # points at a foot
_BY_SIZE = 0.5  # evidence, where no foot could be seen, of a body that is seen well and stands alone
_CLUTTER = 0.02  # points that seem attached to what floats, and the same for each point on the body
_SPEED_SIGMAS = 1.5  # the way it went is the proof; its speed need only agree
_ENOUGH_POINTS = 5.0  # to judge the share of bright ones
_RETURNS = 0.7  # share of the beams at a foot that return
_FOOT_STEPS = 8


class Surroundings:
    """What of bodies, and of the space under them, lies in the field of view."""

    def __init__(self, settings: TrackingSettings, q_body_lidar: FloatArray) -> None:
        """Prepare for a sensor mounted with attitude `q_body_lidar` (4,)."""
        self._settings = settings
        self._q_body_lidar = q_body_lidar

    def expected_foot(
        self, centres_map: FloatArray, sensor_map: FloatArray, q_map_body: FloatArray
    ) -> FloatArray:
        """Return how many points (k,) of one scan a foot under each body would show.

        Args:
            centres_map: (k, 3) of the bodies, m.
            sensor_map: (3,) m.
            q_map_body: (4,) own attitude.
        """
        settings = self._settings
        shares = (np.arange(_FOOT_STEPS) + 0.5) / _FOOT_STEPS
        depth = outline_m(settings)[1] + settings.surroundings_m * shares
        feet = centres_map[:, None, :] - depth[None, :, None] * np.array([0.0, 0.0, 1.0])
        elevations = self._elevations(feet - sensor_map, q_map_body)
        visible = np.mean(elevations >= math.radians(settings.fov_low_deg), axis=1)
        square = np.maximum(np.einsum("ki,ki->k", centres_map - sensor_map, centres_map - sensor_map), 0.01)
        area = settings.foot_width_m * settings.surroundings_m * visible
        return np.asarray(_RETURNS * settings.points_per_steradian * area / square)

    def cut_off(
        self, centres_map: FloatArray, sensor_map: FloatArray, q_map_body: FloatArray
    ) -> NDArray[np.bool_]:
        """Return which bodies (k,) reach beyond the field of view; arguments as above."""
        away = centres_map - sensor_map
        half = outline_m(self._settings)[1] / np.maximum(np.linalg.norm(away, axis=1), 0.1)
        elevations = self._elevations(away, q_map_body)
        low, high = math.radians(self._settings.fov_low_deg), math.radians(self._settings.fov_high_deg)
        return np.asarray((elevations - half < low) | (elevations + half > high))

    def _elevations(self, away_map: FloatArray, q_map_body: FloatArray) -> FloatArray:
        """Return the elevations (...) of directions (..., 3) in the sensor's frame."""
        q_lidar_map = rotation.conjugate(rotation.multiply(q_map_body, self._q_body_lidar))
        away = rotation.rotate(q_lidar_map, away_map)
        return np.asarray(np.arctan2(away[..., 2], np.hypot(away[..., 0], away[..., 1])))


class Proof:
    """The evidence for one track."""

    def __init__(self, settings: TrackingSettings, motion: MotionFilter) -> None:
        """Begin without any, at the place of birth."""
        self._settings = settings
        self.birth_map = motion.p_map.copy()
        self._birth_covariance = motion.covariance[:3, :3].copy()
        self._bright = self._points = 0.0
        self._updates = 0
        self._on = 0
        self._wanted_on = max(settings.min_on_updates, _scans(settings.on_s, settings))
        self._off = self._off_whole = 0
        self._most_off = _scans(settings.off_s, settings)
        self._most_off_in_part = _scans(settings.off_in_part_s, settings)
        self.free = 0.0
        self.moved = False
        self.validated = False

    def encourage(self) -> None:
        """Begin with some of the evidence: it came into sight where a UAV was expected."""
        self.free = _EXPECTED * self._settings.free_evidence

    @property
    def bright_share(self) -> float:
        """Return the remembered share of bright points."""
        return self._bright / self._points if self._points > 0.0 else 0.0

    def look_around(self, counts: FloatArray, expected: float, resolved: bool) -> None:
        """Take the surroundings of one scan.

        With a foot, points about it are Poisson distributed with the expected number plus clutter;
        without one, clutter is all there is; `free` adds up the logarithm of that ratio, within limits
        for each scan, since neither number is more than a model.

        Args:
            counts: (SURROUNDINGS_WIDTH,) see `region_kernels.survey`.
            expected: points that a foot would show.
            resolved: so many points show it that its size is beyond doubt, and it is a UAV's.
        """
        around = float(counts[region_kernels.BELOW :].sum())
        clutter = _CLUTTER * (1.0 + float(counts[region_kernels.BODY]))
        weight = min(math.log1p(max(expected, _LEAST_EXPECTED) / clutter), _MOST_WEIGHT)
        expected = min(expected, _MOST_EXPECTED)
        if resolved and around == 0.0:
            # Very near, the space under it may be out of view; but posts are thin, and people are large.
            expected = max(expected, _BY_SIZE)
        against = min(around, _MOST_AGAINST) * weight
        threshold = self._settings.free_evidence
        self.free = self.free + expected - against
        self.free = min(max(self.free, -_MOST_EVIDENCE * threshold), _MOST_EVIDENCE * threshold)

    def judge(self, points: int, bright: int, motion: MotionFilter, *, whole: bool = True) -> None:
        """Take one update and decide anew.

        Args:
            points: of its cluster.
            bright: number of bright ones among them.
            motion: where it is and how it moves.
            whole: nothing hides a part of it, so that its tape would be seen.
        """
        settings = self._settings
        self._updates += 1
        self._points = settings.share_memory * self._points + points
        self._bright = settings.share_memory * self._bright + bright
        taped = settings.tape is Tape.NONE or self.bright_share > settings.bright_share
        self._on = self._on + 1 if taped else 0
        self._off = 0 if taped else self._off + 1
        self._off_whole = 0 if taped else self._off_whole + whole
        # What went along a pole from one dim point to the next has not moved.
        shown = settings.tape is Tape.NONE or bright > 0
        if shown and not self.moved and self._updates >= settings.moved_updates:
            self.moved = self.free > -_DOUBT * settings.free_evidence and self._goes(motion)
        if self.validated:
            fixed = settings.proof_of_flight and self._evidence <= -settings.free_evidence
            remembered = self._off_whole <= self._most_off and self._off <= self._most_off_in_part
            self.validated = remembered and not fixed
        elif taped and self._on >= self._wanted_on:
            self.validated = self._flies and not self._is_all_tape

    @property
    def _evidence(self) -> float:
        """Return the evidence of free space and of motion together."""
        return self.free + (_MOTION * self._settings.free_evidence if self.moved else 0.0)

    @property
    def _is_all_tape(self) -> bool:
        settings = self._settings
        return self._points >= _ENOUGH_POINTS and self.bright_share > settings.max_bright_share

    @property
    def _flies(self) -> bool:
        settings = self._settings
        if not settings.proof_of_flight:
            return True
        return self._evidence >= settings.free_evidence and (self.moved or settings.tape is not Tape.NONE)

    def _goes(self, motion: MotionFilter) -> bool:
        """Return whether it has moved away from its birth and is still moving, beyond doubt."""
        settings = self._settings
        way, v = motion.p_map - self.birth_map, motion.v_map
        far, fast = float(np.linalg.norm(way)), float(np.linalg.norm(v))
        sigma_p = math.sqrt(float(np.trace(motion.covariance[:3, :3] + self._birth_covariance)))
        sigma_v = math.sqrt(float(np.trace(motion.covariance[3:, 3:])))
        return (
            far > max(settings.moved_m, settings.moved_sigmas * sigma_p)
            and fast > max(settings.min_moving_speed, _SPEED_SIGMAS * sigma_v)
            and float(way @ v) > 0.0
        )


def _scans(duration_s: float, settings: TrackingSettings) -> int:
    """Return the number of scans in a duration, rounded up."""
    return math.ceil(seconds_to_ns(duration_s) / seconds_to_ns(settings.scan_period_s))
