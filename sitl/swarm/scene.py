"""One trial's scene: the same for every method and for both fidelities."""

from dataclasses import dataclass

from companion.messages import FloatArray
from sitl.worlds.primitives import World


@dataclass(frozen=True, slots=True, eq=False)
class SwarmScene:
    """A world with a swarm ready to fly in it; number 0 is the leader.

    Attributes:
        seed: from which everything random in the trial comes.
        world: what can be seen and hit.
        starts_world: (n, 3) where each hovers when the followers are let go, m.
        yaws: (n,) heading of each, rad.
        waypoints_world: (k, 3) the leader's way; the last is the goal.
        holds_s: (k,) pause of the leader at each of them.
        speed_mps: the leader's cruise speed.
        timeout_s: the trial has failed if it lasts longer.
        scene_hash: short digest of all the above.
    """

    seed: int
    world: World
    starts_world: FloatArray
    yaws: FloatArray
    waypoints_world: FloatArray
    holds_s: FloatArray
    speed_mps: float
    timeout_s: float
    scene_hash: str
