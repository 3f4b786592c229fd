"""Trials that nobody flew, quick to make and different from each other."""

import math
from dataclasses import replace

from sitl.swarm.record import TrialRecord

RECORD = TrialRecord(
    world="none",
    method="flock",
    followers=4,
    fidelity="abstract",
    trial=0,
    seed=1_000_000_001,
    scene_hash="0011223344556677",
    end="success",
    ended_by=(),
    t_end_s=41.35,
    mission_progress_percent=100.0,
    flock_radius_m=1.0 / 3.0,
    minimum_separation_m=1.23,
    alignment=0.87,
    obstacle_distance_m=math.nan,
    steps=827,
)


def made_up(number: int) -> TrialRecord:
    return replace(
        RECORD,
        trial=number,
        seed=1_000_000_000 + 7919 * number,
        end="uav_uav" if number % 3 == 0 else "success",
        ended_by=(1, 2) if number % 3 == 0 else (),
        flock_radius_m=math.sqrt(number + 0.1),
        alignment=math.nan if number % 5 == 0 else 0.9,
    )
