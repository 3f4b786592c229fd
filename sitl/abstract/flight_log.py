"""Writes an abstract flight as a log that the usual viewers show."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from companion.clock import seconds_to_ns
from companion.errors import LogError
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.log_file import LogFile, LogState
from companion.logs.log_queue import LogEntry
from companion.logs.metadata import FlightMetadata
from companion.logs.records import CloudView, PathView, StampedPose
from companion.messages import FloatArray, Setpoint, Severity, StatusText
from sitl.abstract.flight import AbstractFlight
from sitl.swarm.scene import SwarmScene
from sitl.worlds.primitives import World

_FRAME = "map"
_BY = ("lead", "follow")
_CHUNK_BYTES = 1 << 20
_COMPRESSION = 3
_SURFACE_RAYS = 720
_SURFACE_HEIGHTS_M = np.arange(0.4, 4.01, 0.3)
_SURFACE_RANGE_M = 12.0
_SURFACE_EVERY_M = 8.0


def write_log(scene: SwarmScene, flight: AbstractFlight, path: Path) -> None:
    """Write where every vehicle was and what it wanted, the leader's route, the obstacles and the outcome.

    The map frame of the log is the world's, and time begins when the followers are let go. Vehicle k is in
    the channels ``/uav_<k>/pose`` and ``/uav_<k>/setpoint``; 0 is the leader.

    Args:
        scene: in which was flown.
        flight: with its trajectory.
        path: of the log; an older file of that name is replaced.

    Raises:
        ValueError: if the flight holds no trajectory.
        LogError: if it cannot be written.
    """
    trajectory = flight.trajectory
    if trajectory is None:
        raise ValueError("the flight was not recorded: fly it with record=True")
    path.unlink(missing_ok=True)
    metadata = FlightMetadata(
        vehicle="swarm", role="leader", mode="lockstep", configuration=str(flight.record), seed=scene.seed
    )
    log = LogFile(path, metadata, chunk_bytes=_CHUNK_BYTES, compression_level=_COMPRESSION, durable=False)
    vehicles = range(len(scene.starts_world))
    poses = [_own(channels.POSE, k) for k in vehicles]
    setpoints = [_own(channels.SETPOINT, k) for k in vehicles]
    log.append(LogEntry(channels.CLOUD, 0, 0, _surfaces(scene.world, trajectory.p_world)))
    log.append(LogEntry(channels.PATH, 0, 0, _route(scene, flight)))
    for sample, t in enumerate(trajectory.t):
        t_ns = seconds_to_ns(float(t))
        for k in vehicles:
            p, q = trajectory.p_world[sample, k], trajectory.q_world_body[sample, k]
            log.append(LogEntry(poses[k], t_ns, sample, StampedPose(t_ns, _FRAME, p, q)))
            wanted = Setpoint(t_ns, t_ns, 0, trajectory.command_world[sample, k], 0.0, _BY[k > 0])
            log.append(LogEntry(setpoints[k], t_ns, sample, wanted))
    record = flight.record
    severity = Severity.NOTICE if record.end == "success" else Severity.ERROR
    concerned = f" by {', '.join(map(str, record.ended_by))}" if record.ended_by else ""
    end_ns = seconds_to_ns(record.t_end_s)
    log.append(LogEntry(channels.LOG, end_ns, 0, StatusText(end_ns, severity, record.end + concerned)))
    log.close()
    if log.state is not LogState.CLOSED:
        raise LogError(log.reason)


def _own(channel: Channel, vehicle: int) -> Channel:
    return replace(channel, topic=f"/uav_{vehicle}{channel.topic}")


def _route(scene: SwarmScene, flight: AbstractFlight) -> PathView:
    points = np.vstack(list(flight.course.legs))
    return PathView(0, np.column_stack([points, np.full(len(points), scene.starts_world[0, 2])]))


def _surfaces(world: World, p_world: FloatArray) -> CloudView:
    """Return points on the obstacles along the leader's way, by level rays at several heights."""
    obstacles = world.obstacles()
    way = p_world[:, 0]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    stops = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + _SURFACE_EVERY_M, _SURFACE_EVERY_M))
    angles = np.arange(_SURFACE_RAYS) * (2.0 * np.pi / _SURFACE_RAYS)
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(_SURFACE_RAYS)], axis=1)
    points = [np.zeros((0, 3))]
    for stop in np.minimum(stops, len(way) - 1):
        for height in _SURFACE_HEIGHTS_M:
            origins = np.tile([way[stop, 0], way[stop, 1], height], (_SURFACE_RAYS, 1))
            ranges = obstacles.cast(origins, directions, _SURFACE_RANGE_M).ranges
            hit = np.isfinite(ranges)
            points.append(origins[hit] + ranges[hit, None] * directions[hit])
    cloud = np.vstack(points).astype(np.float32)
    return CloudView(0, cloud, np.full(len(cloud), 100, np.uint8))
