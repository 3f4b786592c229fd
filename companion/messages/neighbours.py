"""The other UAVs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourTrack:
    """Another UAV as the tracker follows it.

    Attributes:
        track_id: its number; never used again for another one.
        p_map: (3,) centre of its body at the time of `NeighbourTracks`, m.
        v_map: (3,) m/s.
        covariance: (6, 6) of position, then velocity, in the map.
        t_born_ns: host time of its first observation.
        t_seen_ns: host time of the newest scan in which it was observed.
        points: returns of its body in that scan's stack.
        bright_share: share of them that came from reflective tape.
        validated: it has proved to be a UAV, and its position can be relied on; others are candidates, or
            were lost from sight too long ago, and must not be relied on.
    """

    track_id: int
    p_map: FloatArray
    v_map: FloatArray
    covariance: FloatArray
    t_born_ns: int
    t_seen_ns: int
    points: int
    bright_share: float
    validated: bool


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourTracks:
    """All tracks after one scan.

    Attributes:
        t_ns: host time for which positions hold: the scan's end.
        sequence: the scan's sequence number.
        tracks: in order of their numbers.
    """

    t_ns: int
    sequence: int
    tracks: tuple[NeighbourTrack, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The nearest other UAVs, as a follower's controller sees them.

    The heading frame has its origin in the own body, x where the nose points, z up.

    Attributes:
        t_ns: host time for which positions hold.
        track_ids: (k,) numbers of the tracks, nearest first; -1 where there is none.
        states_heading: (k, 7) relative position m, relative velocity m/s, and 1 where there is a neighbour
            (all zero otherwise).
        covariances_heading: (k, 6, 6) of relative position and velocity; zero where there is none.
        ages_s: (k,) time since each was last seen; zero where there is none.
    """

    t_ns: int
    track_ids: NDArray[np.int64]
    states_heading: FloatArray
    covariances_heading: FloatArray
    ages_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a follower's law was given of others and of obstacles.

    Attributes:
        t_ns: host time of the decision.
        neighbours: the others.
        t_scan_ns: host time of the scan from which the grid was made.
        yaw_map: heading in which it was made, rad.
        ranges: (azimuths, elevations) nearest range in every cell, m; infinite where nothing is.
    """

    t_ns: int
    neighbours: Neighbours
    t_scan_ns: int
    yaw_map: float
    ranges: FloatArray
