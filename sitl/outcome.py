"""What a simulated flight came to, computed from its log and the simulator's own truth."""

import hashlib
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from companion.clock import ns_to_seconds
from companion.geometry.trajectory_comparison import compare
from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.logs.records import StampedPose, Statistics
from companion.messages import MavlinkMessage, Odometry, OdometryStatus, Setpoint

_HASH_BLOCK = 1 << 20


@dataclass(frozen=True, slots=True)
class Ending:
    """How the simulation itself saw the flight end.

    Attributes:
        success: the vehicle landed at its goal without touching anything.
        reason: one sentence.
        goal_distance_m: horizontal distance between the place of landing and the goal.
        collisions: contacts with anything but the ground.
        sim_time_s, wall_time_s: simulated and real duration.
    """

    success: bool
    reason: str
    goal_distance_m: float
    collisions: int
    sim_time_s: float
    wall_time_s: float


@dataclass(frozen=True, slots=True)
class OdometryError:
    """Own-motion error against the truth.

    Attributes:
        ape_rmse_m: root mean square position error after the best rigid alignment of both paths.
        drift_percent: position error at the end over the path's length, both paths laid together at their
            first pose.
        map_tilt_deg: how far the map's vertical is from the true one; an accelerometer at rest cannot tell
            its bias from a tilt.
    """

    ape_rmse_m: float | None
    drift_percent: float | None
    map_tilt_deg: float | None


@dataclass(frozen=True, slots=True)
class Latency:
    """From the reception of a scan's last packet to the first setpoint that rests on it."""

    p50: float | None
    p99: float | None


@dataclass(frozen=True, slots=True)
class SetpointStream:
    """How steadily setpoints left while the companion was in control."""

    rate_hz: float | None
    max_gap_ms: float | None


@dataclass(frozen=True, slots=True)
class LidarLink:
    """Point packets received and missing."""

    packets: int
    lost: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """All that `sitl run --json` reports."""

    success: bool
    reason: str
    goal_distance_m: float
    sim_time_s: float
    wall_time_s: float
    real_time_factor: float
    collisions: int
    odometry: OdometryError
    latency_ms: Latency
    setpoints: SetpointStream
    livox: LidarLink
    log: str
    log_sha256: str

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return asdict(self)


def evaluate(ending: Ending, log_path: Path) -> Outcome:
    """Read the flight's log and join it with how the simulation ended."""
    odometry: list[Odometry] = []
    truth: list[StampedPose] = []
    setpoints: list[Setpoint] = []
    t_sent_ns: list[int] = []
    link = LidarLink(0, 0)
    wanted = (channels.ODOMETRY, channels.TRUTH, channels.SETPOINT, channels.MAVLINK_TX, channels.STATISTICS)
    for entry in FlightRecording(log_path).messages(*wanted):
        match entry.message:
            case Odometry() as message if message.status is not OdometryStatus.INITIALISING:
                odometry.append(message)
            case StampedPose() as message:
                truth.append(message)
            case Setpoint() as message:
                setpoints.append(message)
            case MavlinkMessage(name="SET_POSITION_TARGET_LOCAL_NED"):
                t_sent_ns.append(entry.t_ns)
            case Statistics(source="lidar", values=values):
                link = LidarLink(int(values["packets"]), int(values["lost"]))
    factor = ending.sim_time_s / ending.wall_time_s if ending.wall_time_s > 0.0 else 0.0
    return Outcome(
        success=ending.success,
        reason=ending.reason,
        goal_distance_m=ending.goal_distance_m,
        sim_time_s=ending.sim_time_s,
        wall_time_s=ending.wall_time_s,
        real_time_factor=factor,
        collisions=ending.collisions,
        odometry=odometry_error(odometry, truth),
        latency_ms=latency(setpoints, t_sent_ns),
        setpoints=stream(t_sent_ns),
        livox=link,
        log=str(log_path),
        log_sha256=sha256_of(log_path),
    )


def odometry_error(odometry: list[Odometry], truth: list[StampedPose]) -> OdometryError:
    """Compare own motion with the truth, as the flight's report does."""
    if not odometry or not truth:
        return OdometryError(None, None, None)
    comparison = compare(
        np.array([ns_to_seconds(state.t_ns) for state in odometry]),
        np.array([state.p_map for state in odometry]),
        np.array([state.q_map_body for state in odometry]),
        np.array([ns_to_seconds(pose.t_ns) for pose in truth]),
        np.array([pose.p for pose in truth]),
        np.array([pose.q for pose in truth]),
    )
    if comparison is None:
        return OdometryError(None, None, None)
    return OdometryError(comparison.ape_rmse_m, comparison.drift_percent, math.degrees(comparison.map_tilt))


def latency(setpoints: list[Setpoint], t_sent_ns: list[int]) -> Latency:
    """Return percentiles in ms over the first setpoint of every scan, until it has left the process."""
    sent = np.array(t_sent_ns, dtype=np.int64)
    seen: set[int] = set()
    delays_ms: list[float] = []
    for setpoint in setpoints:
        if setpoint.t_scan_ns and setpoint.t_scan_ns not in seen:
            seen.add(setpoint.t_scan_ns)
            index = int(np.searchsorted(sent, setpoint.t_ns))
            if index < len(sent):
                delays_ms.append(1e3 * ns_to_seconds(int(sent[index]) - setpoint.t_scan_ns))
    # The first scan of a stretch in control was seen before control began: its age is not latency.
    counted = delays_ms[1:]
    if not counted:
        return Latency(None, None)
    return Latency(float(np.percentile(counted, 50)), float(np.percentile(counted, 99)))


def stream(t_sent_ns: list[int]) -> SetpointStream:
    """Return the mean rate and the longest gap between setpoints that left the process."""
    if len(t_sent_ns) < 2:
        return SetpointStream(None, None)
    gaps_s = np.diff(t_sent_ns) * 1e-9
    return SetpointStream(float(1.0 / np.mean(gaps_s)), float(1e3 * np.max(gaps_s)))


def sha256_of(path: Path) -> str:
    """Return the hash of a file as hexadecimal text."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_HASH_BLOCK):
            digest.update(block)
    return digest.hexdigest()
