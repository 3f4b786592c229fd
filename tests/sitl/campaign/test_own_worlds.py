from pathlib import Path

import numpy as np
import pytest

from sitl.campaign.conditions import Conditions, conditions_of
from sitl.campaign.definition import load_definition
from sitl.campaign.scenes import scene_of
from sitl.campaign.tasks import SceneTask
from sitl.campaign.trials import fly_scenes
from sitl.swarm.scene import SwarmScene
from sitl.worlds.mesh import mesh_world

COURTYARD = Path(__file__).parents[3] / "field_configs" / "world_courtyard.yaml"


def conditions(folder: Path, entry: str, more: str = "") -> Conditions:
    path = folder / "campaign.yaml"
    path.write_text(f"title: T\nworlds: [{entry}]\nmethods: [flock, vpf]\n{more}", encoding="utf-8")
    return conditions_of(load_definition(path), path)


def scene(found: Conditions, name: str, trial: int = 0) -> SwarmScene:
    return scene_of(found.rules, found.worlds[name], 4, trial)


@pytest.fixture
def courtyard(tmp_path: Path) -> Path:
    (tmp_path / COURTYARD.name).write_bytes(COURTYARD.read_bytes())
    return tmp_path


def test_a_campaign_flies_in_a_world_from_a_file(courtyard: Path) -> None:
    found = conditions(courtyard, f"none, {{name: yard, file: {COURTYARD.name}}}")
    task = SceneTask(found.rules, found.worlds["yard"], 4, (0, 1), tuple(found.variants.items()))
    records = fly_scenes(task)
    assert [(record.world, record.method, record.trial) for record in records] == [
        ("yard", "flock", 0), ("yard", "vpf", 0), ("yard", "flock", 1), ("yard", "vpf", 1)
    ]  # fmt: skip
    assert records[0].scene_hash == records[1].scene_hash != records[2].scene_hash
    assert all(np.isfinite(record.obstacle_distance_m) for record in records)


def test_start_and_way_are_those_of_the_file_unless_the_campaign_says_otherwise(courtyard: Path) -> None:
    named = f"name: yard, file: {COURTYARD.name}"
    told = scene(conditions(courtyard, f"{{{named}}}"), "yard")
    assert told.waypoints_world[:, :2].tolist() == [[14.0, 0.0], [14.0, 14.0]]
    assert np.all(np.abs(told.starts_world[:, :2]) < 2.5)
    changed = f"{{{named}, spawn_world_m: [0, -2], waypoints_world_m: [[12, 12]]}}"
    moved = scene(conditions(courtyard, changed), "yard")
    assert moved.waypoints_world[:, :2].tolist() == [[12.0, 12.0]]
    assert abs(moved.starts_world[:, 1].mean() + 2.0) < 1.0
    swarm = "swarm: {waypoints_m: [[10, 10]]}\n"
    assert scene(conditions(courtyard, changed, swarm), "yard").waypoints_world[0, 0] == 10.0


def test_entries_of_one_file_fly_the_same_scenes(courtyard: Path) -> None:
    entries = ", ".join(f"{{name: {name}, file: {COURTYARD.name}}}" for name in ("a", "b"))
    found = conditions(courtyard, entries)
    assert scene(found, "a").scene_hash == scene(found, "b").scene_hash


def test_results_keep_the_world_even_when_its_file_has_gone(courtyard: Path) -> None:
    found = conditions(courtyard, f"{{name: yard, file: {COURTYARD.name}}}")
    kept = Conditions.model_validate_json(found.model_dump_json())
    (courtyard / COURTYARD.name).unlink()
    assert scene(kept, "yard").scene_hash == scene(found, "yard").scene_hash


def test_an_edited_world_is_another_campaign(courtyard: Path) -> None:
    before = conditions(courtyard, f"{{name: yard, file: {COURTYARD.name}}}")
    file = courtyard / COURTYARD.name
    file.write_text(file.read_text("utf-8").replace("radius_m: 1.3", "radius_m: 1.4"), "utf-8")
    after = conditions(courtyard, f"{{name: yard, file: {COURTYARD.name}}}")
    assert "worlds.yard.primitives" in (after.difference(before) or "")


def test_a_mesh_becomes_the_same_boxes_as_in_a_scenario(tmp_path: Path) -> None:
    (tmp_path / "wall.off").write_text(
        "OFF\n4 2 0\n8 -3 0\n8 3 0\n8 3 3\n8 -3 3\n3 0 1 2\n3 0 2 3\n", encoding="utf-8"
    )
    found = conditions(tmp_path, "{name: wall, mesh: wall.off, mesh_voxel_m: 0.5}")
    built, expected = scene(found, "wall").world, mesh_world(tmp_path / "wall.off", 0.5, 0.0, 0.4)
    np.testing.assert_allclose(built.rows, expected.rows, atol=1e-12)
    np.testing.assert_array_equal(built.kinds, expected.kinds)
    np.testing.assert_allclose(built.reflectivity, expected.reflectivity)


def test_a_world_of_ones_own_has_no_published_numbers(courtyard: Path) -> None:
    from sitl.campaign.tables_labels import Labels

    conditions(courtyard, f"{{name: forest, file: {COURTYARD.name}}}, none")
    labels = Labels.of(load_definition(courtyard / "campaign.yaml"))
    assert (labels.site("forest"), labels.site("none")) == (None, "none")
