"""What a replay found."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from companion.replay.comparison import ChannelResult
from companion.replay.configuration import Changed
from companion.replay.motion import Accuracy


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """All that `companion replay --json` reports.

    Attributes:
        log: what was replayed.
        kind: "flight log", or the format of another recording.
        duration_s: of the recording.
        wall_s: how long the replay took.
        start_ns: host time of the recording's first message.
        configuration: settings that are not as in flight.
        versions: versions that are not as in flight.
        channels: how every channel came out; empty if nothing was recorded to compare with.
        unexplained: topics that differ although nothing explains it.
        missing: by topic, messages that the recording does not hold.
        complete: the log was closed properly and could be read to its end.
        skipped: sensor events left out because perception was late in flight.
        odometry: largest differences between recorded and replayed estimates, None if they are equal.
        recorded_accuracy, replayed_accuracy: against the truth, None without one.
        notes: one sentence each.
        tum, out: files that were written, None if not wanted.
    """

    log: Path
    kind: str
    duration_s: float
    wall_s: float
    start_ns: int
    configuration: list[Changed]
    versions: list[Changed]
    channels: list[ChannelResult]
    unexplained: list[str]
    missing: dict[str, int]
    complete: bool
    skipped: int
    odometry: dict[str, float] | None
    recorded_accuracy: Accuracy | None
    replayed_accuracy: Accuracy | None
    notes: list[str]
    tum: Path | None
    out: Path | None

    @property
    def equal(self) -> bool:
        """Whether everything came out as recorded, byte for byte."""
        return all(channel.agrees for channel in self.channels)

    @property
    def as_flown(self) -> bool:
        """Configuration and versions are those of the flight."""
        return not (self.configuration or self.versions)

    @property
    def broken(self) -> bool:
        """Something came out differently that should not have."""
        return self.as_flown and bool(self.unexplained)

    @property
    def real_time_factor(self) -> float:
        """How many times faster than the flight the replay was."""
        return self.duration_s / self.wall_s if self.wall_s > 0.0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        document = asdict(self)
        for name in ("log", "tum", "out"):
            document[name] = None if document[name] is None else str(document[name])
        return {
            **document,
            "equal": self.equal,
            "as_flown": self.as_flown,
            "broken": self.broken,
            "real_time_factor": self.real_time_factor,
        }
