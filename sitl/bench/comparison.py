"""One flight, several systems: rows of the table, and what the plots need."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from companion.geometry import rotation
from companion.geometry.trajectory import Trajectory
from companion.messages import FloatArray
from companion.perception.odometry.settings import OdometrySettings
from sitl.bench.contenders import CompanionOdometry, Contender, Mount
from sitl.bench.judgement import Judgement, judge
from sitl.bench.peers import KissIcp, RkoLio, SmallGicp
from sitl.bench.trial import Race, Trial

COMPANION = "companion"
PEERS: dict[str, Callable[[Mount], Contender]] = {
    "rko_lio": RkoLio,
    "kiss_icp": KissIcp,
    "small_gicp": SmallGicp,
}
SYSTEMS = (COMPANION, *PEERS)


@dataclass(frozen=True)
class Row:
    """One system in one flight; None where it cannot be told.

    Attributes:
        ape_rmse_m, attitude_rmse_deg, drift_percent: see `sitl.bench.judgement`.
        max_error_m: largest distance after the same alignment.
        velocity_rmse_mps: of the velocity at the ends of scans.
        ms_median, ms_p99: real time of the call that registers a scan.
        cpu_ms_median, cpu_ms_p99: processor time of the same call, all threads of the process.
        sample_cpu_us: mean processor time of the call that takes an inertial sample.
        coverage_percent: share of the scans for which it gave a pose.
        failures: calls that raised or gave nonsense.
        memory_growth_mib: growth of the process after the first minute; only if the system ran alone.
        path_m: length of the true path.
        scans: how many count.
        note: why something is missing.
    """

    world: str
    system: str
    ape_rmse_m: float | None = None
    drift_percent: float | None = None
    ms_median: float | None = None
    ms_p99: float | None = None
    cpu_ms_median: float | None = None
    cpu_ms_p99: float | None = None
    attitude_rmse_deg: float | None = None
    max_error_m: float | None = None
    velocity_rmse_mps: float | None = None
    sample_cpu_us: float | None = None
    coverage_percent: float | None = None
    failures: int = 0
    memory_growth_mib: float | None = None
    path_m: float | None = None
    scans: int = 0
    seed: int | None = None
    setup: str = ""
    note: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return the row for tables and JSON, rounded to what is meaningful."""
        return {
            name: round(value, 4) if isinstance(value, float) else value
            for name, value in asdict(self).items()
        }

    def shown(self) -> dict[str, str]:
        """Return the row as cells for people, by column."""
        ape_cm = None if self.ape_rmse_m is None else 100.0 * self.ape_rmse_m
        return {
            "world": f"{self.world:<10}",
            "system": f"{self.system:<10}",
            "APE cm": _cell(ape_cm, 2, 8),
            "drift %": _cell(self.drift_percent, 3, 7),
            "att. deg": _cell(self.attitude_rmse_deg, 3, 8),
            "ms": _cell(self.ms_median, 2, 6),
            "p99": _cell(self.ms_p99, 2, 6),
            "CPU ms": _cell(self.cpu_ms_median, 2, 6),
            "CPU p99": _cell(self.cpu_ms_p99, 2, 7),
            "sample us": _cell(self.sample_cpu_us, 0, 9),
            "scans %": _cell(self.coverage_percent, 1, 7),
            "note": self.note,
        }


@dataclass(frozen=True, eq=False)
class Result:
    """A row and the path behind it."""

    row: Row
    judgement: Judgement | None = None
    start_ns: int = 0


def enter(
    systems: Sequence[str], mount: Mount, capacity: int, settings: OdometrySettings | None = None
) -> tuple[list[Trial], dict[str, str]]:
    """Set up the systems; returns those that can run, and why the others cannot.

    Args:
        systems: names from `SYSTEMS`.
        mount: of the sensor.
        capacity: expected number of scans.
        settings: of our own odometry, its defaults if None.
    """
    entries = {name: _enter(name, mount, capacity, settings) for name in systems}
    trials = [entry for entry in entries.values() if isinstance(entry, Trial)]
    return trials, {name: entry for name, entry in entries.items() if isinstance(entry, str)}


def _enter(name: str, mount: Mount, capacity: int, settings: OdometrySettings | None) -> Trial | str:
    """Return the system ready to run, or why it cannot."""
    if name == COMPANION:
        return Trial(name, CompanionOdometry(mount, settings), capacity, forgiving=False)
    try:
        return Trial(name, PEERS[name](mount), capacity)
    except ImportError as error:
        return f"not installed ({' '.join(str(error).split())}): pip install 'companion[bench]'"


def results(
    world: str,
    race: Race,
    truth: Trajectory | None,
    *,
    seed: int | None = None,
    v_true: FloatArray | None = None,
) -> list[Result]:
    """Judge every system of a finished race.

    Args:
        world: name for the rows.
        race: finished.
        truth: of the body by sensor time, None if nobody knows.
        seed: for the rows.
        v_true: (n, 3) velocities that go with `truth`, at the ends of scans.
    """
    return [_result(world, race, trial, truth, seed, v_true) for trial in race.trials]


def _result(
    world: str,
    race: Race,
    trial: Trial,
    truth: Trajectory | None,
    seed: int | None,
    v_true: FloatArray | None,
) -> Result:
    whole = trial.track.trajectory()
    counted = race.counted(whole.t_ns)
    estimate = Trajectory(whole.t_ns[counted], whole.p[counted], whole.q[counted])
    judgement = judge(estimate, truth) if truth is not None and len(truth) else None
    scans = int(np.count_nonzero(race.counted(np.array(race.scan_end_ns))))
    wall_ms, cpu_ms = trial.track.wall_ms[counted], trial.track.cpu_ms[counted]
    remark = trial.remark if len(estimate) < scans else ""
    row = Row(
        world=world,
        system=trial.name,
        ape_rmse_m=judgement.ape_rmse_m if judgement else None,
        drift_percent=judgement.drift_percent if judgement else None,
        ms_median=_percentile(wall_ms, 50.0),
        ms_p99=_percentile(wall_ms, 99.0),
        cpu_ms_median=_percentile(cpu_ms, 50.0),
        cpu_ms_p99=_percentile(cpu_ms, 99.0),
        attitude_rmse_deg=judgement.attitude_rmse_deg if judgement else None,
        max_error_m=float(judgement.error_m.max()) if judgement else None,
        velocity_rmse_mps=_velocity_rmse(trial, judgement, truth, v_true),
        sample_cpu_us=1e-3 * trial.sample_cpu_ns / trial.samples if trial.samples else None,
        coverage_percent=100.0 * len(estimate) / scans if scans else None,
        failures=trial.failures,
        memory_growth_mib=race.growth_mib if len(race.trials) == 1 else None,
        path_m=_path_m(truth, race),
        scans=scans,
        seed=seed,
        setup=trial.setup,
        note=trial.note or remark or ("no true path was given" if truth is None else ""),
    )
    return Result(row, judgement, race.scan_end_ns[0] if len(race.scan_end_ns) else 0)


def _cell(value: float | None, digits: int, width: int) -> str:
    return ("-" if value is None else f"{value:.{digits}f}").rjust(width)


def _percentile(values: FloatArray, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


def _path_m(truth: Trajectory | None, race: Race) -> float | None:
    if truth is None:
        return None
    counted = race.counted(truth.t_ns)
    return float(np.linalg.norm(np.diff(truth.p[counted], axis=0), axis=1).sum())


def _velocity_rmse(
    trial: Trial, judgement: Judgement | None, truth: Trajectory | None, v_true: FloatArray | None
) -> float | None:
    if judgement is None or truth is None or v_true is None:
        return None
    whole = trial.track.trajectory()
    v_map = trial.track.v_map[np.isin(whole.t_ns, judgement.t_ns)]
    if not np.isfinite(v_map).all():
        return None
    true = v_true[np.searchsorted(truth.t_ns, judgement.t_ns)]
    difference = rotation.rotate(judgement.q_true_map, v_map) - true
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
