"""Whether the published covariance is true: errors of many flights in units of what they claim.

The normalised estimation error squared (NEES) of a vector is e' C^-1 e. Were C true, it would follow a
chi-square distribution with as many degrees of freedom as e has entries, and its mean over runs would lie
within known bounds around that number. Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with
Applications to Tracking and Navigation", 2001, section 5.4.2.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import chi2

from companion.clock import seconds_to_ns
from companion.geometry import rotation
from companion.messages import FloatArray, Odometry, OdometryStatus
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from sitl.bench.courses import COURSES, course
from sitl.bench.synthetic_flights import T_BODY_LIDAR, T_LIDAR_IMU, stream
from sitl.kinematics import Kinematics

ALL = "all"
"""Name of the row that takes all worlds together."""

INSTANTS = (0.25, 0.5, 0.75, 1.0)
"""Where a flight is judged, as shares of its duration."""

_OUTPUT_HZ = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Errors at one instant of one flight, with what was claimed of them.

    Attributes:
        p_error: (3,) in the map, metres.
        turn_error: (3,) rotation from the true to the estimated body, in the body, radians.
        v_error: (3,) in the map, m/s.
        odometry: the estimate.
    """

    p_error: FloatArray
    turn_error: FloatArray
    v_error: FloatArray
    odometry: Odometry

    @property
    def nees(self) -> FloatArray:
        """NEES (3,) of position, attitude and velocity, each by its three degrees of freedom."""
        pose = self.odometry.covariance_pose
        pairs = (
            (self.p_error, pose[:3, :3]),
            (self.turn_error, pose[3:, 3:]),
            (self.v_error, self.odometry.covariance_velocity),
        )
        return np.array([error @ np.linalg.solve(covariance, error) / 3.0 for error, covariance in pairs])


@dataclass(frozen=True)
class Row:
    """Consistency in one world; NEES are means by degree of freedom, 1 if the covariance is true.

    Attributes:
        world: its name, or `ALL`.
        runs: flights.
        position_nees: mean over flights and instants.
        attitude_nees: the same.
        velocity_nees: the same.
        lower_95: where 95 % of such means over as many flights begin.
        upper_95: where they end.
        position_inside_percent: share of single values below their own 95 % quantile.
        attitude_inside_percent: the same.
        position_error_cm: root mean square.
        position_sigma_cm: what was claimed of it.
        attitude_error_deg: root mean square.
        attitude_sigma_deg: what was claimed of it.
        lost: instants without a tracked estimate; they count nowhere else.
    """

    world: str
    runs: int
    position_nees: float
    attitude_nees: float
    velocity_nees: float
    lower_95: float
    upper_95: float
    position_inside_percent: float
    attitude_inside_percent: float
    position_error_cm: float
    position_sigma_cm: float
    attitude_error_deg: float
    attitude_sigma_deg: float
    lost: int

    @property
    def consistent(self) -> bool:
        """Whether position and attitude lie within the bounds and no instant was lost."""
        means = (self.position_nees, self.attitude_nees)
        return self.lost == 0 and all(self.lower_95 <= mean <= self.upper_95 for mean in means)


def fly(world: str, duration_s: float, seed: int, settings: OdometrySettings) -> list[Sample | None]:
    """Fly one course of its own world, chip and noise; return what each of `INSTANTS` showed, if anything."""
    lio = LidarInertialOdometry(settings, T_BODY_LIDAR, T_LIDAR_IMU)
    wanted = [seconds_to_ns(share * duration_s) for share in INSTANTS]
    samples: list[Sample | None] = []
    start: Kinematics | None = None
    newest: Sample | None = None
    # Other noise in every world, so that all flights of a campaign are independent.
    chance = np.random.default_rng([seed, 2 + list(COURSES).index(world)])
    for step in stream(course(world, seed), duration_s, chance):
        start = start or step.truth
        for event in step.events:
            for output in lio.handle(event):
                if isinstance(output, Odometry) and output.t_sensor_ns == step.t_sensor_ns:
                    newest = _sample(output, start, step.truth)
        if len(samples) < len(wanted) and step.t_sensor_ns >= wanted[len(samples)]:
            samples.append(newest)
    return samples


def _sample(odometry: Odometry, start: Kinematics, truth: Kinematics) -> Sample | None:
    """Compare with the truth in a level frame at the true start with its heading; None unless tracked."""
    if odometry.status not in (OdometryStatus.TRACKING, OdometryStatus.DEGRADED):
        return None
    back = rotation.from_yaw(-rotation.yaw_of(start.q_world_body))
    q_true = rotation.multiply(back, truth.q_world_body)
    return Sample(
        odometry.p_map - rotation.rotate(back, truth.p_world - start.p_world),
        rotation.log(rotation.multiply(rotation.conjugate(q_true), odometry.q_map_body)),
        odometry.v_map - rotation.rotate(back, truth.v_world),
        odometry,
    )


def bounds(runs: int) -> tuple[float, float]:
    """Return where 95 % of the means over independent runs of a true 3-vector's NEES / 3 lie."""
    return float(chi2.ppf(0.025, 3 * runs) / (3 * runs)), float(chi2.ppf(0.975, 3 * runs) / (3 * runs))


def judge(world: str, flights: Sequence[Sequence[Sample | None]]) -> Row:
    """Return the row of a world's flights.

    The instants of one flight share its biases and its map, so the bounds are those of the flights alone.
    """
    samples = [sample for flight in flights for sample in flight if sample is not None]
    lost = sum(len(flight) for flight in flights) - len(samples)
    nees = np.array([sample.nees for sample in samples]).reshape(-1, 3)
    means = nees.mean(axis=0) if len(nees) else np.full(3, np.nan)
    inside = 100.0 * (nees < chi2.ppf(0.95, 3) / 3.0).mean(axis=0) if len(nees) else np.full(3, np.nan)
    lower, upper = bounds(len(flights))
    variances = [np.diagonal(sample.odometry.covariance_pose) for sample in samples]
    return Row(
        world=world,
        runs=len(flights),
        position_nees=round(float(means[0]), 3),
        attitude_nees=round(float(means[1]), 3),
        velocity_nees=round(float(means[2]), 3),
        lower_95=round(lower, 3),
        upper_95=round(upper, 3),
        position_inside_percent=round(float(inside[0]), 1),
        attitude_inside_percent=round(float(inside[1]), 1),
        position_error_cm=_rms(100.0 * np.array([sample.p_error for sample in samples])),
        position_sigma_cm=_rms(100.0 * np.sqrt([variance[:3] for variance in variances])),
        attitude_error_deg=_rms(np.degrees([sample.turn_error for sample in samples])),
        attitude_sigma_deg=_rms(np.degrees(np.sqrt([variance[3:] for variance in variances]))),
        lost=lost,
    )


def _rms(vectors: FloatArray) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return round(float(np.sqrt(np.mean(np.sum(np.square(vectors).reshape(-1, 3), axis=1)))), 4)


def measure(
    worlds: Sequence[str],
    runs: int,
    duration_s: float,
    seed: int,
    on_run: Callable[[str, int, Row], None],
    settings: OdometrySettings | None = None,
) -> Iterator[Row]:
    """Fly every world with as many seeds; yield a row of each, then one of all together.

    Args:
        worlds: names in `courses.COURSES`.
        runs: flights in each.
        duration_s: of a flight, of which about two seconds are rest.
        seed: of the first flight; each flight has its own world, biases and noise.
        on_run: called with the world, the number of its flights so far and their row so far.
        settings: of the odometry, the defaults without.
    """
    used = (settings or OdometrySettings()).model_copy(update={"output_hz": _OUTPUT_HZ})
    everything: list[list[Sample | None]] = []
    for world in worlds:
        flights: list[list[Sample | None]] = []
        for index in range(runs):
            flights.append(fly(world, duration_s, seed + index, used))
            on_run(world, index + 1, judge(world, flights))
        everything += flights
        yield judge(world, flights)
    if len(worlds) > 1:
        yield judge(ALL, everything)


def as_dict(row: Row) -> dict[str, object]:
    """Return a row for tables and JSON."""
    return {**asdict(row), "consistent": row.consistent}
