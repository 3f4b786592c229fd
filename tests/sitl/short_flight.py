"""A scenario short enough for tests: six metres between a few pillars."""

import os
from pathlib import Path

import yaml

FIELD_CONFIGS = Path(__file__).resolve().parents[2] / "field_configs"


_MISSION = {"waypoints_m": [[6.0, 0.0, 1.2]], "speed_mps": 1.5, "wait_s": 0.0, "final_hold_s": 0.5}


def write_scenario(folder: Path, **changes: object) -> Path:
    """Write profile and scenario into `folder`; `changes` replace top-level keys of the scenario."""
    profile = {
        "extends": os.path.relpath(FIELD_CONFIGS / "sitl_uav_leader.yaml", folder),
        "leader": {"mission": _MISSION},
    }
    scenario: dict[str, object] = {
        "profile": "profile.yaml",
        "seed": 3,
        "max_duration_s": 60.0,
        "world": {"pillars": {"size_m": [40.0, 40.0], "spawn_clear_m": 3.0}},
        "operator": {"takeoff_height_m": 1.2, "authorise_after_s": 0.2},
    }
    (folder / "profile.yaml").write_text(yaml.safe_dump(profile), encoding="utf-8")
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(scenario | changes), encoding="utf-8")
    return path
