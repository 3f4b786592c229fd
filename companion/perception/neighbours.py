"""From tracks in the map to what a follower's controller sees: the nearest few, in its own heading."""

import numpy as np
from pydantic import Field

from companion.geometry import rotation
from companion.messages import Neighbours, NeighbourTrack, NeighbourTracks, Odometry
from companion.settings import Settings

STATE_WIDTH = 7
_NONE = -1


class NeighbourSettings(Settings):
    """How many neighbours are seen, and when."""

    count: int = Field(default=12, ge=1, le=20)
    """The nearest so many."""
    compensate_latency: bool = True
    """Predict neighbours and own pose to now; otherwise both as they were when the scan ended."""
    max_age_s: float = Field(default=2.0, gt=0.0, le=10.0)
    """A neighbour unseen for longer is left out; until then it keeps its place, carried on, while the tracker
    relies on it."""


class NeighbourView:
    """Keeps the newest tracks with the pose from which they were seen."""

    def __init__(self, settings: NeighbourSettings) -> None:
        """Begin without any neighbour."""
        self._settings = settings
        self._tracks: NeighbourTracks | None = None
        self._seen_from: Odometry | None = None

    def clear(self) -> None:
        """Forget everybody: the map is another one."""
        self._tracks = self._seen_from = None

    def observe(self, tracks: NeighbourTracks, odometry: Odometry) -> None:
        """Take the tracks after a scan and the own motion at its end."""
        self._tracks, self._seen_from = tracks, odometry

    def at(self, odometry: Odometry, t_ns: int) -> Neighbours:
        """Return the neighbours at host time `t_ns`.

        Nobody, if the own motion is not finite or belongs to another map than the tracks.

        Args:
            odometry: the newest own motion.
            t_ns: now; the result holds for then, or for the scan's end without compensation.
        """
        if self._tracks is None or self._seen_from is None:
            return nobody(t_ns, self._settings.count)
        t_valid_ns = t_ns if self._settings.compensate_latency else self._tracks.t_ns
        own = odometry if self._settings.compensate_latency else self._seen_from
        if odometry.reset_counter != self._seen_from.reset_counter or not _is_finite(own):
            return nobody(t_valid_ns, self._settings.count)
        fresh_ns = t_ns - round(self._settings.max_age_s * 1e9)
        seen = [track for track in self._tracks.tracks if track.validated and track.t_seen_ns >= fresh_ns]
        return nearest(
            [moved(track, t_valid_ns - self._tracks.t_ns) for track in seen],
            own,
            t_valid_ns,
            t_ns,
            self._settings.count,
        )


def moved(track: NeighbourTrack, by_ns: int) -> NeighbourTrack:
    """Return a track carried on with its velocity for a while."""
    dt = by_ns * 1e-9
    F = np.eye(6)
    F[:3, 3:] = dt * np.eye(3)
    return NeighbourTrack(
        track_id=track.track_id,
        p_map=track.p_map + dt * track.v_map,
        v_map=track.v_map,
        covariance=F @ track.covariance @ F.T,
        t_born_ns=track.t_born_ns,
        t_seen_ns=track.t_seen_ns,
        points=track.points,
        bright_share=track.bright_share,
        validated=track.validated,
    )


def nobody(t_ns: int, count: int) -> Neighbours:
    """Return `count` empty places at host time `t_ns`."""
    return Neighbours(
        t_ns,
        np.full(count, _NONE, dtype=np.int64),
        np.zeros((count, STATE_WIDTH)),
        np.zeros((count, 6, 6)),
        np.zeros(count),
    )


def nearest(
    tracks: list[NeighbourTrack], odometry: Odometry, t_valid_ns: int, t_ns: int, count: int
) -> Neighbours:
    """Return the nearest `count` tracks relative to the own body in its heading frame.

    Positions of tracks and of the body share the error of the odometry, which cancels; of the own motion
    only the velocity's covariance is added.

    Args:
        tracks: at `t_valid_ns`.
        odometry: own motion, carried on from its own time with its velocity and rate.
        t_valid_ns: time for which the result holds.
        t_ns: now, for the ages.
        count: most neighbours.
    """
    found = nobody(t_valid_ns, count)
    dt = (t_valid_ns - odometry.t_ns) * 1e-9
    p_own = odometry.p_map + dt * odometry.v_map
    q_own = rotation.multiply(odometry.q_map_body, rotation.exp(odometry.omega_body * dt))
    R_heading_map = rotation.to_matrix(rotation.from_yaw(-rotation.yaw_of(q_own)))
    order = sorted(tracks, key=lambda track: (float(np.linalg.norm(track.p_map - p_own)), track.track_id))
    own_velocity = np.zeros((6, 6))
    own_velocity[3:, 3:] = odometry.covariance_velocity
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R_heading_map
    for row, track in enumerate(order[:count]):
        found.states_heading[row, 0:3] = R_heading_map @ (track.p_map - p_own)
        found.states_heading[row, 3:6] = R_heading_map @ (track.v_map - odometry.v_map)
        found.states_heading[row, 6] = 1.0
        found.covariances_heading[row] = turn @ (track.covariance + own_velocity) @ turn.T
        found.track_ids[row] = track.track_id
        found.ages_s[row] = (t_ns - track.t_seen_ns) * 1e-9
    return found


def _is_finite(odometry: Odometry) -> bool:
    """Return whether everything that neighbours are seen from is a number."""
    parts = (
        odometry.p_map, odometry.q_map_body, odometry.v_map, odometry.omega_body, odometry.covariance_velocity
    )  # fmt: skip
    return all(bool(np.isfinite(part).all()) for part in parts)
