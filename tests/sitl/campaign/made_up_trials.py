"""Trials that nobody flew, with known results."""

import math

import numpy as np

from sitl.swarm.record import End, Fidelity, TrialRecord


def trial(
    number: int = 0,
    end: End = "success",
    *,
    world: str = "pillars_5m",
    method: str = "flock",
    followers: int = 4,
    fidelity: Fidelity = "abstract",
    scene: str | None = None,
    **values: float,
) -> TrialRecord:
    return TrialRecord(
        world=world,
        method=method,
        followers=followers,
        fidelity=fidelity,
        trial=number,
        seed=1_000_000_000 + number,
        scene_hash=scene or f"{world}-{followers}-{number}",
        end=end,
        ended_by=() if end == "success" else (0, 2),
        t_end_s=values.get("t_end_s", 34.5),
        mission_progress_percent=values.get("MP", 100.0 if end == "success" else 40.0 + number % 7),
        flock_radius_m=values.get("FR", 1.6 + 0.01 * (number % 5)),
        minimum_separation_m=values.get("MS", 1.5),
        alignment=values.get("AL", 0.94),
        obstacle_distance_m=values.get("MDO", math.nan if world == "none" else 1.9),
        steps=690,
    )


def campaign(
    worlds: tuple[str, ...] = ("none", "pillars_10m", "pillars_5m"),
    methods: tuple[str, ...] = ("pacnav", "flock"),
    followers: tuple[int, ...] = (4,),
    trials: int = 20,
    fidelity: Fidelity = "abstract",
) -> list[TrialRecord]:
    """A whole campaign: denser worlds and larger swarms fail more often, all methods in the same scenes."""
    rng = np.random.default_rng(3)
    ends: tuple[End, ...] = ("obstacle", "uav_uav", "leader_lost", "timeout")
    records = []
    for depth, world in enumerate(worlds):
        for size in followers:
            luck = rng.uniform(size=trials)
            for rank, method in enumerate(methods):
                for number in range(trials):
                    fails = luck[number] < 0.04 * depth * (size / 4.0) * (len(methods) - rank)
                    end = ends[number % len(ends)] if fails else "success"
                    records.append(
                        trial(
                            number,
                            end,
                            world=world,
                            method=method,
                            followers=size,
                            fidelity=fidelity,
                            FR=1.5 + 0.1 * rank + 0.05 * float(rng.normal()),
                        )
                    )
    return records
