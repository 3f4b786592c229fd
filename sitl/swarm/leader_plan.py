"""The leader's behaviour as waypoints and pauses, so that every fidelity flies the same."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from companion.messages import FloatArray
from sitl.swarm.settings import Behaviour, LeaderBehaviourSettings

_KINDS: tuple[Behaviour, ...] = ("straight", "hover", "reverse", "turn")
_PART_OF_WAY = (0.35, 0.65)
_HOVER_S = (5.0, 12.0)
_BACK_M = (4.0, 8.0)
_TURN_RAD = (math.radians(60.0), math.radians(150.0))


@dataclass(frozen=True, slots=True, eq=False)
class LeaderPlan:
    """The leader's way.

    Attributes:
        behaviour: which it is; never `mixed`.
        waypoints_world: (k, 2) the last is the goal, m.
        holds_s: (k,) pause at each.
    """

    behaviour: Behaviour
    waypoints_world: FloatArray
    holds_s: FloatArray


def plan_leader(
    settings: LeaderBehaviourSettings,
    spawn_world: FloatArray,
    way_world: FloatArray,
    rng: Generator,
    *,
    own_way: bool = False,
) -> LeaderPlan:
    """Turn a way into the way of a leader that does more than fly it.

    Args:
        settings: how the leader behaves.
        spawn_world: (2,) where it begins, m.
        way_world: (k, 2) waypoints, the last is the goal, m.
        rng: draws the behaviour and where on the first stretch it happens.
        own_way: the way belongs to the world, so the leader cannot leave it: `mixed` never draws `turn`.

    Returns:
        The plan: `hover` pauses on the first stretch, `reverse` flies back some metres from there and then
        on, `turn` leaves there for a goal of its own as far away as the old one.
    """
    way = np.asarray(way_world, np.float64).reshape(-1, 2)
    behaviour = settings.behaviour
    # Drawn in any case, so that scenes of equal seeds differ by the behaviour alone.
    kinds = _KINDS[:-1] if own_way else _KINDS
    kind = kinds[int(rng.integers(len(kinds)))]
    part, hover_s, back_m = rng.uniform(*_PART_OF_WAY), rng.uniform(*_HOVER_S), rng.uniform(*_BACK_M)
    angle = rng.uniform(*_TURN_RAD) * (1.0 if rng.random() < 0.5 else -1.0)
    if behaviour == "mixed":
        behaviour = kind
    if behaviour == "turn" and own_way:
        raise ValueError("this world has a way of its own: its leader cannot turn to another goal")
    stretch = way[0] - spawn_world
    length = float(np.hypot(*stretch))
    middle = spawn_world + part * stretch
    pause = 0.0
    if behaviour == "hover":
        way, pause = np.vstack([middle, way]), hover_s
    elif behaviour == "reverse" and length > 0.0:
        back = middle - min(back_m / length, part) * stretch
        way = np.vstack([middle, back, way])
    elif behaviour == "turn":
        c, s = math.cos(angle), math.sin(angle)
        turned = np.array([[c, -s], [s, c]]) @ ((1.0 - part) * stretch)
        way = np.vstack([middle, middle + turned])
    holds = np.zeros(len(way))
    if behaviour == "hover":
        holds[0] = pause
    holds[-1] = settings.final_hold_s
    return LeaderPlan(behaviour, way, holds)
