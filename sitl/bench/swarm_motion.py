"""Where the UAVs of a swarm want to be, and the velocities that take them there without collision.

A plan gives reference positions of all vehicles at any time; vehicle 0 carries the sensor. Following it,
a vehicle steers clear of what stands in the world and of the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from companion.messages import FloatArray
from sitl.dynamics import QuadrotorState
from sitl.worlds.primitives import World

Plan = Callable[[float], FloatArray]
"""Reference positions (n, 3) in the world at a time in seconds since the plan began."""

PASS_REACH_M = 13.0
LANE_ROOM_M = 3.5

_TURN_MPS2 = 1.5
_LEAD_S = 0.5
_RAMP_S = 2.0
_PULL_PER_S = 1.0
_CORRECTION_MAX = 1.5
_LAG_S = 0.5
_OBSTACLE_ROOM_M = 0.75
_VEHICLE_ROOM_M = 0.9
_CAREFUL_M = 2.5
_LOWEST_M = 0.8


@dataclass(frozen=True)
class Ring:
    """Vehicles on a circle about the ego vehicle that swing to and fro along it.

    Attributes:
        radius_m: mean distance to the ego vehicle.
        vehicles: how many.
        speed: greatest speed along the circle, m/s; lowered where the turn would be too tight.
        breath_m: amplitude by which each moves in and out, and up and down.
        elevation_deg: range of mean elevations seen from the ego vehicle.
    """

    radius_m: float
    vehicles: int
    speed: float = 2.0
    breath_m: float = 0.25
    elevation_deg: tuple[float, float] = (1.0, 12.0)


def rings(rng: Generator, wanted: Sequence[Ring], height_m: float, sway_m: float) -> Plan:
    """Return a plan of rings about the ego vehicle, every second one swinging the other way.

    The ego vehicle sways near the origin.
    """
    radii = np.concatenate([np.full(ring.vehicles, ring.radius_m) for ring in wanted])
    azimuths = np.concatenate(
        [
            rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(ring.vehicles) / max(ring.vehicles, 1)
            for ring in wanted
        ]
    )
    elevations = np.radians(
        np.concatenate([rng.uniform(*ring.elevation_deg, ring.vehicles) for ring in wanted])
    )
    breath = np.concatenate([np.full(ring.vehicles, ring.breath_m) for ring in wanted])
    speeds = np.minimum(
        np.concatenate([np.full(ring.vehicles, ring.speed) for ring in wanted]), np.sqrt(1.5 * radii)
    )
    senses = np.concatenate([np.full(ring.vehicles, 1.0 - 2.0 * (k % 2)) for k, ring in enumerate(wanted)])
    swing_rate = np.concatenate(
        [np.full(ring.vehicles, 2.0 / max(ring.speed, 1.0)) for ring in wanted]
    )  # accelerates at 2 m/s^2 at most
    phases = rng.uniform(0.0, 2.0 * np.pi, (3, len(radii)))
    rates = rng.uniform(0.5, 0.9, (2, len(radii)))
    own_phases = rng.uniform(0.0, 2.0 * np.pi, 3)

    def plan(t: float) -> FloatArray:
        own = sway_m * np.sin(np.array([0.4, 0.53, 0.37]) * t + own_phases) + [0.0, 0.0, height_m]
        azimuth = azimuths + senses * speeds / (radii * swing_rate) * np.sin(swing_rate * t)
        distance = radii + breath * np.sin(rates[0] * t + phases[0])
        others = np.column_stack(
            [
                distance * np.cos(azimuth),
                distance * np.sin(azimuth),
                height_m + radii * np.tan(elevations) + 0.6 * breath * np.sin(rates[1] * t + phases[1]),
            ]
        )
        return np.vstack([own, others])

    return plan


def passes(
    rng: Generator, vehicles: int, nearest_m: float, speed: float, height_m: float, sway_m: float
) -> Plan:
    """Return a plan of vehicles that pass the ego vehicle on straight lanes at constant velocity.

    They turn where they are out of its sight, farther than `PASS_REACH_M`. Lanes lie to its left and
    right in turn, the nearest two at `nearest_m`, the others `LANE_ROOM_M` farther out each.

    Args:
        rng: of heading, phases and heights.
        vehicles: how many pass.
        nearest_m: of the nearest lanes.
        speed: on the straight, m/s.
        height_m: of the ego vehicle.
        sway_m: amplitude of the ego vehicle's sway.
    """
    numbers = np.arange(vehicles)
    lanes = (nearest_m + LANE_ROOM_M * (numbers // 2)) * (1.0 - 2.0 * (numbers % 2))
    heading = rng.uniform(0.0, 2.0 * np.pi)
    straight_s, turn_s = 2.0 * PASS_REACH_M / speed, 2.0 * speed / _TURN_MPS2
    # Nobody is turning at the start, and all pass within the first lap.
    phases = rng.uniform(0.2, 0.45, vehicles) * straight_s
    heights = height_m + np.abs(lanes) * np.tan(np.radians(rng.uniform(2.0, 8.0, vehicles)))
    own_phases = rng.uniform(0.0, 2.0 * np.pi, 3)

    def plan(t: float) -> FloatArray:
        own = sway_m * np.sin(np.array([0.4, 0.53, 0.37]) * t + own_phases) + [0.0, 0.0, height_m]
        lap, late = np.divmod(t + phases, straight_s + turn_s)
        turning = np.maximum(late - straight_s, 0.0)
        along = speed * (np.minimum(late, straight_s) + turning) - 0.5 * _TURN_MPS2 * turning**2
        along = (along - PASS_REACH_M) * np.where(lap % 2 == 0, 1.0, -1.0)
        c, s = np.cos(heading), np.sin(heading)
        return np.vstack([own, np.column_stack([c * along - s * lanes, s * along + c * lanes, heights])])

    return plan


def figure_eight(
    rng: Generator, vehicles: int, half_axes_m: tuple[float, float], speed: float, height_m: float
) -> Plan:
    """Return a plan of a swarm that moves around an ellipse.

    Its members meanwhile fly a figure eight, which takes them past each other.
    """
    heading = rng.uniform(0.0, 2.0 * np.pi)
    phases = 2.0 * np.pi * np.arange(vehicles) / vehicles
    heights = height_m + 0.3 * np.where(np.arange(vehicles) < 0.5 * vehicles, -1.0, 1.0)
    reach, rate = 1.1 + 0.35 * vehicles, 0.4
    round_rate = speed / (0.5 * sum(half_axes_m))

    def plan(t: float) -> FloatArray:
        angle = round_rate * t
        centre = np.array([half_axes_m[0] * np.cos(angle), half_axes_m[1] * np.sin(angle)])
        along, across = reach * np.sin(rate * t + phases), 0.5 * reach * np.sin(2.0 * (rate * t + phases))
        c, s = np.cos(heading + 0.5 * angle), np.sin(heading + 0.5 * angle)
        return np.column_stack(
            [centre[0] + c * along - s * across, centre[1] + s * along + c * across, heights]
        )

    return plan


def procession(
    rng: Generator, vehicles: int, half_axes_m: tuple[float, float], speed: float, height_m: float,
    spacing_m: float, height_sway_m: float,
) -> Plan:  # fmt: skip
    """Return a plan of vehicles that fly around an ellipse before and behind the ego vehicle."""
    angles = np.linspace(0.0, 2.0 * np.pi, 2000)
    points = np.column_stack([half_axes_m[0] * np.cos(angles), half_axes_m[1] * np.sin(angles)])
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    numbers = np.arange(vehicles)
    ahead_m = spacing_m * ((numbers + 1) // 2) * np.where(numbers % 2 == 1, 1.0, -1.0)
    phases = rng.uniform(0.0, 2.0 * np.pi, vehicles)
    sway = np.where(numbers == 0, height_sway_m, 0.5 * height_sway_m)

    def plan(t: float) -> FloatArray:
        swing = np.where(numbers == 0, 0.0, 0.5 * np.sin(0.8 * t + phases))
        angle = np.interp(np.mod(speed * t + ahead_m + swing, lengths[-1]), lengths, angles)
        return np.column_stack(
            [
                half_axes_m[0] * np.cos(angle),
                half_axes_m[1] * np.sin(angle),
                height_m + 0.3 * (numbers > 0) + sway * np.sin(1.0 * t + phases[0]),
            ]
        )

    return plan


def eased(t: float) -> float:
    """Return the plan's time for a time since the start: it gathers pace over two seconds."""
    if t <= 0.0:
        return 0.0
    return 0.5 * t * t / _RAMP_S if t < _RAMP_S else t - 0.5 * _RAMP_S


def wanted_velocity(plan: Plan, t: float, state: QuadrotorState, pillars: FloatArray) -> FloatArray:
    """Return velocities (n, 3) that follow the plan and keep clear of pillars and of each other.

    Args:
        plan: where to be.
        t: seconds since it began.
        state: of all vehicles.
        pillars: (m, 3) x, y, radius of upright things to steer clear of.
    """
    step = 0.02
    ahead = eased(t + _LEAD_S)
    v: FloatArray = (plan(eased(t + _LEAD_S + step)) - plan(ahead)) / step
    off = plan(eased(t)) - state.p_world
    size = np.linalg.norm(off, axis=1, keepdims=True)
    v = v + _PULL_PER_S * off * np.minimum(1.0, _CORRECTION_MAX / np.maximum(size, 1e-9))
    # A vehicle answers late: what counts is where it will be.
    soon = state.p_world + _LAG_S * state.v_world
    _pass_pillars(v, soon, pillars)
    _keep_apart(v, soon)
    _pass_pillars(v, soon, pillars)
    v[:, 2] = np.maximum(v[:, 2], _LOWEST_M - soon[:, 2])
    return v


def uprights(world: World) -> FloatArray:
    """Return (m, 3) x, y, radius of everything bounded that stands in a world."""
    discs: FloatArray = world.discs[np.isfinite(world.discs[:, 2])]
    return discs


def _pass_pillars(v: FloatArray, p_world: FloatArray, pillars: FloatArray) -> None:
    """Approach a pillar no faster than its remaining distance allows, and slide around it."""
    for i in range(len(v)):
        away = p_world[i, :2] - pillars[:, :2]
        distance = np.linalg.norm(away, axis=1)
        gaps = distance - pillars[:, 2]
        for k in np.flatnonzero(gaps < _CAREFUL_M):
            normal = away[k] / max(distance[k], 1e-6)
            tangent = np.array([-normal[1], normal[0]])
            approach = -float(v[i, :2] @ normal)
            excess = approach - 1.2 * (gaps[k] - _OBSTACLE_ROOM_M)
            if excess > 0.0:
                side = 1.0 if v[i, :2] @ tangent >= 0.0 else -1.0
                v[i, :2] += excess * normal + 0.7 * min(excess, 1.5) * side * tangent


def _keep_apart(v: FloatArray, p_world: FloatArray) -> None:
    """Let two vehicles approach each other no faster than their distance allows."""
    away = p_world[:, None] - p_world[None]
    distance = np.linalg.norm(away, axis=2)
    np.fill_diagonal(distance, np.inf)
    normal = away / np.maximum(distance, 1e-6)[:, :, None]
    approach = -np.einsum("ijk,ijk->ij", v[:, None] - v[None], normal)
    excess = np.maximum(approach - 1.2 * (distance - _VEHICLE_ROOM_M), 0.0)
    v += 0.5 * np.einsum("ij,ijk->ik", excess, normal)
