"""Follows the other UAVs from scan to scan.

The method is the published one: filter, cluster, track and validate in the map frame. What it lacks is
added by settings, and `TrackingSettings.literal` takes all of that back.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from companion.clock import NANOSECONDS_PER_SECOND
from companion.geometry.pose import Pose
from companion.messages import FloatArray, NeighbourTracks, Odometry, OdometryStatus, RegisteredScan
from companion.perception.tracking.association import gated_costs, global_pairs, greedy_pairs
from companion.perception.tracking.clustering import (
    Cluster,
    FilteredPoints,
    describe,
    find_clusters,
    is_enough,
    is_small,
    trim,
)
from companion.perception.tracking.filtering import ScanStack
from companion.perception.tracking.fixtures import Fixtures
from companion.perception.tracking.regions import RegionSearch
from companion.perception.tracking.settings import Association, Tape, TrackingSettings
from companion.perception.tracking.sight import Measured, Sight
from companion.perception.tracking.smear import Velocities, straighten
from companion.perception.tracking.track import Track
from companion.perception.tracking.validation import Surroundings

_USABLE = (OdometryStatus.TRACKING, OdometryStatus.DEGRADED)
_LEAST_POINTS = 2


class NeighbourTracker:
    """Turns registered scans into tracks of neighbours; work and memory are bounded."""

    def __init__(self, settings: TrackingSettings, T_body_lidar: Pose | None = None) -> None:
        """Begin without any track.

        Args:
            settings: see `TrackingSettings`.
            T_body_lidar: the sensor on the body; at its origin and level by default.
        """
        self._settings = settings
        self._T_body_lidar = T_body_lidar or Pose.identity()
        self._stack = ScanStack(settings)
        self._search = RegionSearch(settings)
        self._surroundings = Surroundings(settings, self._T_body_lidar.q)
        self._gate = float(chdtri(3, 1.0 - settings.gate_probability))
        self._fixtures = Fixtures()
        self._tracks: list[Track] = []
        self._next_id = 1
        self._t_ns: int | None = None
        self._reset_counter: int | None = None

    def observe(self, scan: RegisteredScan) -> NeighbourTracks:
        """Take one scan and return all tracks at its end.

        While the odometry is lost, tracks are carried on unobserved; when the map frame jumps they are
        dropped. A scan no newer than the last one changes nothing.
        """
        odometry = scan.odometry
        if self._reset_counter != odometry.reset_counter:
            self._forget()
            self._reset_counter = odometry.reset_counter
        if self._t_ns is None or odometry.t_ns > self._t_ns:
            self._carry_on(odometry.t_ns, odometry.v_map)
            if odometry.status in _USABLE and _is_finite(odometry):
                self._look(scan)
            else:
                self._stack.clear()
                for track in self._tracks:
                    track.hidden = False
            self._bury()
        t_ns = odometry.t_ns if self._t_ns is None else self._t_ns
        return NeighbourTracks(t_ns, scan.sequence, tuple(track.message(t_ns) for track in self._tracks))

    def _forget(self) -> None:
        self._tracks, self._t_ns = [], None
        self._stack.clear()
        self._fixtures.clear()

    def _carry_on(self, t_ns: int, v_map: FloatArray) -> None:
        dt_s = 0.0 if self._t_ns is None else (t_ns - self._t_ns) / NANOSECONDS_PER_SECOND
        if dt_s > self._settings.inactive_s + self._settings.last_seen_s:
            self._forget()
        flock = [v_map] if np.isfinite(v_map).all() else []
        flock += [track.motion.v_map for track in self._tracks if track.is_trusted(t_ns)]
        v_flock = np.mean(flock, axis=0) if flock else np.zeros(3)
        self._t_ns = t_ns
        for track in self._tracks:
            track.predict(dt_s, None if self._is_current(track) else v_flock)

    def _look(self, scan: RegisteredScan) -> None:
        """The whole method: filter, cluster, associate, update, validate, begin."""
        odometry, t_ns = scan.odometry, scan.odometry.t_ns
        sensor = (Pose(odometry.p_map, odometry.q_map_body) @ self._T_body_lidar).p
        stack = self._stack.add(scan, t_ns, sensor)
        sight = Sight(self._settings, self._search, self._surroundings, stack, odometry, sensor)
        current = [track for track in self._tracks if self._is_current(track)]
        lost = [track for track in self._tracks if not self._is_current(track)]
        awaited = [track for track in lost if track.is_awaited(t_ns)]
        watched = current + awaited
        points = self._search.filtered(stack, watched, sensor)
        clusters = self._clusters(points, watched, sensor)
        shaded = sight.shaded(clusters)
        measured = sight.measured(clusters, shaded)
        dim = np.array([cluster.bright == 0 for cluster in clusters], np.bool_)
        asked = range(len(clusters)) if awaited else np.flatnonzero(dim).tolist()
        attached = sight.attached(asked, clusters, measured, shaded, watched)
        free = list(range(len(clusters)))
        for track, j in self._matches(current, clusters, measured, attached & dim):
            track.observe(t_ns, clusters[j], *measured[j])
            free.remove(j)
        alone = [j for j in free if self._is_alone(measured[j][0])]
        for track, j in self._returns(awaited, clusters, measured, [j for j in alone if not attached[j]]):
            track.observe(t_ns, clusters[j], *measured[j])
            alone.remove(j)
            lost.remove(track)
        begun = [
            (j, before)
            for j in alone
            if self._may_begin(clusters[j]) and self._is_alone(measured[j][0])
            for before in [self._missing(lost, measured[j])]
            # Of one who is missing fewer points will do.
            if is_enough(clusters[j], self._settings)
            or (before is not None and clusters[j].points >= _LEAST_POINTS)
        ]
        self._judge([track for track in self._tracks if track.t_seen_ns == t_ns], sight)
        self._recognise()
        for j, before in begun[: self._room()]:
            self._begin(t_ns, clusters[j], measured[j], before)
        self._merge(t_ns)
        unseen = [track for track in self._tracks if track.t_seen_ns < t_ns]
        for track, hidden in zip(unseen, sight.hidden(unseen), strict=True):
            track.hidden &= hidden

    def _clusters(
        self, points: FilteredPoints, watched: list[Track], sensor_map: FloatArray
    ) -> list[Cluster]:
        """Return the clusters that may be UAVs, those of tracks first cut out of what they touch."""
        labels = find_clusters(points, sensor_map, self._settings)
        trusted = np.array([track.proof.validated for track in watched], np.bool_)
        trim(labels, points, trusted, self._settings)
        settled = np.array([track.is_settled for track in watched], np.bool_)
        velocities: Velocities = {}
        if self._settings.streaks:
            points, velocities = straighten(labels, points, settled)
        clusters = describe(labels, points, sensor_map, velocities)
        return [cluster for cluster in clusters if self._is_plausible(cluster)]

    def _judge(self, seen: list[Track], sight: Sight) -> None:
        """Let the tracks seen now gather evidence, and decide which are UAVs."""
        if seen and self._settings.proof_of_flight:
            sight.look_around(seen)
        for track, part in zip(seen, sight.hidden(seen), strict=True):
            track.judge(whole=not part)

    def _missing(self, lost: list[Track], measured: Measured) -> Track | None:
        """Return which of the lost ones might well have come into sight here, the one lost last."""
        expecting = [track for track in lost if track.expects(*measured)]
        return max(expecting, key=lambda track: track.t_seen_ns, default=None)

    def _begin(self, t_ns: int, cluster: Cluster, measured: Measured, before: Track | None) -> None:
        """Begin a track, perhaps of one who was lost before."""
        evidence = self._fixtures.evidence(measured[0])
        if before is not None and math.isinf(cluster.speed_sigma):
            P = before.motion.covariance
            sigma = math.sqrt(max(P[3, 3], P[4, 4], P[5, 5]))
            cluster = replace(cluster, velocity_map=before.motion.v_map.copy(), speed_sigma=sigma)
        track = Track(self._next_id, t_ns, cluster, *measured, self._settings)
        if evidence < 0.0:
            track.proof.free = evidence
        elif before is not None:
            track.proof.encourage()
            track.expected = True
        self._tracks.append(track)
        self._next_id += 1

    def _room(self) -> int:
        """Return how many tracks may begin."""
        settings, count = self._settings, len(self._tracks)
        if settings.tape is Tape.NONE:
            current = sum(self._is_current(track) for track in self._tracks)
            return max(min(settings.most_untaped - current, settings.most_tracks - count), 0)
        return max(settings.most_tracks - count, 0)

    def _is_current(self, track: Track) -> bool:
        return self._t_ns is not None and track.unseen_s(self._t_ns) <= self._settings.inactive_s + 0.01

    def _is_plausible(self, cluster: Cluster) -> bool:
        enough = self._settings.sparse_updates or is_enough(cluster, self._settings)
        return cluster.fresh > 0 and enough and is_small(cluster, self._settings)

    def _may_begin(self, cluster: Cluster) -> bool:
        """Return whether a cluster may be another UAV."""
        settings = self._settings
        if cluster.points < _LEAST_POINTS and not is_enough(cluster, settings):
            return False
        return settings.tape is not Tape.REFLECTIVE or cluster.bright_share > settings.bright_share

    def _is_alone(self, z_map: FloatArray) -> bool:
        """Return whether no track that is seen now is so near to a place that both are one body."""
        seen = np.array([track.motion.p_map for track in self._tracks if track.t_seen_ns == self._t_ns])
        away = np.linalg.norm(seen.reshape(-1, 3) - z_map, axis=1)
        return bool(np.min(away, initial=np.inf) > self._settings.same_body_m)

    def _matches(
        self,
        tracks: list[Track],
        clusters: list[Cluster],
        measured: list[Measured],
        solid: NDArray[np.bool_],
    ) -> list[tuple[Track, int]]:
        """Return which track each cluster (index) continues."""
        settings = self._settings
        offered = np.flatnonzero(~solid).tolist()
        dim = np.zeros(len(offered), np.bool_)
        if settings.tape is Tape.REFLECTIVE and settings.proof_of_flight:
            dim = np.array([clusters[j].bright == 0 for j in offered], np.bool_)
        # Only who is a UAV, or probably one that was lost, is known by its dim parts.
        banned = np.outer([not track.is_known_when_dim for track in tracks], dim)
        ages = [clusters[j].age_s for j in offered]
        pairs = self._pairs(tracks, [measured[j] for j in offered], ages, self._gate, banned)
        matches = [(tracks[i], offered[k]) for i, k in pairs]
        if settings.association is Association.GREEDY:
            return matches
        # Who turned harder than expected is found by what nobody else explains.
        seen, used = {i for i, _ in pairs}, {k for _, k in pairs}
        missed = [track for i, track in enumerate(tracks) if i not in seen and track.proof.validated]
        left = [j for k, j in enumerate(offered) if k not in used and clusters[j].bright > 0]
        gate = settings.rescue_factor * self._gate
        rescued = self._pairs(missed, [measured[j] for j in left], [clusters[j].age_s for j in left], gate)
        return matches + [(missed[i], left[k]) for i, k in rescued]

    def _returns(
        self, awaited: list[Track], clusters: list[Cluster], measured: list[Measured], free: list[int]
    ) -> list[tuple[Track, int]]:
        """Return which lost neighbour has come back into sight as which cluster (index).

        At the edge of the field of view, or of what hid it, its tape may not be the part that shows first.
        """
        offered = [
            j
            for j in free
            if is_enough(clusters[j], self._settings) and self._fixtures.evidence(measured[j][0]) >= 0.0
        ]
        ages = [clusters[j].age_s for j in offered]
        pairs = self._pairs(awaited, [measured[j] for j in offered], ages, self._gate)
        return [(awaited[i], offered[k]) for i, k in pairs]

    def _pairs(
        self,
        tracks: list[Track],
        measured: list[Measured],
        ages_s: list[float],
        gate: float,
        banned: NDArray[np.bool_] | None = None,
    ) -> list[tuple[int, int]]:
        """Return pairs of track and measurement by their indices."""
        if not tracks or not measured:
            return []
        settings = self._settings
        z = np.array([z for z, _ in measured])
        p = np.array([track.motion.p_map for track in tracks])
        away = np.linalg.norm(p[:, None] - z, axis=2)
        if settings.association is Association.GREEDY:
            return greedy_pairs(away, settings.match_distance_m)
        states = np.column_stack([p, [track.motion.v_map for track in tracks]])
        covariances = np.array([track.motion.cautious_covariance for track in tracks])
        noises = np.array([R for _, R in measured])
        costs = gated_costs(states, covariances, z, noises, np.array(ages_s), gate)
        costs[away > settings.max_match_m] = np.inf
        if banned is not None:
            costs[banned] = np.inf
        return global_pairs(costs)

    def _recognise(self) -> None:
        """Give whoever has just proved to be a UAV the number of the lost one it most likely is."""
        new = [track for track in self._tracks if track.proof.validated and not track.known]
        lost = [track for track in self._tracks if track.proof.validated and not self._is_current(track)]
        for track in new:
            track.known = True
        if not new or not lost:
            return
        states = np.array([[*track.motion.p_map, *track.motion.v_map] for track in lost])
        covariances = np.array([track.motion.covariance for track in lost])
        places = np.array([track.motion.p_map for track in new])
        noises = np.array([track.motion.covariance[:3, :3] for track in new])
        costs = gated_costs(states, covariances, places, noises, np.zeros(len(new)), self._gate)
        for i, j in global_pairs(costs):
            new[j].become(lost[i])
            self._tracks.remove(lost[i])
        self._tracks.sort(key=lambda track: track.track_id)

    def _merge(self, t_ns: int) -> None:
        """Of two tracks of one body keep the proven one, or else the older one."""
        ranked = sorted(
            (track for track in self._tracks if track.t_seen_ns == t_ns),
            key=lambda track: (not track.proof.validated, track.t_born_ns, track.track_id),
        )
        p = np.array([track.motion.p_map for track in ranked]).reshape(-1, 3)
        near = np.linalg.norm(p[:, None] - p, axis=2) <= self._settings.same_body_m
        gone: set[int] = set()
        for i in np.flatnonzero(np.tril(near, -1).any(axis=1)).tolist():
            if any(j not in gone for j in np.flatnonzero(near[i, :i]).tolist()):
                gone.add(i)
        dropped = {ranked[i].track_id for i in gone}
        self._tracks = [track for track in self._tracks if track.track_id not in dropped]

    def _bury(self) -> None:
        """Let go of what was not seen for too long, and remember where nothing flies."""
        longest = self._settings.inactive_s + self._settings.last_seen_s
        for track in self._tracks:
            if not self._is_current(track) and not track.proof.validated and track.is_still:
                self._fixtures.remember(track.motion.p_map, track.proof.free)
        self._tracks = [
            track
            for track in self._tracks
            if self._is_current(track)
            or (self._t_ns is not None and track.proof.validated and track.unseen_s(self._t_ns) <= longest)
        ]


def _is_finite(odometry: Odometry) -> bool:
    return bool(np.isfinite(odometry.p_map).all() and np.isfinite(odometry.q_map_body).all())
