"""The same comparison on a flight recorded elsewhere, with or without a true trajectory."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.clock import ns_to_seconds
from companion.config import MID360_IMU_POSITION_M, Profile
from companion.errors import LogError
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.geometry.trajectory import Trajectory
from companion.logs.tum import read_tum
from companion.messages import ImuSample, LidarScan
from companion.recordings.recording import RecordingSummary
from companion.recordings.source import open_recording
from sitl.bench.comparison import Result, Row, enter, results
from sitl.bench.contenders import Mount
from sitl.bench.trial import Race

_CAPACITY = 1000
_LONGEST_GAP_NS = 250_000_000
_BARE = Mount(Pose.identity(), Pose.of(MID360_IMU_POSITION_M, rotation.IDENTITY))


def measure_recording(
    recording: Path,
    truth: Path | None,
    systems: Sequence[str],
    profile: Profile | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> list[Result]:
    """Run all systems over one recording; without truth only their times are known.

    Args:
        recording: any file that `companion.recordings` reads.
        truth: TUM file with poses of the body, in seconds of the host's or the sensor's clock; the one
            that covers more of the scans is taken.
        systems: names from `sitl.bench.comparison.SYSTEMS`.
        profile: of the vehicle, for the sensor's mount and the settings of driver and odometry; without
            it the body is the LiDAR's point frame.
        on_progress: called with a short text every second of flight.

    Raises:
        LogError: if a file cannot be understood, has no scans, or the truth is of another time.
        OSError: if a file cannot be read.
    """
    known = read_tum(truth) if truth is not None else None
    source = open_recording(recording, profile.lidar if profile else None)
    mount = Mount(profile.vehicle.T_body_lidar, profile.vehicle.T_lidar_imu) if profile else _BARE
    trials, missing = enter(systems, mount, _CAPACITY, profile.odometry if profile else None)
    race = Race(trials, lambda second: on_progress(f"{recording.name}: {second} s"))
    for event in source.events():
        if isinstance(event, (ImuSample, LidarScan)):
            race.take(event)
    if not len(race.scan_end_ns):
        raise LogError(f"{recording}: no scan in it")
    true = _at_scans(known, race, truth) if known is not None and truth is not None else None
    remark = _remark(source.summary())
    found = {
        result.row.system: replace(result, row=replace(result.row, note=_joined(result.row.note, remark)))
        for result in results(recording.name, race, true)
    }
    return [
        found[name] if name in found else Result(Row(recording.name, name, note=missing[name]))
        for name in systems
    ]


def _remark(summary: RecordingSummary) -> str:
    """Return what a reader of the results has to know about the recording."""
    remark = "" if summary.complete else "the recording is damaged or ends early"
    if summary.lost:
        remark = _joined(remark, f"{summary.lost} packets lost")
    return _joined(remark, *summary.notes)


def _joined(*notes: str) -> str:
    return "; ".join(note for note in notes if note)


def _at_scans(known: Trajectory, race: Race, path: Path) -> Trajectory:
    """Return the truth at the ends of scans, by sensor time."""
    sensor_ns, host_ns = np.array(race.scan_end_ns), np.array(race.scan_host_ns)
    by_sensor, by_host = _usable(known, sensor_ns), _usable(known, host_ns)
    on_host = np.count_nonzero(by_host) > np.count_nonzero(by_sensor)
    usable, t_ns = (by_host, host_ns) if on_host else (by_sensor, sensor_ns)
    if not usable.any():
        raise LogError(
            f"{path}: the truth lasts from {_span(known.t_ns)}, but the scans from {_span(host_ns)} by the "
            f"host's clock and from {_span(sensor_ns)} by the sensor's; one of them must overlap"
        )
    true = known.at(t_ns[usable])
    return Trajectory(sensor_ns[usable], true.p, true.q)


def _usable(known: Trajectory, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return at which times (n,) the truth is known: between two poses close to each other, in order."""
    after = np.clip(np.searchsorted(known.t_ns, t_ns), 1, max(len(known) - 1, 1))
    if len(known) < 2:
        return np.zeros(len(t_ns), dtype=np.bool_)
    near = known.t_ns[after] - known.t_ns[after - 1] <= _LONGEST_GAP_NS
    newest = np.maximum.accumulate(t_ns)
    ascends = np.concatenate([[True], t_ns[1:] > newest[:-1]])
    return np.asarray(known.covers(t_ns) & near & ascends)


def _span(t_ns: NDArray[np.int64]) -> str:
    return f"{ns_to_seconds(int(t_ns[0])):.3f} to {ns_to_seconds(int(t_ns[-1])):.3f} s"
