"""Vehicle profiles: the shipped ones load, the wrong ones are refused in one line, the schema agrees."""

import json
import re
from pathlib import Path
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest
import yaml

from companion.config import Profile, json_schema, load_profile, profile_text, schema_text
from companion.errors import ProfileError
from companion.yaml_source import loads
from companion.yaml_tree import RejectedProfileError
from tests.profiles import GOOD, WRONG

FIELD_CONFIGS = Path(__file__).parents[1] / "field_configs"
SHIPPED = sorted(FIELD_CONFIGS.glob("uav_*.yaml"))

# Rules between values, spellings and files that a JSON schema cannot or should not express.
BEYOND_SCHEMA = {
    "leader without mission",
    "follower with mission",
    "leader with a law",
    "follower faster than the limit",
    "follower recovers below the limit",
    "grid that no law knows",
    "waypoint too high",
    "faster than the limit",
    "climbs faster than the limit",
    "altitudes crossed",
    "source twice",
    "address",
    "link",
    "circle",
    "base missing",
    "external odometry on the autopilot's port",
    "external odometry lost before it is stale",
    "external odometry stale between two messages",
}
# Not readable as data at all, or not by a common YAML reader.
BEYOND_YAML = {
    "not UTF-8", "UTF-16", "tab", "open bracket", "duplicate key", "alias bomb", "deep nesting", "too large",
    "python object", "two documents", "octal", "on for a truth value", "base 60", "not a number", "infinite",
}  # fmt: skip


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_profile_is_refused_in_one_line_with_its_place(name: str, tmp_path: Path) -> None:
    text, expected = WRONG[name]
    path = tmp_path / "wrong.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ProfileError) as caught:
        load_profile(path)
    message = str(caught.value)
    assert re.fullmatch(r"[^:\n]+:\d+:\d+: [^\n]+", message)
    assert message.startswith(str(path))
    assert expected in message


def test_the_good_profile_is_the_reason_why_the_others_are_wrong() -> None:
    profile = loads(GOOD, Profile)
    assert profile.role == "leader"
    assert profile.leader is not None
    assert [list(point) for point in profile.leader.mission.waypoints_m] == [[5.0, 0.0, 1.5]]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_profiles_load_and_name_their_schema(path: Path) -> None:
    assert load_profile(path).vehicle.name
    first_line = path.read_text(encoding="utf-8").splitlines()[0]
    assert first_line == "# yaml-language-server: $schema=./profile.schema.json"


def test_leader_and_follower_differ_only_by_what_they_say() -> None:
    leader = load_profile(FIELD_CONFIGS / "uav_leader.yaml")
    follower = load_profile(FIELD_CONFIGS / "uav_follower.yaml")
    assert (leader.role, follower.role) == ("leader", "follower")
    assert leader.safety == follower.safety
    assert leader.odometry == follower.odometry
    assert leader.autopilot.system_id != follower.autopilot.system_id
    assert leader.vehicle.name != follower.vehicle.name
    for name in ("uav_leader.yaml", "uav_follower.yaml"):
        assert yaml.safe_load((FIELD_CONFIGS / name).read_text())["extends"] == "uav_base.yaml"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_a_profile_written_out_in_full_loads_as_an_equal_one(path: Path) -> None:
    profile = load_profile(path)
    assert loads(profile_text(profile), Profile) == profile


def test_the_shipped_schema_is_current() -> None:
    shipped = (FIELD_CONFIGS / "profile.schema.json").read_text(encoding="utf-8")
    assert shipped == schema_text(), "run: companion schema > field_configs/profile.schema.json"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_the_schema_accepts_the_shipped_profiles(path: Path, validator: Any) -> None:
    validator.validate(yaml.safe_load(path.read_text()))


@pytest.mark.parametrize("name", sorted(WRONG.keys() - BEYOND_SCHEMA - BEYOND_YAML))
def test_the_schema_refuses_wrong_profiles(name: str, validator: Any) -> None:
    text, _ = WRONG[name]
    assert not validator.is_valid(yaml.safe_load(text))


def test_every_exception_from_the_schema_is_still_needed(validator: Any) -> None:
    assert WRONG.keys() >= BEYOND_SCHEMA | BEYOND_YAML
    for name in BEYOND_SCHEMA:
        assert validator.is_valid(yaml.safe_load(WRONG[name][0])), name


def test_the_schema_demands_required_keys_unless_another_file_is_extended(
    validator: Any,
) -> None:
    assert not validator.is_valid({"role": "follower"})
    assert not validator.is_valid({"role": "follower", "vehicle": {}})
    assert validator.is_valid({"extends": "base.yaml", "vehicle": {}})
    assert validator.is_valid({"extends": "base.yaml", "leader": None})
    assert not validator.is_valid({"extends": "base.yaml", "rolle": "leader"})
    mask = {"extends": "base.yaml", "lidar": {"self_mask": [{"x_min_m": 0.0}]}}
    assert not validator.is_valid(mask), "an item of a list replaces the whole list and must be complete"


def test_every_key_of_the_profile_explains_itself_in_the_editor() -> None:
    schema = json_schema()
    models = [schema, schema["$defs"]["VehicleSettings"], schema["$defs"]["AuthorisationSettings"]]
    silent = [
        key for model in models for key, part in model["properties"].items() if not part.get("description")
    ]
    assert silent == []


def test_rotation_and_position_of_the_lidar_become_one_transform() -> None:
    text = GOOD.replace(
        "name: uav1", "name: uav1\n  lidar_position_m: [0.1, 0, 0.2]\n  lidar_rotation_deg: [0, 90, 90]"
    )
    T_body_lidar = loads(text, Profile).vehicle.T_body_lidar
    # Pitched by 90 degrees its x axis looks down, whatever the yaw; yawed by 90 its y axis looks backwards.
    np.testing.assert_allclose(T_body_lidar.transform([1.0, 0.0, 0.0]), [0.1, 0.0, -0.8], atol=1e-12)
    np.testing.assert_allclose(T_body_lidar.transform([0.0, 1.0, 0.0]), [-0.9, 0.0, 0.2], atol=1e-12)


def test_the_inertial_chip_sits_where_the_manufacturer_says() -> None:
    T_lidar_imu = loads(GOOD, Profile).vehicle.T_lidar_imu
    np.testing.assert_array_equal(T_lidar_imu.p, [0.011, 0.02329, -0.04412])
    np.testing.assert_array_equal(T_lidar_imu.q, [1.0, 0.0, 0.0, 0.0])


def test_all_problems_are_kept_with_the_most_relevant_first() -> None:
    with pytest.raises(RejectedProfileError) as caught:
        loads("vehicle: {nam: a}\nrole: boss\nsafety: {min_quality: 0}\n", Profile)
    paths = [problem.path for problem in caught.value.problems]
    assert paths == [("vehicle", "nam"), ("role",), ("safety", "min_quality"), ("vehicle", "name")]


def test_the_schema_is_plain_json() -> None:
    assert json.loads(schema_text()) == json_schema()
