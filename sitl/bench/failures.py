"""Is every failure reported in time, and nothing else? Failures injected into emulated flights."""

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.random import Generator

from companion.clock import seconds_to_ns
from companion.messages import ImuSample, Odometry, OdometryStatus, RegisteredScan
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from sitl.bench.courses import course
from sitl.bench.failure_catalogue import FAILURES, Event, Moment, lose_packets
from sitl.bench.synthetic_flights import T_BODY_LIDAR, T_LIDAR_IMU, Flight, fly
from sitl.slots import SLOT_PERIOD_NS, SLOTS_PER_PACKET

IN_TIME_MS = 300.0
"""A failure counts as reported when the odometry says so within this time."""
USABLE_QUALITY = 40
"""Odometry of lower quality is a report, whatever its status."""
SHORTEST_S = 8.0
"""Shorter flights leave no room for failures."""

_FAILING = ("indoor", "pillars", "forest")
_CLEAN = ("indoor", "pillars", "forest", "open_field", "aggressive")
_LOSS = 0.2
_WATCHED_NS = seconds_to_ns(1.0)
_FIRST_FAILURE_S = 5.0  # in the air, after take-off
_LAST_FAILURE_S = 1.5  # before the end
_TRY_AGAIN_EVENTS = 20

OnProgress = Callable[[str], None]


@dataclass(frozen=True)
class Row:
    """How one kind of failure was reported, over all runs."""

    failure: str
    runs: int
    reported: int
    reported_percent: float
    delay_ms_median: float | None
    delay_ms_max: float | None


@dataclass(frozen=True)
class Clean:
    """What was reported where nothing had failed."""

    flights: int
    seconds: float
    false_alarms: int
    false_alarm_percent: float
    reasons: tuple[str, ...]


def measure_failures(
    runs: int, seed: int, seconds: float, on_progress: OnProgress
) -> list[dict[str, object]]:
    """Inject every kind of failure in turn into emulated flights.

    Args:
        runs: injections in all.
        seed: of worlds, noise, moments and magnitudes.
        seconds: length of each flight.
        on_progress: called with what is being done.

    Returns:
        One row a failure, and a last one that sums up.

    Raises:
        ValueError: if the flights are too short to fail in.
    """
    if seconds < SHORTEST_S:
        raise ValueError(f"flights of {seconds:g} s leave no room for failures: at least {SHORTEST_S:g} s")
    delays_ms: dict[str, list[float]] = {name: [] for name in FAILURES}
    names = [list(FAILURES)[run % len(FAILURES)] for run in range(runs)]
    for index, world in enumerate(_FAILING):
        flight = fly(course(world, seed), seconds, np.random.default_rng([seed, index, 1]))
        # Each kind meets each world: a block of all kinds at a time.
        share = [name for run, name in enumerate(names) if run // len(FAILURES) % len(_FAILING) == index]
        for name, delay_ms in _fail(flight, share, seconds, np.random.default_rng([seed, index, 2])):
            delays_ms[name].append(delay_ms)
            on_progress(f"{world}: {sum(map(len, delays_ms.values()))} of {runs} failures")
    rows = []
    for name, delays in [*delays_ms.items(), ("all", [ms for part in delays_ms.values() for ms in part])]:
        if delays:
            rows.append(asdict(row_of(name, delays)))
    return rows


def measure_clean(seed: int, seconds: float, on_progress: OnProgress) -> dict[str, object]:
    """Fly every course of the benchmark without failure, whole and with a fifth of all packets lost."""
    alarms: list[str] = []
    flights = 0
    for index, world in enumerate(_CLEAN):
        flight = fly(course(world, seed), seconds, np.random.default_rng([seed, index, 3]))
        lossy = lose_packets(
            flight.events, _LOSS, SLOT_PERIOD_NS * SLOTS_PER_PACKET, np.random.default_rng([seed, index, 4])
        )
        for name, events in ((world, flight.events), (f"{world}, packets lost", lossy)):
            flights += 1
            on_progress(f"clean flight {flights} of {2 * len(_CLEAN)}: {name}")
            reason = false_alarm(events)
            if reason:
                alarms.append(f"{name}: {reason}")
    return asdict(
        Clean(
            flights=flights,
            seconds=flights * seconds,
            false_alarms=len(alarms),
            false_alarm_percent=round(100.0 * len(alarms) / flights, 2),
            reasons=tuple(alarms),
        )
    )


def passes(rows: Sequence[Mapping[str, object]], clean: Mapping[str, object]) -> bool:
    """Whether 99 % of all failures were reported in time, and 1 % of the clean flights at most."""
    reported, false = rows[-1]["reported_percent"], clean["false_alarm_percent"]
    return isinstance(reported, float) and reported >= 99.0 and isinstance(false, float) and false <= 1.0


def false_alarm(events: Iterable[Event]) -> str:
    """Fly a whole flight; return the first report after the start, or ""."""
    lio, started = odometry(), False
    for event in events:
        for entry in _told(lio, event):
            started = started or entry.status is OdometryStatus.TRACKING
            if started and is_report(entry):
                return f"{entry.t_sensor_ns * 1e-9:.1f} s: {entry.status.name.lower()}, {entry.reason}"
    return "" if started else "never started"


def first_report(lio: LidarInertialOdometry, events: Iterable[Event]) -> tuple[int, Odometry] | None:
    """Return when the odometry first says that something is wrong (host time) and what it says."""
    for event in events:
        for entry in _told(lio, event):
            if is_report(entry):
                return event.t_ns, entry
    return None


def is_report(entry: Odometry) -> bool:
    """Whether odometry says that it must not be used as it is."""
    return entry.status is not OdometryStatus.TRACKING or entry.quality < USABLE_QUALITY


def odometry() -> LidarInertialOdometry:
    """Return the odometry of the emulated vehicle."""
    return LidarInertialOdometry(OdometrySettings(), T_BODY_LIDAR, T_LIDAR_IMU)


def _told(lio: LidarInertialOdometry, event: Event) -> Iterator[Odometry]:
    for output in lio.handle(event):
        yield output.odometry if isinstance(output, RegisteredScan) else output


def _fail(
    flight: Flight, names: Sequence[str], seconds: float, rng: Generator
) -> Iterator[tuple[str, float]]:
    """Fly once; at each moment a copy of the odometry meets a failure. Yields names and delays in ms."""
    lio, position = odometry(), 0
    arrivals_ns = np.array([event.t_ns for event in flight.events], dtype=np.int64)
    moments_s = np.sort(rng.uniform(_FIRST_FAILURE_S, seconds - _LAST_FAILURE_S, len(names)))
    for moment_s, which in zip(moments_s, rng.permutation(len(names)), strict=True):
        inject = FAILURES[names[which]]
        wanted = int(np.searchsorted(arrivals_ns, seconds_to_ns(float(moment_s)) + arrivals_ns[0]))
        changed: list[Event] | None = None
        while changed is None:
            # A failure that would do no harm here happens a little later.
            while position < wanted or not isinstance(flight.events[position - 1], ImuSample):
                lio.handle(flight.events[position])
                position += 1
            moment = moment_at(flight, position)
            changed = inject(moment, rng)
            wanted = position + _TRY_AGAIN_EVENTS
        report = first_report(copy.deepcopy(lio), changed)
        delay_ms = np.inf if report is None else (report[0] - arrivals_ns[position - 1]) * 1e-6
        yield names[which], float(delay_ms)


def moment_at(flight: Flight, position: int) -> Moment:
    """Cut the events of a flight after an IMU sample; what follows is as long as it is watched."""
    newest = flight.events[position - 1]
    if not isinstance(newest, ImuSample):
        raise TypeError("a failure begins after an IMU sample")
    after = [
        event
        for event in flight.events[position : position + 2 * _WATCHED_NS // 5_000_000]
        if event.t_ns <= newest.t_ns + _WATCHED_NS
    ]
    return Moment(flight, flight.events[:position], after, newest.t_sensor_ns)


def row_of(name: str, delays_ms: Sequence[float]) -> Row:
    """Sum up the delays of one kind of failure, infinite where nothing was reported."""
    in_time = [delay for delay in delays_ms if delay <= IN_TIME_MS]
    known = [delay for delay in delays_ms if np.isfinite(delay)]
    return Row(
        failure=name,
        runs=len(delays_ms),
        reported=len(in_time),
        reported_percent=round(100.0 * len(in_time) / len(delays_ms), 2),
        delay_ms_median=round(float(np.median(known)), 1) if known else None,
        delay_ms_max=round(max(known), 1) if known else None,
    )
