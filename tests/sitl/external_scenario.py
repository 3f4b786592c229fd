"""The short flight on another process's odometry."""

from pathlib import Path

import yaml

from tests.sitl.short_flight import write_scenario


def write_external_scenario(folder: Path, **changes: object) -> Path:
    """Write profile and scenario into `folder`, like `write_scenario`."""
    path = write_scenario(folder, **changes)
    profile = folder / "profile.yaml"
    settings = yaml.safe_load(profile.read_text(encoding="utf-8"))
    settings["odometry"] = {"source": "external"}
    profile.write_text(yaml.safe_dump(settings), encoding="utf-8")
    return path
