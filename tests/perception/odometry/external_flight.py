"""What another process would send of a simulated flight, and what our estimator makes of it."""

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from companion.geometry import rotation
from companion.messages import (
    ExternalOdometry,
    FloatArray,
    ImuSample,
    LidarScan,
    Odometry,
    OdometryStatus,
    RegisteredScan,
    SensorEvent,
)
from companion.perception.odometry.external import ExternalMotionEstimator
from companion.perception.odometry.external_settings import ExternalMotionSettings
from companion.perception.odometry.settings import OdometrySettings
from tests.perception.odometry.simulated_flight import (
    CLOCK_OFFSET_NS,
    T_BODY_LIDAR,
    T_LIDAR_IMU,
    SimulatedFlight,
)

Events = list[ImuSample | LidarScan]
Change = Callable[[ExternalOdometry], ExternalOdometry | None]


INITIALISING, TRACKING, DEGRADED, LOST = OdometryStatus
END_NS = 8_900_000_000


@dataclass(frozen=True)
class Peer:
    """How the other process estimates and sends."""

    hz: float = 50.0
    delay_ns: int = 20_000_000
    position_sigma_m: float = 0.005
    rotation_sigma_deg: float = 0.05
    velocity_sigma: float = 0.02
    states_velocity: bool = True
    from_s: float = 0.1


EXACT = Peer(position_sigma_m=0.0, rotation_sigma_deg=0.0, velocity_sigma=0.0)


def messages(flight: SimulatedFlight, end_ns: int, peer: Peer, seed: int = 5) -> list[ExternalOdometry]:
    """Return a message per period, with noise, in order of arrival."""
    rng = np.random.default_rng(seed)
    period_ns = round(1e9 / peer.hz)
    first = round(peer.from_s * peer.hz)
    t_sensor_ns = np.arange(first, end_ns // period_ns, dtype=np.int64) * period_ns
    p, q, v = flight.truth(t_sensor_ns)
    n = len(t_sensor_ns)
    p = p + rng.normal(0.0, peer.position_sigma_m, (n, 3))
    turn = np.radians(rng.normal(0.0, peer.rotation_sigma_deg, (n, 3)))
    q = rotation.normalize(rotation.multiply(q, rotation.exp(turn)))
    v = v + rng.normal(0.0, peer.velocity_sigma, (n, 3))
    if not peer.states_velocity:
        v = np.full((n, 3), np.nan)
    sigma = np.radians(max(peer.rotation_sigma_deg, 0.01))
    covariance = np.diag([max(peer.position_sigma_m, 0.001) ** 2] * 3 + [sigma**2] * 3)
    return [
        ExternalOdometry(
            t_ns=int(t_ns) + CLOCK_OFFSET_NS + peer.delay_ns,
            t_source_ns=int(t_ns) + 777,
            clock_offset_ns=CLOCK_OFFSET_NS - 777,
            on_lidar_clock=False,
            session=1,
            p_map=p[i],
            q_map_body=q[i],
            v_map=v[i],
            omega_body=np.full(3, np.nan),
            covariance_pose=covariance,
            covariance_velocity=np.eye(3) * peer.velocity_sigma**2,
            quality=90,
            reset_counter=0,
        )
        for i, t_ns in enumerate(t_sensor_ns)
    ]


def merged(events: list[ImuSample | LidarScan], others: list[ExternalOdometry]) -> Iterator[SensorEvent]:
    """Yield all events in order of arrival."""
    return heapq.merge(events, others, key=lambda event: event.t_ns)


def changed(others: list[ExternalOdometry], change: Change) -> list[ExternalOdometry]:
    """Return the messages that a change leaves, as it leaves them."""
    return [other for other in map(change, others) if other is not None]


def after(t_s: float, **fields: object) -> Change:
    """Return a change of some fields from a sensor time on."""
    limit_ns = round(t_s * 1e9) + CLOCK_OFFSET_NS
    return lambda other: replace(other, **fields) if other.t_valid_ns >= limit_ns else other  # type: ignore[arg-type]


@dataclass(frozen=True)
class Run:
    """What the estimator made of its events."""

    odometry: list[Odometry]
    scans: list[RegisteredScan]
    estimator: ExternalMotionEstimator

    def at(self, t_s: float) -> Odometry:
        """Return the newest odometry at a sensor time."""
        return [entry for entry in self.odometry if entry.t_sensor_ns <= t_s * 1e9][-1]

    def between(self, start_s: float, end_s: float) -> list[Odometry]:
        return [entry for entry in self.odometry if start_s * 1e9 <= entry.t_sensor_ns <= end_s * 1e9]

    @property
    def tracked(self) -> list[Odometry]:
        return [entry for entry in self.odometry if entry.status is TRACKING]


def run(
    events: Iterable[SensorEvent],
    settings: ExternalMotionSettings | None = None,
    output_hz: float = 50.0,
) -> Run:
    limits = settings or ExternalMotionSettings()
    estimator = ExternalMotionEstimator(
        OdometrySettings(source="external", external=limits, output_hz=output_hz), T_BODY_LIDAR, T_LIDAR_IMU
    )
    odometry: list[Odometry] = []
    scans: list[RegisteredScan] = []
    for event in events:
        for output in estimator.handle(event):
            if isinstance(output, RegisteredScan):
                scans.append(output)
            else:
                odometry.append(output)
    return Run(odometry, scans, estimator)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def errors(flight: SimulatedFlight, odometry: list[Odometry]) -> tuple[float, float, float]:
    """Return RMS errors of position (m), attitude (deg) and velocity (m/s)."""
    p, q, v = flight.truth(np.array([entry.t_sensor_ns for entry in odometry]))
    return (
        rms(np.linalg.norm([entry.p_map for entry in odometry] - p, axis=1)),
        rms(np.degrees(rotation.angle_between(np.array([entry.q_map_body for entry in odometry]), q))),
        rms(np.linalg.norm([entry.v_map for entry in odometry] - v, axis=1)),
    )
