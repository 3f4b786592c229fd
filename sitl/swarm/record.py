"""What one trial came to: the row of every table."""

from dataclasses import dataclass
from typing import Literal

Fidelity = Literal["abstract", "full"]
End = Literal[
    "success",
    "uav_uav",
    "leader_follower",
    "obstacle",
    "altitude",
    "leader_lost",
    "scattered",
    "timeout",
    "failsafe",
]
"""How a trial ended: two followers touched; the leader and a follower; anybody and an obstacle; too low or
too high; nobody saw the leader; followers were not gathered at the goal; time was up; a companion gave up (in
full fidelity only)."""


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """One trial, judged.

    Attributes:
        world: name of the world.
        method: name of the followers' method.
        followers: how many.
        fidelity: abstract or full.
        trial: its number in the campaign, from 0; scenes depend on it and on the world, never on the method.
        seed: from which everything random in it came.
        scene_hash: of world, start and goal, so that paired comparison can be proved.
        end: how it ended.
        ended_by: numbers of the vehicles concerned (0 is the leader).
        t_end_s: when, since the followers were let go.
        mission_progress_percent: MP of this trial, 100 on success.
        flock_radius_m: FR of this trial.
        minimum_separation_m: MS of this trial.
        alignment: AL of this trial; NaN if nobody ever moved.
        obstacle_distance_m: MDO of this trial; NaN where no obstacle was ever within the cap.
        steps: samples that the averages rest on.
    """

    world: str
    method: str
    followers: int
    fidelity: Fidelity
    trial: int
    seed: int
    scene_hash: str
    end: End
    ended_by: tuple[int, ...]
    t_end_s: float
    mission_progress_percent: float
    flock_radius_m: float
    minimum_separation_m: float
    alignment: float
    obstacle_distance_m: float
    steps: int
