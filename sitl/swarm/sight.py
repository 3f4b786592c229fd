"""Whether a follower knows where the leader is: its own validated tracks against the truth."""

import numpy as np

from companion.clock import ns_to_seconds, seconds_to_ns
from companion.geometry import rotation
from companion.messages import NeighbourTracks, Odometry
from sitl.swarm.table import NEVER_S, Table

_GATE_M = 0.75
_KEPT_NS = seconds_to_ns(1.0)


class LeaderSight:
    """Compares one follower's tracks with where everybody was at the time for which they hold.

    A track is the leader's if it lies within 0.75 m of where the leader was and no other vehicle was
    nearer to it. Relative positions are compared, turned by the follower's true attitude, so that drift of
    its map does not count.

    Attributes:
        seen_s: host time of the newest scan in which it was so; NEVER_S before any.
    """

    def __init__(self, number: int) -> None:
        """Watch vehicle `number`."""
        self._number = number
        self._past: dict[int, Table] = {}
        self._judged_ns = 0
        self.seen_s = NEVER_S

    def remember(self, t_ns: int, table: Table) -> None:
        """Keep where everybody is at host time `t_ns`; call with every step."""
        self._past[t_ns] = table
        self._past.pop(t_ns - _KEPT_NS, None)

    def judge(self, tracks: NeighbourTracks | None, odometry: Odometry | None) -> None:
        """Take what the companion knows now; only what is new counts.

        Args:
            tracks: its newest tracks.
            odometry: own motion at the same scan's end.
        """
        if tracks is None or odometry is None or tracks.t_ns == self._judged_ns:
            return
        self._judged_ns = tracks.t_ns
        past = self._nearest(tracks.t_ns)
        if past is None:
            return
        q_world_body = past.q_world_body[self._number]
        others = np.delete(past.p_world, self._number, axis=0) - past.p_world[self._number]
        for track in tracks.tracks:
            if not track.validated:
                continue
            p_body = rotation.rotate(rotation.conjugate(odometry.q_map_body), track.p_map - odometry.p_map)
            distances = np.linalg.norm(others - rotation.rotate(q_world_body, p_body), axis=1)
            if distances[0] < _GATE_M and distances[0] == distances.min():
                self.seen_s = ns_to_seconds(tracks.t_ns)

    def _nearest(self, t_ns: int) -> Table | None:
        if not self._past:
            return None
        return self._past[min(self._past, key=lambda kept_ns: abs(kept_ns - t_ns))]
