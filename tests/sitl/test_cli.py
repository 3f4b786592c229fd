"""The `sitl` command: help with examples, statuses, one line per mistake, JSON for scripts."""

import hashlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import pytest
import typer
import yaml

from companion.exit_codes import ExitCode
from companion.logs.metadata import FlightMetadata
from companion.logs.reader import FlightRecording
from companion.logs.writer import FlightLog, LogSettings
from sitl import cli
from sitl.cli import main
from sitl.outcome import Ending
from sitl.scenario import schema_text
from tests.sitl.short_flight import FIELD_CONFIGS, write_scenario

DEMO = FIELD_CONFIGS / "sitl_leader_pillars.yaml"
SHIPPED = sorted(path for path in FIELD_CONFIGS.glob("*.yaml") if "scenario.schema" in path.read_text())
ONE_LINE = re.compile(r"[^:\n]+:\d+:\d+: [^\n]+\n")

# change -> (line, column and key of the refusal)
WRONG: dict[str, tuple[dict[str, object], str]] = {
    "unknown key": ({"weather": "fine"}, ": weather: unknown key"),
    "unknown nested key": ({"network": {"los": 0.1}}, ": network.los: unknown key, did you mean loss?"),
    "out of range": (
        {"network": {"loss": 1.5}},
        ": network.loss: found 1.5, allowed is a number from 0 to 1",
    ),
    "wrong type": ({"max_duration_s": "long"}, ": max_duration_s: found text 'long', allowed is a number"),
    "two worlds": (
        {"world": {"pillars": {}, "primitives": []}},
        "name exactly one of site, file, mesh, pillars, primitives",
    ),
    "duration of a swarm": (
        {"swarm": {}, "max_duration_s": 60.0},
        ": max_duration_s: found it beside a swarm, allowed swarm.termination.spare_time_s instead",
    ),
    "tolerance of a swarm": (
        {"swarm": {}, "goal_tolerance_m": 1.5},
        ": goal_tolerance_m: found it beside a swarm, allowed swarm.termination.goal_tolerance_m instead",
    ),
    "unknown body": ({"world": {"primitives": [{"shape": "cone"}]}}, "world.primitives[0]"),
}

BESIDE_EACH_OTHER = ("two worlds", "duration of a swarm", "tolerance of a swarm")
"""What is wrong only beside something else, about which a schema says nothing."""

Output = pytest.CaptureFixture[str]


def last_json(text: str) -> Any:
    return json.loads(text.rstrip("\n").rpartition("\n")[2])


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words of every command, those of groups of commands included."""
    for name, command in group.commands.items():
        words = (*path, name)
        if hasattr(command, "commands"):
            yield from commands(command, words)
        else:
            yield words


COMMANDS = tuple(commands(typer.main.get_command(cli.app)))


def test_the_commands_are_those_that_are_tested() -> None:
    assert {("run",), ("px4",), ("schema",)} <= set(COMMANDS)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_explains_itself_with_an_example(words: tuple[str, ...], capsys: Output) -> None:
    assert main([*words, "--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert f"Example: sitl {' '.join(words)}" in out
    assert "--json" in out


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_scenario_is_status_78_and_one_line(name: str, tmp_path: Path, capsys: Output) -> None:
    changes, expected = WRONG[name]
    path = write_scenario(tmp_path, **changes)
    assert main(["run", str(path), "--out", str(tmp_path)]) == ExitCode.CONFIG
    out, err = capsys.readouterr()
    assert out == ""
    assert ONE_LINE.fullmatch(err), err
    assert err.startswith(f"{path}:")
    assert expected in err


def test_a_wrong_profile_is_named_instead_of_the_scenario(tmp_path: Path, capsys: Output) -> None:
    path = write_scenario(tmp_path)
    profile = tmp_path / "profile.yaml"
    profile.write_text(profile.read_text() + "safty: {}\n")
    assert main(["run", str(path), "--out", str(tmp_path)]) == ExitCode.CONFIG
    err = capsys.readouterr().err
    assert ONE_LINE.fullmatch(err)
    assert err.startswith(f"{profile}:")
    assert "safty: unknown key, did you mean safety?" in err


@pytest.mark.parametrize("missing", ["scenario", "profile"])
def test_a_missing_file_is_status_66_and_one_line(missing: str, tmp_path: Path, capsys: Output) -> None:
    path = write_scenario(tmp_path)
    gone = path if missing == "scenario" else tmp_path / "profile.yaml"
    gone.unlink()
    assert main(["run", str(path), "--out", str(tmp_path), "--json"]) == ExitCode.NO_INPUT
    out, err = capsys.readouterr()
    assert ONE_LINE.fullmatch(err)
    assert str(gone) in err
    assert last_json(out) == {"error": err.rstrip("\n"), "exit": 66}


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fly"],
        ["run"],
        ["run", str(DEMO), "another.yaml"],
        ["run", str(DEMO), "--seed", "-1"],
        ["run", str(DEMO), "--px4-params", "guess"],
        ["run", str(DEMO), "--px4", "udpin://127.0.0.1:14540", "--px4-truth", "nowhere"],
        ["px4", "--truth", "127.0.0.1:99999"],
        ["px4", "--companion-port", "99999"],
        ["schema", "--fast"],
    ],
    ids=" ".join,
)
def test_a_wrong_command_line_is_status_64(arguments: Sequence[str], capsys: Output) -> None:
    assert main(arguments) == ExitCode.USAGE
    out, err = capsys.readouterr()
    assert "Usage:" in out + err
    assert "Traceback" not in err


def test_a_flight_that_does_not_end_is_status_3_with_its_reason_in_the_last_line(tmp_path: Path) -> None:
    path = write_scenario(tmp_path, max_duration_s=3.0)
    folder = tmp_path / "out"
    folder.mkdir()
    log = folder / cli.LOG_NAME
    log.write_bytes(b"an older log, to be replaced")
    command = "import sys; from sitl.cli import main; sys.exit(main())"
    result = subprocess.run(
        [sys.executable, "-c", command, "run", str(path), "--seed", "5", "--out", str(folder), "--json"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert result.returncode == ExitCode.NO_GO, result.stderr
    assert result.stderr == ""
    outcome = last_json(result.stdout)
    assert set(outcome) == {
        *("success", "reason", "goal_distance_m", "sim_time_s", "wall_time_s", "real_time_factor"),
        *("collisions", "odometry", "latency_ms", "setpoints", "livox", "log", "log_sha256", "exit"),
    }
    assert {"ape_rmse_m", "drift_percent"} <= set(outcome["odometry"])
    assert set(outcome["latency_ms"]) == {"p50", "p99"}
    assert set(outcome["setpoints"]) == {"rate_hz", "max_gap_ms"}
    assert set(outcome["livox"]) == {"packets", "lost"}
    assert (outcome["success"], outcome["exit"]) == (False, 3)
    assert outcome["reason"] == "not landed after 3 s"
    assert outcome["sim_time_s"] == pytest.approx(3.0)
    assert outcome["real_time_factor"] == pytest.approx(outcome["sim_time_s"] / outcome["wall_time_s"])
    assert outcome["goal_distance_m"] == pytest.approx(6.0, abs=0.5)
    assert outcome["livox"]["packets"] > 1000
    assert outcome["log"] == str(log)
    assert outcome["log_sha256"] == hashlib.sha256(log.read_bytes()).hexdigest()
    assert FlightRecording(log).flight["seed"] == "5"


@pytest.mark.parametrize(("success", "code", "word"), [(True, 0, "success"), (False, 3, "FAILED")])
def test_people_read_the_outcome_line_by_line(
    success: bool, code: int, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    def fly(stage: object, log: Path) -> Ending:
        metadata = FlightMetadata(vehicle="uav1", role="leader", mode="lockstep", configuration="", seed=1)
        FlightLog(log, LogSettings(), metadata, threaded=False).close()
        return Ending(success, "as was to be shown", 0.25, 0, 60.0, 12.0)

    monkeypatch.setattr(cli, "_lockstep", fly)
    path = write_scenario(tmp_path, world={"primitives": [{"shape": "ground"}]})
    assert main(["run", str(path), "--out", str(tmp_path / "a" / "b")]) == code
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split(maxsplit=1) == ["flight", f"{word}: as was to be shown"]
    assert any("0.25 m" in line for line in lines)
    assert any("60.0 s, 5.0 x real time" in line for line in lines)
    assert lines[-1].endswith(str(tmp_path / "a" / "b" / cli.LOG_NAME))


class TestSchema:
    @pytest.fixture
    def validator(self) -> Any:
        schema = json.loads(schema_text())
        jsonschema.Draft202012Validator.check_schema(schema)
        return jsonschema.Draft202012Validator(schema)

    def test_what_is_printed_is_what_ships(self, capsys: Output) -> None:
        assert main(["schema"]) == 0
        printed = capsys.readouterr().out
        assert printed == (FIELD_CONFIGS / "scenario.schema.json").read_text(encoding="utf-8")
        assert main(["schema", "--json"]) == 0
        assert last_json(capsys.readouterr().out) == {"schema": json.loads(printed), "exit": 0}

    def test_it_accepts_the_scenarios_that_ship(self, validator: Any) -> None:
        assert DEMO in SHIPPED
        for path in SHIPPED:
            validator.validate(yaml.safe_load(path.read_text(encoding="utf-8")))

    def test_it_accepts_what_the_tests_fly(self, tmp_path: Path, validator: Any) -> None:
        validator.validate(yaml.safe_load(write_scenario(tmp_path).read_text()))

    @pytest.mark.parametrize("name", [name for name in WRONG if name not in BESIDE_EACH_OTHER])
    def test_it_refuses_what_the_loader_refuses(self, name: str, tmp_path: Path, validator: Any) -> None:
        path = write_scenario(tmp_path, **WRONG[name][0])
        assert not validator.is_valid(yaml.safe_load(path.read_text()))


def test_help_needs_no_heavy_library() -> None:
    script = (
        "import sys; from sitl.cli import main; main(['run', '--help'])\n"
        "heavy = {'numpy', 'numba', 'mavsdk', 'pymavlink', 'scipy', 'yaml'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)\n"
    )
    command = [sys.executable, "-c", script]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert result.returncode == 0, result.stderr
