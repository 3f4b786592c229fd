"""The whole of one replay: open, configure, run, compare, write what was asked for."""

import contextlib
from dataclasses import dataclass
from pathlib import Path

import companion
from companion.assembly import assemble
from companion.clock import SystemClock
from companion.config import profile_text
from companion.errors import LogError
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.container import LIBRARY, MAGIC
from companion.logs.metadata import software_versions, source_commit
from companion.logs.reader import FlightRecording
from companion.logs.tum import require_place, write_tum
from companion.recordings.source import open_recording
from companion.replay.configuration import Changed, changed_tables, replay_profile, with_assignments
from companion.replay.flight import SENSOR_INPUTS, FlightReplay
from companion.replay.holes import Holes
from companion.replay.motion import LargestDifference, Paths
from companion.replay.output import ReplayLog
from companion.replay.recorder import PERCEPTION, ReplayRecorder, made_topics
from companion.replay.result import ReplayResult
from companion.replay.stopwatch import Progress, Stopwatch

_HEAD_BYTES = 64


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """What is to be replayed, and how.

    Attributes:
        log: the recording.
        assignments: settings to change, as ``key.path=value``.
        profile: instead of the recorded configuration; needed where none was recorded.
        odometry_only: leave decisions out.
        tum: file for the replayed path.
        out: file for a new log.
    """

    log: Path
    assignments: tuple[str, ...] = ()
    profile: Path | None = None
    odometry_only: bool = False
    tum: Path | None = None
    out: Path | None = None


def replay(request: ReplayRequest, clock: SystemClock, on_progress: Progress | None = None) -> ReplayResult:
    """Replay a recording.

    Raises:
        LogError: if it cannot be read or holds no raw packets, or an output cannot be written.
        ProfileError: if the configuration to replay with is wrong.
    """
    if request.tum is not None:
        require_place(request.tum)
    if _is_flight_log(request.log):
        return _FlightRun(request, clock, on_progress).run()
    return _replay_recording(request, clock, on_progress)


def _is_flight_log(path: Path) -> bool:
    """Whether a file begins like our own logs."""
    if path.is_dir():
        return False
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return head.startswith(MAGIC) and LIBRARY.encode() in head


class _FlightRun:
    """One replay of a flight log."""

    def __init__(self, request: ReplayRequest, clock: SystemClock, on_progress: Progress | None) -> None:
        self._request = request
        self._recording = FlightRecording(request.log)
        self._profile, self._configuration = replay_profile(
            self._recording.configuration, request.log, request.assignments, request.profile
        )
        if next(self._recording.encoded(channels.LIDAR_PACKETS), None) is None:
            raise LogError(
                f"{request.log}: no raw LiDAR packets in this log; a flight with log.raw_lidar: true has them"
            )
        self._holes = Holes()
        self._paths = Paths()
        self._largest = LargestDifference()
        self._watch = Stopwatch(clock, on_progress)

    def run(self) -> ReplayResult:
        with contextlib.ExitStack() as files:
            output = files.enter_context(self._output()) if self._request.out is not None else None
            recorder = ReplayRecorder(
                self._profile.log,
                decisions=not self._request.odometry_only,
                on_odometry=self._largest.take,
                output=output,
            )
            flight = FlightReplay(
                self._profile,
                recorder,
                self._holes,
                odometry_only=self._request.odometry_only,
                on_update=self._paths.take_update,
            )
            for entry in self._recording.encoded(*self._wanted()):
                self._watch.observe(entry.t_ns, self._recording.progress)
                self._holes.observe(entry)
                self._paths.take_entry(entry)
                recorder.compare(entry)
                if output is not None:
                    output.copy(entry)
                flight.take(entry)
            flight.finish()
        if self._request.tum is not None:
            write_tum(self._request.tum, self._paths.replayed_scans.trajectory())
        return self._result(recorder, flight)

    def _wanted(self) -> tuple[Channel, ...]:
        """Return the channels that have to be read; all if they go into a new log too."""
        if self._request.odometry_only and self._request.out is None:
            return tuple({*SENSOR_INPUTS, *PERCEPTION, channels.TRUTH})
        return ()

    def _output(self) -> ReplayLog:
        assert self._request.out is not None
        return ReplayLog(
            self._request.out,
            replay_of=self._request.log,
            flight=self._recording.flight,
            configuration=profile_text(self._profile),
            made=made_topics(decisions=not self._request.odometry_only),
        )

    def _result(self, recorder: ReplayRecorder, flight: FlightReplay) -> ReplayResult:
        complete = self._recording.integrity().complete
        results = recorder.results(lambda channel: flight.ends_of(channel, complete=complete))
        recorded_accuracy, replayed_accuracy = self._paths.accuracies()
        return ReplayResult(
            log=self._request.log,
            kind="flight log" + "".join(f", {said}" for said in self._said_of_the_flight()),
            duration_s=self._watch.seconds,
            wall_s=self._watch.wall_s,
            start_ns=self._watch.start_ns,
            configuration=self._configuration,
            versions=self._versions(),
            channels=results,
            unexplained=[result.topic for result in results if not self._holes.explain(result)],
            missing=dict(sorted(self._holes.missing.items())),
            complete=complete,
            skipped=flight.perception.skipped,
            odometry=self._largest.as_dict() if self._largest.found else None,
            recorded_accuracy=recorded_accuracy,
            replayed_accuracy=replayed_accuracy,
            notes=[],
            tum=self._request.tum,
            out=self._request.out,
        )

    def _said_of_the_flight(self) -> list[str]:
        table = self._recording.flight
        return [table[name] for name in ("mode", "vehicle", "role") if name in table]

    def _versions(self) -> list[Changed]:
        recorded, now = dict(self._recording.versions), software_versions()
        flown = self._recording.flight.get("git_commit", "")
        here = source_commit(Path(companion.__file__).parents[1])
        if flown and here:
            recorded, now = {**recorded, "source": flown}, {**now, "source": here}
        return changed_tables(recorded, now)


def _replay_recording(
    request: ReplayRequest, clock: SystemClock, on_progress: Progress | None
) -> ReplayResult:
    """Replay a recording of the sensor alone, in any format that can be read."""
    open_recording(request.log)  # a file of no known kind is told so before anything else
    if not request.odometry_only or request.out is not None:
        raise LogError(
            f"{request.log}: no flight log, so there are no decisions: replay it with --odometry-only"
        )
    if request.profile is None:
        raise LogError(f"{request.log}: no flight log, so it has no configuration: name one with --profile")
    profile = with_assignments(request.profile, request.assignments)
    watch, paths = Stopwatch(clock, on_progress), Paths()
    pipeline = assemble(profile)
    recording = open_recording(request.log, profile.lidar)
    for event in recording.events():
        watch.observe(event.t_ns, None)
        for update in pipeline.perceive(event):
            paths.take_update(update)
    if request.tum is not None:
        write_tum(request.tum, paths.replayed_scans.trajectory())
    summary = recording.summary()
    return ReplayResult(
        log=request.log,
        kind=summary.kind,
        duration_s=watch.seconds,
        wall_s=watch.wall_s,
        start_ns=watch.start_ns,
        configuration=[],
        versions=[],
        channels=[],
        unexplained=[],
        missing={},
        complete=summary.complete,
        skipped=0,
        odometry=None,
        recorded_accuracy=None,
        replayed_accuracy=None,
        notes=[*summary.lines(), paths.said()],
        tum=request.tum,
        out=None,
    )
