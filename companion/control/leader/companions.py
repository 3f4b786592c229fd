"""The leader's own flock: what belongs to a follower is not an obstacle."""

from dataclasses import replace

import numpy as np

from companion.messages import NeighbourTracks, RegisteredScan


def without_companions(
    scan: RegisteredScan, tracks: NeighbourTracks | None, radius_m: float
) -> RegisteredScan:
    """Return a scan without the points of validated neighbours.

    It is for the followers to keep away from the leader; a leader that gave way to them would be driven
    by its own flock.

    Args:
        scan: what was seen.
        tracks: the neighbours at the scan's end.
        radius_m: points this near to a neighbour, where it was when they were measured, belong to it.
    """
    known = [] if tracks is None else [track for track in tracks.tracks if track.validated]
    if not known:
        return scan
    keep = np.ones(len(scan.points_map), dtype=np.bool_)
    ages_s = scan.ages_ns[:, None] * 1e-9
    for track in known:
        offsets = scan.points_map - (track.p_map - ages_s * track.v_map)
        keep &= np.einsum("ij,ij->i", offsets, offsets) > radius_m**2
    return replace(
        scan,
        points_map=scan.points_map[keep],
        reflectivity=scan.reflectivity[keep],
        ages_ns=scan.ages_ns[keep],
    )
