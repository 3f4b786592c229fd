"""What a replay found, as text for people."""

from collections.abc import Iterator, Sequence

from companion.clock import ns_to_seconds
from companion.replay.comparison import ChannelResult
from companion.replay.configuration import Changed
from companion.replay.difference import Difference
from companion.replay.motion import RPE_DISTANCE_M, Accuracy
from companion.replay.result import ReplayResult

_MAX_CHANGES = 20


def lines_of(result: ReplayResult) -> Iterator[str]:
    """Yield the lines of a report."""
    yield (
        f"{result.log}: {result.kind}, {result.duration_s:.2f} s replayed in {result.wall_s:.2f} s, "
        f"{result.real_time_factor:.1f} times real time"
    )
    yield from result.notes
    yield from _changes("configuration", result.configuration)
    yield from _changes("versions", result.versions)
    yield from _missing(result)
    if result.channels:
        yield from _table(result.channels)
        yield from _first_differences(result)
    if result.odometry is not None:
        yield (
            f"odometry: at most {_metres(result.odometry['position_m'])} and "
            f"{result.odometry['attitude_deg']:.2g} deg from the recorded"
        )
    yield from _accuracy("recorded", result.recorded_accuracy)
    yield from _accuracy("replayed", result.replayed_accuracy)
    for name, path in (("trajectory", result.tum), ("log", result.out)):
        if path is not None:
            yield f"{name}: {path}"
    if result.channels:
        yield _verdict(result)


def _changes(name: str, changes: Sequence[Changed]) -> Iterator[str]:
    if not changes:
        return
    yield f"{name}, recorded -> replayed:"
    for change in changes[:_MAX_CHANGES]:
        yield f"  {change.name}: {change.recorded} -> {change.replayed}"
    if len(changes) > _MAX_CHANGES:
        yield f"  and {len(changes) - _MAX_CHANGES} more"


def _missing(result: ReplayResult) -> Iterator[str]:
    if result.channels and not result.complete:
        yield "the log was not closed, or part of it cannot be read: it is replayed as far as it goes"
    if result.missing:
        listed = ", ".join(f"{count} on {topic}" for topic, count in result.missing.items())
        yield f"messages that the log does not hold: {listed}"
    if result.skipped:
        yield f"sensor events left out, as in flight, where perception was late: {result.skipped}"


def _table(results: Sequence[ChannelResult]) -> Iterator[str]:
    width = max(len(result.topic) for result in results)
    yield f"{'channel':<{width}}      equal  different    missing      extra    cut off"
    for result in results:
        counts = (result.equal, result.different, result.missing, result.extra, result.cut_off)
        yield f"{result.topic:<{width}}" + "".join(f"{count:>11}" for count in counts)


def _first_differences(result: ReplayResult) -> Iterator[str]:
    found = [
        (channel.topic, channel.first)
        for channel in result.channels
        if channel.first is not None and not channel.agrees
    ]
    for topic, difference in sorted(found, key=_time_of):
        t_s = ns_to_seconds(difference.t_ns - result.start_ns)
        yield f"first on {topic} at {t_s:.3f} s: {_said(difference)}"


def _time_of(found: tuple[str, Difference]) -> int:
    return found[1].t_ns


def _said(difference: Difference) -> str:
    if not difference.field:
        recorded = difference.recorded or "nothing"
        return f"{recorded} -> {difference.replayed or 'nothing'}"
    if not difference.recorded and not difference.replayed:
        return difference.field
    return f"{difference.field}: {difference.recorded} -> {difference.replayed}"


def _accuracy(name: str, accuracy: Accuracy | None) -> Iterator[str]:
    if accuracy is None:
        return
    rpe = (
        "" if accuracy.rpe_rmse_m is None else f", RPE {_metres(accuracy.rpe_rmse_m)} in {RPE_DISTANCE_M:g} m"
    )
    drift = "" if accuracy.drift_percent is None else f", drift {accuracy.drift_percent:.3f} %"
    yield f"{name} odometry against the truth: APE {_metres(accuracy.ape_rmse_m)}{rpe}{drift}"


def _metres(value: float) -> str:
    return f"{value:.4f} m" if value >= 1e-4 or value == 0.0 else f"{value:.1e} m"


def _verdict(result: ReplayResult) -> str:
    if result.equal:
        return "equal: every message came out as recorded, byte for byte"
    if not result.as_flown:
        return "different, as configuration or versions are"
    if not result.unexplained:
        return "different only where the log is incomplete"
    return "different, although configuration and versions are as in flight: " + ", ".join(result.unexplained)
