"""The numbers of a flight, computed from its data; None where the log does not tell."""

import math
from typing import Any

import numpy as np

from companion.geometry.trajectory_comparison import Comparison, compare, path_length
from companion.logs.obstacle_view import GROUND_CLEARANCE_M
from companion.logs.report_data import FlightData, Phase, phases
from companion.messages import FlightState, FloatArray, OdometryStatus, VehicleMode

Numbers = dict[str, Any]

PATH_STEP_M = 0.1
STREAM_GAP_LIMIT_MS = 500.0
_NEW_STREAM_S = 0.5
_PILOT_MODES = frozenset(
    {
        VehicleMode.MANUAL,
        VehicleMode.STABILIZED,
        VehicleMode.ACRO,
        VehicleMode.ALTITUDE,
        VehicleMode.POSITION,
    }
)


def compute(data: FlightData) -> tuple[Numbers, Comparison | None]:
    """Return all numbers, ready for JSON, and the comparison with the truth if the log contains it."""
    comparison = _comparison(data)
    numbers = {
        "flight": {**data.flight, "duration_s": data.duration_s, "airborne_s": _airborne_s(data)},
        "motion": _motion(data),
        "goal": _goal(data),
        "obstacles": _obstacles(data),
        "surroundings": _surroundings(data),
        "failsafes": _failsafes(data),
        "control": _control(data),
        "lidar": _lidar(data),
        "odometry": _odometry(data),
        "accuracy": _accuracy(comparison),
        "latency_ms": _percentiles(latencies_ms(data)),
        "setpoints": _setpoints(data),
        "log": _log(data),
    }
    return numbers, comparison


def mode_phases(data: FlightData) -> list[Phase]:
    """Return the autopilot's modes over time."""
    return phases([(t, mode.value) for t, mode in data.modes], data.duration_s)


def state_phases(data: FlightData) -> list[Phase]:
    """Return the companion's states over time."""
    if not data.states:
        return []
    first = (0.0, data.states[0].previous.value)
    return phases(
        [first, *((data.seconds(change.t_ns), change.current.value) for change in data.states)],
        data.duration_s,
    )


def airborne_phases(data: FlightData) -> list[Phase]:
    """Return when the autopilot believed it flew, and when not."""
    labels = np.where(data.vehicle["airborne"] > 0.0, "in the air", "on the ground").tolist()
    return phases(list(zip(data.vehicle["t"].tolist(), labels, strict=True)), data.duration_s)


def odometry_phases(data: FlightData) -> list[Phase]:
    """Return the health of the own-motion estimate over time."""
    table = data.odometry
    names = [OdometryStatus(int(status)).name.lower() for status in table["status"]]
    return phases(list(zip(table["t"].tolist(), names, strict=True)), data.duration_s)


def latencies_ms(data: FlightData) -> FloatArray:
    """Return, for every scan, the time from its last packet to the first setpoint that rests on it."""
    t, t_scan = data.setpoints["t"], data.setpoints["t_scan"]
    if not len(t):
        return np.zeros(0)
    new_scan = np.append(True, t_scan[1:] != t_scan[:-1]) & np.isfinite(t_scan)
    # A stream that begins, begins with a scan seen long before: its age is not latency.
    within_stream = np.append(False, np.diff(t) < _NEW_STREAM_S)
    return np.asarray((t - t_scan)[new_scan & within_stream] * 1e3)


def gaps_ms(data: FlightData) -> FloatArray:
    """Return the times between setpoints while the autopilot was in OFFBOARD."""
    t = data.setpoints["t"]
    if not data.modes:
        return np.diff(t) * 1e3
    streams = [
        t[(t >= phase.start_s) & (t <= phase.end_s)]
        for phase in mode_phases(data)
        if phase.label == VehicleMode.OFFBOARD.value
    ]
    return np.concatenate([np.zeros(0), *(np.diff(stream) * 1e3 for stream in streams)])


def _airborne_s(data: FlightData) -> float | None:
    if not len(data.vehicle):
        return None
    return sum(p.end_s - p.start_s for p in airborne_phases(data) if p.label == "in the air")


def _surroundings(data: FlightData) -> Numbers | None:
    """Return what a follower's law was given; None where the log holds none of it."""
    if not len(data.given) and not len(data.grids):
        return None
    counts = data.given["count"]
    return {
        "neighbours_mean": float(counts.mean()) if len(counts) else None,
        "neighbours_least": int(counts.min()) if len(counts) else None,
        "alone_share": float(np.mean(counts == 0)) if len(counts) else None,
        "nearest_neighbour_m": _least(data.given["nearest"]),
        "nearest_obstacle_m": _least(data.grids["nearest"]),
    }


def _least(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else None


def _comparison(data: FlightData) -> Comparison | None:
    table, truth = data.odometry, data.truth
    if not len(table) or not len(truth):
        return None
    # The map jumps at a reset: compare the longest stretch between two of them.
    resets = table["resets"]
    values, counts = np.unique(resets, return_counts=True)
    usable = np.isin(table["status"], [OdometryStatus.TRACKING, OdometryStatus.DEGRADED])
    chosen = usable & (resets == values[np.argmax(counts)])
    return compare(
        table["t"][chosen],
        table["x y z"][chosen],
        table["qw qx qy qz"][chosen],
        truth["t"],
        truth["x y z"],
        truth["qw qx qy qz"],
    )


def _accuracy(comparison: Comparison | None) -> Numbers | None:
    if comparison is None:
        return None
    error = comparison.error_m
    return {
        "ape_rmse_m": comparison.ape_rmse_m,
        "end_error_m": comparison.end_error_m,
        "max_error_m": float(error.max()),
        "drift_percent": comparison.drift_percent,
        "map_tilt_deg": math.degrees(comparison.map_tilt),
        "true_path_m": comparison.path_m,
    }


def _motion(data: FlightData) -> Numbers:
    table = data.odometry
    finite = np.all(np.isfinite(table["x y z vx vy vz"]), axis=1)
    if not finite.any():
        return {"distance_m": None, "max_speed_mps": None, "max_height_m": None}
    p, resets = table["x y z"][finite], table["resets"][finite]
    distance = sum(path_length(p[resets == value], PATH_STEP_M) for value in np.unique(resets))
    return {
        "distance_m": float(distance),
        "max_speed_mps": float(np.linalg.norm(table["vx vy vz"][finite], axis=1).max()),
        "max_height_m": float(p[:, 2].max()),
    }


def _goal(data: FlightData) -> Numbers | None:
    if not data.plans:
        return None
    goal = data.plans[-1].goal_map
    arrived = [t for t, status in data.plan_statuses if status == "arrived"]
    p = data.odometry["x y z"]
    p = p[np.all(np.isfinite(p), axis=1)]
    nearest = float(np.linalg.norm(p - goal, axis=1).min()) if len(p) else None
    return {
        "reached": bool(arrived),
        "reached_s": arrived[0] if arrived else None,
        "nearest_m": nearest,
        "waypoint": data.plans[-1].waypoint,
        "goal_map": goal.tolist(),
    }


def _obstacles(data: FlightData) -> Numbers:
    t, nearest = data.marks["t"], data.marks["nearest"]
    finite = np.isfinite(data.odometry["z"])
    if not len(t) or not finite.any():
        return {"closest_m": None, "closest_s": None}
    z = data.odometry["z"][finite]
    height = np.interp(t, data.odometry["t"][finite], z) - z[0]
    flying = np.isfinite(nearest) & (height >= GROUND_CLEARANCE_M)
    if not flying.any():
        return {"closest_m": None, "closest_s": None}
    best = int(np.argmin(np.where(flying, nearest, np.inf)))
    return {"closest_m": float(nearest[best]), "closest_s": float(t[best])}


def _failsafes(data: FlightData) -> list[Numbers]:
    found: list[Numbers] = []
    for change in data.states:
        severe = change.current is FlightState.LOST or "failsafe" in change.reason
        if severe or change.current in (FlightState.HOLDING, FlightState.PILOT, FlightState.LISTENING):
            t = data.seconds(change.t_ns)
            found.append({"t_s": t, "what": change.current.value, "reason": change.reason, "severe": severe})
    flags = data.vehicle["failsafe"] > 0.0
    rises = np.flatnonzero(np.diff(np.append(False, flags).astype(np.int8)) > 0)
    found.extend(
        {
            "t_s": float(t),
            "what": "autopilot",
            "reason": "the autopilot reports a critical state",
            "severe": True,
        }
        for t in data.vehicle["t"][rises]
    )
    return sorted(found, key=lambda failsafe: float(failsafe["t_s"]))


def _control(data: FlightData) -> Numbers | None:
    """Return the shares of the time in the air (of all time if it never flew) by who commanded."""
    if not data.modes:
        return None
    flying = [phase for phase in airborne_phases(data) if phase.label == "in the air"]
    flying = flying or [Phase(data.modes[0][0], data.duration_s, "")]
    seconds = {"companion": 0.0, "pilot": 0.0, "autopilot": 0.0}
    for mode in mode_phases(data):
        who = "autopilot"
        if mode.label == VehicleMode.OFFBOARD.value:
            who = "companion"
        elif VehicleMode(mode.label) in _PILOT_MODES:
            who = "pilot"
        seconds[who] += sum(
            max(0.0, min(mode.end_s, phase.end_s) - max(mode.start_s, phase.start_s)) for phase in flying
        )
    total = sum(seconds.values())
    return {f"{who}_percent": 100.0 * value / total if total else 0.0 for who, value in seconds.items()}


def _lidar(data: FlightData) -> Numbers:
    packets = lost = None
    if len(data.lidar):
        packets, lost = int(data.lidar.last("packets")), int(data.lidar.last("lost"))
    elif len(data.frames):
        packets = int(data.frames["packets"].sum())
        lost = int(np.maximum(data.frames["expected"] - data.frames["packets"], 0.0).sum())
    total = (packets or 0) + (lost or 0)
    return {
        "packets": packets,
        "lost": lost,
        "loss_percent": 100.0 * (lost or 0) / total if total else None,
        "scans": len(data.marks) or len(data.frames) or None,
    }


def _odometry(data: FlightData) -> Numbers | None:
    table = data.odometry
    if not len(table):
        return None
    status, quality = table["status"], table["quality"]
    started = status != OdometryStatus.INITIALISING
    counted = int(np.count_nonzero(started))
    t = table["t"]
    return {
        "tracking_percent": _share(status == OdometryStatus.TRACKING, counted),
        "degraded_percent": _share(status == OdometryStatus.DEGRADED, counted),
        "lost_percent": _share(status == OdometryStatus.LOST, counted),
        "quality_min": int(quality[started].min()) if counted else None,
        "resets": int(table["resets"].max() - table["resets"].min()),
        "rate_hz": (len(t) - 1) / (t[-1] - t[0]) if len(t) > 1 and t[-1] > t[0] else None,
        "max_gap_ms": float(np.diff(t).max() * 1e3) if len(t) > 1 else None,
    }


def _share(mask: np.ndarray[Any, np.dtype[np.bool_]], total: int) -> float | None:
    return 100.0 * int(np.count_nonzero(mask)) / total if total else None


def _setpoints(data: FlightData) -> Numbers:
    gaps = gaps_ms(data)
    table = data.setpoints
    age_ms = (table["t"] - table["t_data"]) * 1e3
    return {
        "count": len(table),
        "rate_hz": 1e3 / float(gaps.mean()) if len(gaps) and gaps.mean() > 0.0 else None,
        "gap_ms": _percentiles(gaps),
        "age_ms": _percentiles(age_ms[np.isfinite(age_ms)]),
    }


def _percentiles(values: FloatArray) -> Numbers | None:
    if not len(values):
        return None
    p50, p95, p99 = np.percentile(values, [50.0, 95.0, 99.0])
    return {"p50": float(p50), "p95": float(p95), "p99": float(p99), "max": float(values.max())}


def _log(data: FlightData) -> Numbers:
    found = data.integrity
    if found is None:
        return {}
    return {
        "complete": found.complete,
        "bytes_total": found.bytes_total,
        "bytes_lost": found.bytes_lost,
        "messages": sum(found.messages.values()),
        "messages_by_topic": found.messages,
        "missing_by_topic": found.missing,
        "undecodable": found.undecodable,
        "unknown": found.unknown,
    }
