"""Which gains of a law are searched, and how far at once."""

from dataclasses import dataclass

from pydantic import ValidationError

from companion.control.followers.settings import (
    CommandSettings,
    FollowerSettings,
    gains_of,
    with_gains,
)

_FIXED = frozenset(
    {
        *("body_radius_m", "band_below_m", "band_above_m", "scan_delay_s"),
        *("history_s", "beat_s", "hold_s", "still_m", "settle_s"),
    }
)
"""Sizes and times that are known, and what the laws of others define themselves by."""

OBSTACLE_GAIN = {
    "pacnav": "obstacle_mps",
    "vpf": "obstacle_mps",
    "vpf_polar": "obstacle",
    "reynolds_apf": "obstacle_m3ps",
    "lloyd": "obstacle_room_m",
}
"""The one gain that is chosen between pillars, for nothing in free space depends on it."""
_WITHOUT_EFFECT_IN_FREE_SPACE = {
    "pacnav": frozenset({"obstacle_mps", "obstacle_reach_m"}),
    "vpf": frozenset({"obstacle_mps", "obstacle_reach_m"}),
    "vpf_polar": frozenset({"obstacle", "obstacle_reach_m"}),
    "reynolds_apf": frozenset({"obstacle_m3ps", "obstacle_reach_m"}),
    "lloyd": frozenset({"obstacle_room_m"}),
}
_AT_ONCE = {"max_acceleration_mps2": 10.0}
_LEAST = {("pacnav", "force_reach_m"): 1.0}
_DIGITS = 4


@dataclass(frozen=True, slots=True)
class Axis:
    """One gain that is searched.

    Attributes:
        name: key in the law's section.
        start: where the search begins.
        low, high: how far it may go.
        spread: standard deviation of its first steps.
    """

    name: str
    start: float
    low: float
    high: float
    spread: float


def start_of(method: str) -> FollowerSettings:
    """Return the settings from which the search for a law's gains begins.

    The laws of others state velocities and leave it to the vehicle how fast those can change: the limit on
    the change of a command, which belongs to our own way of flying, is as wide as it may be for them.
    """
    start = FollowerSettings()
    if method == "flock":
        return start
    command = CommandSettings.model_validate({**start.command.model_dump(), **_AT_ONCE})
    return start.model_copy(update={"method": method, "command": command})


def axes_of(method: str) -> tuple[Axis, ...]:
    """Return the gains of a law that are searched, from its defaults on.

    Raises:
        KeyError: if there is no such law.
    """
    without = _FIXED | _WITHOUT_EFFECT_IN_FREE_SPACE.get(method, frozenset())
    return tuple(_axis(method, gain.name) for gain in gains_of(method) if gain.name not in without)


def obstacle_values(method: str, settings: FollowerSettings, count: int) -> list[float]:
    """Return values to try for the gain against obstacles, a sixteenth to sixteen times what is set."""
    axis = _axis(method, OBSTACLE_GAIN[method])
    now = float(getattr(getattr(settings, method), axis.name))
    factors = [16.0 ** (2.0 * index / (count - 1) - 1.0) for index in range(count)]
    return list(dict.fromkeys(rounded(min(max(now * factor, axis.low), axis.high)) for factor in factors))


def with_values(
    settings: FollowerSettings, method: str, axes: tuple[Axis, ...], values: list[float]
) -> FollowerSettings:
    """Return settings with the values of a search, within their bounds."""
    gains = {
        axis.name: min(max(rounded(value), axis.low), axis.high)
        for axis, value in zip(axes, values, strict=True)
    }
    return with_gains(settings, method, gains)


def rounded(value: float) -> float:
    """Return a gain with the digits with which it is stored, and so also flown."""
    return float(f"{value:.{_DIGITS}g}")


def _axis(method: str, name: str) -> Axis:
    [gain] = [gain for gain in gains_of(method) if gain.name == name]
    span = gain.high - gain.low
    low = gain.low if _is_allowed(method, name, gain.low) else rounded(gain.low + 1e-3 * span)
    low = max(low, _LEAST.get((method, name), low))
    spread = min(max(0.2 * abs(gain.default), 0.04 * span), 0.25 * span)
    return Axis(name, max(gain.default, low), low, gain.high, spread)


def _is_allowed(method: str, name: str, value: float) -> bool:
    """Return whether a gain may have a value: some bounds do not belong to their range."""
    try:
        with_gains(FollowerSettings(), method, {name: value})
    except ValidationError:
        return False
    return True
