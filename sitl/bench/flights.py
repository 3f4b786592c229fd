"""Whole flights over many seeds: does every one arrive, and how well?"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from companion.kernel_cache import load_kernels
from sitl.lockstep import fly_lockstep
from sitl.outcome import Outcome, evaluate
from sitl.scenario import load_scenario, set_stage
from sitl.wire import fly_wire

OnRow = Callable[[dict[str, object]], None]


def measure(
    scenario: Path, seeds: int, folder: Path, *, wire: bool, on_row: OnRow
) -> list[dict[str, object]]:
    """Fly seeds 1 to `seeds`; returns one row a flight and a last one that sums up.

    Args:
        scenario: YAML file.
        seeds: number of flights.
        folder: where each flight's log is written and, when it succeeded, deleted again.
        wire: over real sockets and in real time.
        on_row: called with each row as soon as it is known.
    """
    load_kernels()
    wanted = load_scenario(scenario)
    outcomes: list[Outcome] = []
    rows: list[dict[str, object]] = []
    for seed in range(1, seeds + 1):
        log = folder / f"seed{seed}.mcap"
        log.unlink(missing_ok=True)
        stage = set_stage(wanted, scenario.parent, seed)
        ending = fly_wire(stage, log) if wire else fly_lockstep(stage, log)
        outcome = evaluate(ending, log)
        if outcome.success:
            log.unlink()
        outcomes.append(outcome)
        rows.append(_row(str(seed), outcome))
        on_row(rows[-1])
    rows.append(_summary(outcomes))
    on_row(rows[-1])
    return rows


def _row(seed: str, outcome: Outcome) -> dict[str, object]:
    return {
        "seed": seed,
        "success": outcome.success,
        "reason": outcome.reason,
        "collisions": outcome.collisions,
        "ape_rmse_m": outcome.odometry.ape_rmse_m,
        "drift_percent": outcome.odometry.drift_percent,
        "latency_p99_ms": outcome.latency_ms.p99,
        "max_gap_ms": outcome.setpoints.max_gap_ms,
        "lost_packets": outcome.livox.lost,
        "real_time_factor": outcome.real_time_factor,
    }


def _summary(outcomes: list[Outcome]) -> dict[str, object]:
    """Return the worst of everything but speed, of which the median counts."""

    def worst(values: list[float | None]) -> float | None:
        known = [value for value in values if value is not None]
        return max(known) if known else None

    arrived = sum(outcome.success for outcome in outcomes)
    return {
        "seed": "worst",
        "success": arrived == len(outcomes),
        "reason": f"{arrived} of {len(outcomes)} arrived",
        "collisions": sum(outcome.collisions for outcome in outcomes),
        "ape_rmse_m": worst([outcome.odometry.ape_rmse_m for outcome in outcomes]),
        "drift_percent": worst([outcome.odometry.drift_percent for outcome in outcomes]),
        "latency_p99_ms": worst([outcome.latency_ms.p99 for outcome in outcomes]),
        "max_gap_ms": worst([outcome.setpoints.max_gap_ms for outcome in outcomes]),
        "lost_packets": sum(outcome.livox.lost for outcome in outcomes),
        "real_time_factor": float(np.median([outcome.real_time_factor for outcome in outcomes])),
    }
