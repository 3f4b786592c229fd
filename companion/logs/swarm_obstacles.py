"""How near obstacles were to the vehicles of a swarm, from the clouds that each of them recorded.

Every vehicle is measured against its own clouds in its own map, so that errors of start poses do not matter.
Recorded clouds are thinned out: several together stand for the surroundings at one time.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from companion.clock import seconds_to_ns
from companion.geometry.pose import Pose
from companion.geometry.trajectory import Trajectory
from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.logs.records import CloudView
from companion.logs.swarm_log import SwarmFlight, Vehicle
from companion.messages import FloatArray, NeighbourTracks

WINDOW_NS = seconds_to_ns(0.5)
"""A cloud counts for samples up to this much before and after it."""
UAV_RADIUS_M = 0.6
"""Points this near to another UAV belong to it: half a body, what it moves in a scan, and errors of poses."""
OWN_RADIUS_M = 0.25
"""Points this near to the vehicle are the vehicle itself."""
GROUND_M = 0.3
"""Points lower than this over the place where the vehicle's odometry began are the ground."""


def obstacle_distances(flight: SwarmFlight) -> tuple[FloatArray | None, list[str]]:
    """Return the distance (T, N) of each vehicle to the nearest point of its own clouds, m.

    Infinite where a vehicle has no cloud or no point in sight. None if no log holds a cloud.

    Returns:
        The distances, and what must be known to judge them.
    """
    columns = [_distances(flight, vehicle) for vehicle in flight.vehicles]
    seeing = [
        name for name, column in zip(flight.names, columns, strict=True) if not np.all(np.isnan(column))
    ]
    if not seeing:
        return None, ["MDO: not known, for no log holds clouds at these times"]
    notes = []
    if len(seeing) < len(columns):
        notes.append(f"MDO: rests on the clouds of {', '.join(seeing)} only")
    distances = np.column_stack(columns)
    unseen = np.all(np.isnan(distances), axis=1)
    if unseen.any():
        notes.append(f"MDO: no cloud for {100.0 * unseen.mean():.1f} % of the time")
    return np.where(np.isnan(distances), np.inf, distances), notes


def _distances(flight: SwarmFlight, vehicle: Vehicle) -> FloatArray:
    """Return one vehicle's distances (T,): NaN where it has no cloud, infinite where clouds hold nothing."""
    nearest = np.full(len(flight.t_ns), np.nan)
    in_map = vehicle.in_map
    if in_map is None:
        return nearest
    t_own_ns = flight.t_ns - vehicle.shift_ns
    inside = in_map.covers(t_own_ns)
    own = np.full((len(t_own_ns), 3), np.nan)
    own[inside] = in_map.at(t_own_ns[inside]).p
    for cloud, tracks in _clouds(vehicle):
        first, last = np.searchsorted(t_own_ns, [cloud.t_ns - WINDOW_NS, cloud.t_ns + WINDOW_NS + 1])
        steps = np.arange(first, last)[inside[first:last]]
        if not len(steps) or not in_map.covers(np.array([cloud.t_ns])).all():
            continue
        points = _obstacle_points(flight, vehicle, in_map, cloud, tracks)
        found = np.full(len(steps), np.inf)
        if len(points):
            found = np.asarray(cKDTree(points).query(own[steps])[0], dtype=np.float64)
        nearest[steps] = np.fmin(nearest[steps], found)
    return nearest


def _clouds(vehicle: Vehicle) -> Iterator[tuple[CloudView, NeighbourTracks | None]]:
    """Yield the clouds of a log with what the vehicle knew of the others then."""
    tracks = None
    for entry in FlightRecording(vehicle.path).messages(channels.CLOUD, channels.NEIGHBOURS):
        if isinstance(entry.message, NeighbourTracks):
            tracks = entry.message
        elif isinstance(entry.message, CloudView):
            yield entry.message, tracks


def _obstacle_points(
    flight: SwarmFlight,
    vehicle: Vehicle,
    in_map: Trajectory,
    cloud: CloudView,
    tracks: NeighbourTracks | None,
) -> FloatArray:
    """Return a cloud's points (n, 3) in the map without the ground, the vehicle itself and the others."""
    points = cloud.points_map.astype(np.float64)
    points = points[np.all(np.isfinite(points), axis=1)]
    points = points[points[:, 2] >= GROUND_M]
    body = in_map.at(np.array([cloud.t_ns], dtype=np.int64))
    strangers = [(body.p[0], OWN_RADIUS_M)]
    strangers += [(p_map, UAV_RADIUS_M) for p_map in _others(flight, vehicle, body, cloud.t_ns)]
    if tracks is not None and abs(tracks.t_ns - cloud.t_ns) <= WINDOW_NS:
        age_s = (cloud.t_ns - tracks.t_ns) * 1e-9
        strangers += [
            (track.p_map + age_s * track.v_map, UAV_RADIUS_M) for track in tracks.tracks if track.validated
        ]
    for centre, radius in strangers:
        points = points[np.linalg.norm(points - centre, axis=1) > radius]
    return points


def _others(flight: SwarmFlight, vehicle: Vehicle, body: Trajectory, t_own_ns: int) -> list[FloatArray]:
    """Return where the other vehicles were, in this one's map."""
    t_ns: NDArray[np.int64] = np.array([t_own_ns + vehicle.shift_ns], dtype=np.int64)
    if not vehicle.in_common.covers(t_ns).all():
        return []
    here = vehicle.in_common.at(t_ns)
    T_map_common = Pose(body.p[0], body.q[0]) @ Pose(here.p[0], here.q[0]).inverse()
    others = [other.in_common for other in flight.vehicles if other is not vehicle]
    return [T_map_common.transform(other.at(t_ns).p[0]) for other in others if other.covers(t_ns).all()]
