"""Is every failure reported in time, and nothing else? Failures injected into emulated flights."""

import copy
from collections.abc import Callable, Sequence
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

IN_TIME_S = 0.3
"""A failure counts as reported when the odometry says so within this time."""
USABLE_QUALITY = 40

_FAILING = ("indoor", "pillars", "forest")
_CLEAN = ("indoor", "pillars", "forest", "open_field", "aggressive")
_WATCHED_S = 1.0
_FIRST_FAILURE_S = 5.0  # in the air, after take-off
_LOSS = 0.2
_FAULT_TRIES = 20

OnRow = Callable[[dict[str, object]], None]


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
    """What was reported where nothing failed."""

    flights: int
    seconds: float
    false_alarms: int
    false_alarm_percent: float
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class _Run:
    failure: str
    t_sensor_ns: int
    seed: int


def measure(runs: int, seed: int, seconds: float, on_row: OnRow) -> tuple[list[dict[str, object]], dict[str, object]]:
    """Inject every kind of failure in turn into flights, then fly as many clean ones.

    Args:
        runs: injections in all.
        seed: of worlds, noise, moments and magnitudes.
        seconds: length of each flight.
        on_row: called with each row as soon as it is known.

    Returns:
        One row a failure with a last one that sums up, and the result of clean flight.
    """
    delays_ms: dict[str, list[float | None]] = {name: [] for name in FAILURES}
    names = list(FAILURES)
    for index, world in enumerate(_FAILING):
        share = [names[run % len(names)] for run in range(runs) if (run // len(names)) % len(_FAILING) == index]
        if share:
            rng = np.random.default_rng([seed, index])
            flight = fly(course(world, seed), seconds, np.random.default_rng([seed, index, 1]))
            for name, delay_ms in _fail(flight, share, seconds, rng):
                delays_ms[name].append(delay_ms)
    rows = [asdict(_row(name, delays)) for name, delays in delays_ms.items() if delays]
    rows.append(asdict(_row("all", [delay for delays in delays_ms.values() for delay in delays])))
    for row in rows:
        on_row(row)
    return rows, asdict(_clean(seed, seconds))


def first_report_ns(lio: LidarInertialOdometry, events: Sequence[Event]) -> int | None:
    """Return the host time at which the odometry first says that something is wrong, None if never."""
    for event in events:
        if any(_is_report(output) for output in lio.handle(event)):
            return event.t_ns
    return None


def _fail(
    flight: Flight, names: Sequence[str], seconds: float, rng: Generator
) -> list[tuple[str, float | None]]:
    """Fly once; at each moment let a copy of the odometry meet the failure."""
    latest_s = seconds - _WATCHED_S
    if latest_s <= _FIRST_FAILURE_S:
        raise ValueError(f"flights of {seconds} s are too short: at least {_FIRST_FAILURE_S + 2.0} s")
    moments = np.sort(rng.uniform(_FIRST_FAILURE_S, latest_s, len(names)))
    order = rng.permutation(len(names))
    lio = _odometry()
    results: list[tuple[str, float | None]] = []
    position = 0
    for moment_s, which in zip(moments, order, strict=True):
        moment_ns, begun = seconds_to_ns(float(moment_s)), position
        while flight.events[position].t_ns - flight.events[0].t_ns < moment_ns or not isinstance(
            flight.events[position], ImuSample
        ):
            lio.handle(flight.events[position])
            position += 1
        lio.handle(flight.events[position])
        position += 1
        name = names[which]
        del begun
        moment = _moment(flight, position)
        changed = FAILURES[name](moment, rng)
        if changed is None:
            continue
        failed_ns = moment.before[-1].t_ns
        reported_ns = first_report_ns(copy.deepcopy(lio), changed)
        results.append((name, None if reported_ns is None else (reported_ns - failed_ns) * 1e-6))
    return results
