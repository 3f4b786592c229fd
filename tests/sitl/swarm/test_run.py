"""`sitl run` with a swarm's scenario."""

import json
from pathlib import Path

import pytest
import yaml

from companion.exit_codes import ExitCode
from sitl.cli import main
from tests.sitl.swarm.small_swarm import FIELD_CONFIGS

SWARM = {
    "followers": 2,
    "follower_profile": str(FIELD_CONFIGS / "sitl_swarm_follower.yaml"),
    "waypoints_m": [[6.0, 0.0]],
}


def write(folder: Path, **changes: object) -> str:
    scenario: dict[str, object] = {
        "profile": str(FIELD_CONFIGS / "sitl_swarm_leader.yaml"),
        "seed": 2,
        "world": {"primitives": [{"shape": "ground"}]},
        "swarm": SWARM,
    }
    path = folder / "swarm.yaml"
    path.write_text(yaml.safe_dump(scenario | changes), encoding="utf-8")
    return str(path)


def last_line(text: str) -> dict[str, object]:
    found = json.loads(text.strip().splitlines()[-1])
    assert isinstance(found, dict)
    return found


def test_an_abstract_run_says_what_the_swarm_came_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["run", write(tmp_path), "--fidelity", "abstract", "--out", str(tmp_path / "out"), "--json"]
    assert main(arguments) == ExitCode.OK
    result = last_line(capsys.readouterr().out)
    assert (result["success"], result["reason"], result["fidelity"]) == (True, "success", "abstract")
    assert (result["followers"], result["seed"], result["MP"]) == (2, 2, 100.0)
    assert result["MDO"] is None
    logs = result["logs"]
    assert isinstance(logs, list)
    log = Path(logs[0])
    assert log.exists()
    assert main(arguments[:-1]) == ExitCode.OK
    assert log.with_name("previous-swarm.mcap").exists()
    shown = capsys.readouterr().out
    assert "swarm             success" in shown
    assert "obstacles         none within 4 m" in shown


def test_an_abstract_run_feels_the_scenarios_wind_and_flies_its_quadrotor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = []
    for changes in ({}, {"wind": {"gust_mps": 3.0}}, {"quadrotor": {"command_delay_s": 0.2}}):
        path = write(tmp_path, **changes)
        main(["run", path, "--fidelity", "abstract", "--out", str(tmp_path / "out"), "--json"])
        found.append(last_line(capsys.readouterr().out)["FR"])
    assert len(set(found)) == 3


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({}, ["--wire"], "a swarm flies in lockstep only"),
        (
            {"swarm": None},
            ["--fidelity", "abstract"],
            "without a section swarm there is no abstract fidelity",
        ),
        ({"profile": SWARM["follower_profile"]}, [], "role: 'follower', a swarm needs 'leader' here"),
        ({"world": {"site": "indoor_wall"}}, [], "no scene can be built: the site indoor_wall has a way"),
        (
            {"swarm": SWARM | {"cruise_height_m": [2.0, 1.0]}},
            [],
            "swarm.cruise_height_m: found 2 to 1, allowed rising heights between 0.5 and 3.5",
        ),
        (
            {"swarm": SWARM | {"termination": {"altitude_m": [3.0, 1.0]}}},
            [],
            "swarm.termination.altitude_m: found 3 to 1, allowed at least 0.4 m between them",
        ),
    ],
    ids=["wire", "no swarm", "roles", "two ways", "falling heights", "no room"],
)
def test_what_cannot_be_flown_is_refused_in_one_sentence(
    changes: dict[str, object],
    options: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = write(tmp_path, **changes)
    assert main(["run", path, "--out", str(tmp_path / "out"), *options]) == ExitCode.CONFIG
    assert message in " ".join(capsys.readouterr().err.split())
