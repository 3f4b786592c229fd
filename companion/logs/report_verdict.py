"""Ten lines that say how the flight went, each with a lamp."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from companion.logs.report_numbers import STREAM_GAP_LIMIT_MS, Numbers

_MISSING = "not in this log"


class Lamp(IntEnum):
    """How a line of the verdict looks; the highest is the worst."""

    UNKNOWN = 0
    GREEN = 1
    AMBER = 2
    RED = 3


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the verdict."""

    title: str
    text: str
    lamp: Lamp


def verdict(numbers: Numbers) -> list[Line]:
    """Return the ten lines."""
    return [line(numbers) for line in _LINES]


def worst(lines: list[Line]) -> Lamp:
    """Return the worst lamp of a verdict."""
    return max((line.lamp for line in lines), default=Lamp.UNKNOWN)


def _graded(value: float, amber: float, red: float) -> Lamp:
    """Return the lamp of a value that is worse the larger it is."""
    if value >= red:
        return Lamp.RED
    return Lamp.AMBER if value >= amber else Lamp.GREEN


def _counted(value: int) -> str:
    """Return an integer with its thousands set apart."""
    return f"{value:,}".replace(",", " ")


def _time(numbers: Numbers) -> Line:
    flight = numbers["flight"]
    airborne = flight["airborne_s"]
    text = f"{flight['duration_s']:.1f} s recorded"
    if airborne is not None:
        text += f", {airborne:.1f} s in the air"
    return Line("Time", text, Lamp.GREEN if airborne else Lamp.UNKNOWN)


def _distance(numbers: Numbers) -> Line:
    motion = numbers["motion"]
    if motion["distance_m"] is None:
        return Line("Distance", _MISSING, Lamp.UNKNOWN)
    text = f"{motion['distance_m']:.1f} m flown, fastest {motion['max_speed_mps']:.2f} m/s"
    return Line("Distance", text + f", highest {motion['max_height_m']:.1f} m", Lamp.GREEN)


def _goal(numbers: Numbers) -> Line:
    goal = numbers["goal"]
    if goal is None:
        return Line("Goal", "no plan in this log", Lamp.UNKNOWN)
    nearest = goal["nearest_m"]
    distance = "" if nearest is None else f", nearest {nearest:.2f} m from it"
    if goal["reached"]:
        return Line("Goal", f"reached at {goal['reached_s']:.1f} s{distance}", Lamp.GREEN)
    return Line("Goal", f"not reached (waypoint {goal['waypoint']}){distance}", Lamp.AMBER)


def _obstacles(numbers: Numbers) -> Line:
    closest = numbers["obstacles"]["closest_m"]
    if closest is None:
        return Line("Obstacles", "nothing seen at flight level", Lamp.UNKNOWN)
    lamp = Lamp.RED if closest < 0.4 else Lamp.AMBER if closest < 0.8 else Lamp.GREEN
    text = f"closest {closest:.2f} m at {numbers['obstacles']['closest_s']:.1f} s"
    return Line("Obstacles", f"{text}, seen at flight level by the LiDAR", lamp)


def _failsafes(numbers: Numbers) -> Line:
    found = numbers["failsafes"]
    if not found:
        return Line("Failsafes", "none, no takeover", Lamp.GREEN)
    shown = "; ".join(f"{one['t_s']:.1f} s {one['what']}: {one['reason']}" for one in found[:4])
    more = f"; and {len(found) - 4} more" if len(found) > 4 else ""
    lamp = Lamp.RED if any(one["severe"] for one in found) else Lamp.AMBER
    return Line("Failsafes", shown + more, lamp)


def _control(numbers: Numbers) -> Line:
    control = numbers["control"]
    if control is None:
        return Line("In control", _MISSING, Lamp.UNKNOWN)
    text = ", ".join(
        f"{who} {control[f'{who}_percent']:.0f} %" for who in ("companion", "pilot", "autopilot")
    )
    return Line("In control", f"{text} of the time in the air", Lamp.GREEN)


def _lidar(numbers: Numbers) -> Line:
    lidar = numbers["lidar"]
    if lidar["loss_percent"] is None:
        return Line("LiDAR", _MISSING, Lamp.UNKNOWN)
    total = lidar["packets"] + lidar["lost"]
    text = f"{lidar['loss_percent']:.2f} % of {_counted(total)} packets lost"
    return Line("LiDAR", text, _graded(lidar["loss_percent"], 1.0, 10.0))


def _odometry(numbers: Numbers) -> Line:
    odometry, accuracy = numbers["odometry"], numbers["accuracy"]
    if odometry is None or odometry["tracking_percent"] is None:
        return Line("Odometry", _MISSING, Lamp.UNKNOWN)
    text = f"tracking {odometry['tracking_percent']:.1f} %, lowest quality {odometry['quality_min']}"
    text += f", {odometry['resets']} resets"
    if accuracy is not None:
        text += f"; error {accuracy['ape_rmse_m']:.3f} m RMSE"
        drift = accuracy["drift_percent"]
        text += "" if drift is None else f", drift {drift:.2f} %"
        text += f", map tilted {accuracy['map_tilt_deg']:.1f} deg"
    lamp = _graded(100.0 - odometry["tracking_percent"], 1.0, 20.0)
    if odometry["lost_percent"] or odometry["resets"]:
        lamp = Lamp.RED
    return Line("Odometry", text, lamp)


def _commands(numbers: Numbers) -> Line:
    latency, setpoints = numbers["latency_ms"], numbers["setpoints"]
    gap = setpoints["gap_ms"]
    if gap is None or setpoints["rate_hz"] is None:
        return Line("Commands", "no setpoint stream in this log", Lamp.UNKNOWN)
    text = f"{setpoints['rate_hz']:.1f} Hz, longest gap {gap['max']:.0f} ms"
    if latency is not None:
        text += f"; scan to setpoint {latency['p50']:.0f} ms median, {latency['p99']:.0f} ms p99"
    return Line("Commands", text, _graded(gap["max"], 0.4 * STREAM_GAP_LIMIT_MS, STREAM_GAP_LIMIT_MS))


def _log(numbers: Numbers) -> Line:
    log = numbers["log"]
    missing = sum(log["missing_by_topic"].values())
    text = f"{_counted(log['messages'])} messages, {log['bytes_total'] / 1e6:.1f} MB"
    if log["complete"] and not missing and not log["undecodable"]:
        return Line("Log", f"complete: {text}", Lamp.GREEN)
    faults = [] if log["complete"] else ["not closed properly"]
    if log["bytes_lost"]:
        faults.append(f"{log['bytes_lost']} bytes unreadable")
    if missing:
        faults.append(f"{missing} messages left out")
    if log["undecodable"]:
        faults.append(f"{log['undecodable']} not understood")
    return Line("Log", f"{', '.join(faults)}: {text}", Lamp.AMBER)


_LINES: tuple[Callable[[Numbers], Line], ...] = (
    _time,
    _distance,
    _goal,
    _obstacles,
    _failsafes,
    _control,
    _lidar,
    _odometry,
    _commands,
    _log,
)
