import contextlib
import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from companion.exit_codes import ExitCode
from sitl.campaign.conditions import CONDITIONS_NAME, product_version
from sitl.campaign.journal import JOURNAL_NAME
from sitl.campaign.scenes import prepare
from sitl.campaign.store import TABLE_NAME, read_trials
from sitl.cli import main

CAMPAIGN = "title: Small\nworlds: [none, pillars_10m]\nmethods: [flock, vpf]\nfollowers: [2]\ntrials: 3\n"


@pytest.fixture(scope="module", autouse=True)
def _kernels() -> None:
    prepare()


@pytest.fixture
def definition(tmp_path: Path) -> Path:
    path = tmp_path / "campaign.yaml"
    path.write_text(CAMPAIGN, encoding="utf-8")
    return path


@dataclass(frozen=True)
class Finished:
    """A campaign that was flown in one process: its folder, and what the command said at last."""

    out: Path
    code: int
    result: dict[str, Any]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """Fly the whole campaign once for all who only look at what it left."""
    folder = tmp_path_factory.mktemp("finished")
    path, out = folder / "campaign.yaml", folder / "out"
    path.write_text(CAMPAIGN, encoding="utf-8")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main(["campaign", str(path), "--workers", "1", "--out", str(out), "--json"])
    return Finished(out, code, json.loads(said.getvalue().splitlines()[-1]))


def flown(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    code = main([*map(str, arguments), "--json"])
    result: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return code, result


def test_a_campaign_leaves_rows_a_table_and_a_report(finished: Finished) -> None:
    out, result = finished.out, finished.result
    assert finished.code == ExitCode.OK
    cases = [(row["world"], row["method"], row["followers"], row["trials"]) for row in result["rows"]]
    assert cases == [(w, m, 2, 3) for w in ("none", "pillars_10m") for m in ("flock", "vpf")]
    for row in result["rows"]:
        assert {"fidelity", "SR", "SR_ci95", "MP", "FR", "MS", "AL", "MDO", "failures"} <= row.keys()
        assert row["SR"] == pytest.approx(100.0 * (3 - sum(row["failures"].values())) / 3)
    assert len(read_trials(out / TABLE_NAME)) == 12
    assert all(Path(file).exists() for file in result["files"])


def test_workers_do_not_change_a_byte(
    finished: Finished, definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two = finished.out, tmp_path / "two"
    first = finished.result
    _, second = flown(capsys, "campaign", definition, "--workers", 2, "--out", two)
    assert first["rows"] == second["rows"]
    for name in (TABLE_NAME, "tables.md", "tables.tex", "campaign.json"):
        assert (one / name).read_bytes() == (two / name).read_bytes()


def test_methods_fly_the_same_scenes(finished: Finished) -> None:
    scenes: dict[tuple[str, int], set[tuple[int, str]]] = {}
    for trial in read_trials(finished.out / TABLE_NAME):
        scenes.setdefault((trial.world, trial.trial), set()).add((trial.seed, trial.scene_hash))
    assert len(scenes) == 6
    assert all(len(seen) == 1 for seen in scenes.values())
    assert len(set.union(*scenes.values())) == 6


def test_a_part_of_a_campaign_can_be_flown(
    definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part = ["--worlds", "pillars_10m", "--methods", "vpf", "--followers", "2", "--trials", "1"]
    _, result = flown(capsys, "campaign", definition, *part, "--workers", 1, "--out", tmp_path / "out")
    assert [(row["world"], row["method"], row["trials"]) for row in result["rows"]] == [
        ("pillars_10m", "vpf", 1)
    ]


def test_a_part_flown_later_leaves_tables_of_everything_that_is_there(
    finished: Finished, definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(finished.out, out)
    part = ["--worlds", "pillars_10m", "--methods", "vpf", "--trials", "2", "--workers", "1"]
    _, result = flown(capsys, "campaign", definition, *part, "--out", out)
    assert [(row["world"], row["method"], row["trials"]) for row in result["rows"]] == [
        ("pillars_10m", "vpf", 2)
    ]
    assert result["trials_in_files"] == 12
    for file in (TABLE_NAME, "tables.md", "tables.tex", "tables.html", "index.html"):
        assert (out / file).read_bytes() == (finished.out / file).read_bytes(), file


def test_tables_leave_out_what_the_file_does_not_name(
    finished: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, other = tmp_path / "out", tmp_path / "other.yaml"
    shutil.copytree(finished.out, out)
    other.write_text(CAMPAIGN.replace("[none, pillars_10m]", "[none]"), encoding="utf-8")
    _, result = flown(capsys, "campaign", other, "--workers", "1", "--out", out)
    assert result["trials_in_files"] == 6
    assert "Pillars" not in (out / "tables.md").read_text("utf-8")
    assert len(read_trials(out / TABLE_NAME)) == 12


@pytest.mark.parametrize(
    "worlds", [["none,pillars_5m"], ["pillars_5m", "none"], ["none, pillars_5m", "none"]]
)
def test_names_are_separated_by_commas_or_told_one_by_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], worlds: list[str]
) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(
        "title: T\nworlds: [none, pillars_10m, pillars_5m]\nmethods: [flock, vpf, lloyd]\n"
        "followers: [2, 3, 1]\ntrials: 1\nperceptions: [{name: a}, {name: b}, {name: c}]\n",
        encoding="utf-8",
    )
    names = [part for world in worlds for part in ("--worlds", world)]
    names += ["--methods", "flock", "--methods", "vpf", "--followers", "1", "--followers", "2"]
    names += ["--perceptions", "a,b"]
    _, result = flown(capsys, "campaign", file, *names, "--workers", 1, "--out", tmp_path / "out")
    assert [(row["world"], row["followers"], row["method"]) for row in result["rows"]] == [
        (world, followers, f"{method}@{perception}")
        for world in ("none", "pillars_5m")
        for method in ("flock", "vpf")
        for perception in ("a", "b")
        for followers in (2, 1)
    ]


def test_help_says_how_to_give_several_names(capsys: pytest.CaptureFixture[str]) -> None:
    main(["campaign", "--help"])
    told = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert told.count("separated by commas, or the option once for each") == 4


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--perceptions", "dim"], "no perception 'dim'; it has none"),
        (["--worlds", "moon"], "no world 'moon'; it has none, pillars_10m"),
        (["--methods", "flock,boids"], "no method 'boids'; it has flock, vpf"),
        (["--followers", "7"], "no number of followers '7'; it has 2"),
    ],
)
def test_what_the_campaign_does_not_have_is_refused(
    definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    code, result = flown(capsys, "campaign", definition, *arguments, "--out", tmp_path / "out")
    assert code == ExitCode.CONFIG
    assert told in result["error"]
    assert not (tmp_path / "out").exists()


def test_workers_and_a_cluster_exclude_each_other(
    definition: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _ = flown(capsys, "campaign", definition, "--workers", 2, "--ray", "auto")
    assert code == ExitCode.USAGE


def test_a_cluster_where_nobody_listens_is_said_at_once(
    definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("ray")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
        code, result = flown(capsys, "campaign", definition, "--ray", address, "--out", tmp_path / "out")
    assert code != ExitCode.OK
    assert result["error"].startswith(f"cluster: no Ray cluster at {address}: ")


@pytest.mark.parametrize(
    ("workers", "more"), [(1, "[{name: indoor_wall, behaviour: turn}]"), (2, "[indoor_wall]")]
)
def test_a_scene_that_cannot_be_is_refused_in_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], workers: int, more: str
) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(
        f"title: T\nworlds: {more}\nmethods: [flock]\nswarm: {{leader: {{behaviour: turn}}}}\n",
        encoding="utf-8",
    )
    code, result = flown(
        capsys, "campaign", file, "--trials", 1, "--workers", workers, "--out", tmp_path / "out"
    )
    assert code == ExitCode.CONFIG
    assert result["error"].startswith(
        "world indoor_wall with 4 followers, trial 0: no scene can be built: this"
    )


def test_a_folder_of_another_campaign_is_refused_in_one_sentence(
    definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part = ["--worlds", "none", "--methods", "flock", "--workers", 1, "--out", tmp_path / "out"]
    flown(capsys, "campaign", definition, *part)
    definition.write_text(f"{CAMPAIGN}seed: 2\n", encoding="utf-8")
    code, result = flown(capsys, "campaign", definition, *part)
    assert code == ExitCode.DATA
    assert "holds another campaign: rules.seed was 1, now 2; choose another folder" in result["error"]


def test_a_trial_flies_again_as_it_did(
    finished: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, log = finished.out, tmp_path / "trial.mcap"
    [trial] = [
        trial
        for trial in read_trials(out / TABLE_NAME)
        if (trial.world, trial.method, trial.trial) == ("pillars_10m", "vpf", 2)
    ]
    which = ["--world", "pillars_10m", "--method", "vpf", "--followers", 2, "--trial", 2]
    code, result = flown(capsys, "trial", out, *which, "--out", log)
    assert code == ExitCode.OK
    assert (result["end"], result["t_end_s"]) == (trial.end, trial.t_end_s)
    assert log.stat().st_size > 10_000
    again, _ = flown(capsys, "trial", out, *which, "--out", log)
    assert again == ExitCode.DATA


@pytest.mark.parametrize(
    ("world", "name", "told"),
    [("moon", "log.mcap", "no world 'moon'; it has none"), ("none", "log.txt", "ends in .mcap")],
)
def test_a_trial_that_cannot_be_flown_again_is_refused(
    finished: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str], world: str, name: str, told: str
) -> None:
    which = ["--world", world, "--method", "flock", "--followers", 2, "--trial", 0]
    code, result = flown(capsys, "trial", finished.out, *which, "--out", tmp_path / name)
    assert code == ExitCode.DATA
    assert told in result["error"]


def test_trials_of_another_version_are_neither_continued_nor_flown_again(
    finished: Finished, definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(finished.out, out)
    kept = out / CONDITIONS_NAME
    kept.write_text(kept.read_text("utf-8").replace(product_version(), "0.0.1+abc"), "utf-8")
    code, result = flown(capsys, "campaign", definition, "--workers", 1, "--out", out)
    assert code != ExitCode.OK
    assert "version" in result["error"]
    which = ["--world", "none", "--method", "flock", "--followers", 2, "--trial", 0]
    code, result = flown(capsys, "trial", out, *which, "--out", tmp_path / "log.mcap")
    assert code == ExitCode.DATA
    assert "0.0.1+abc" in result["error"]


STOPPED = ["--worlds", "none", "--methods", "flock"]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_stopped_campaign_goes_on_to_the_same_result(
    definition: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], how: signal.Signals
) -> None:
    out, whole = tmp_path / "out", tmp_path / "whole"
    command = [sys.executable, "-m", "sitl", "campaign", str(definition), *STOPPED, "--workers", "2"]
    # So many that it cannot end before it is stopped.
    command += ["--trials", "500", "--out", str(out)]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert child.stderr is not None
    with child.stderr as lines:
        for line in lines:
            if " of 500 trials" in line and not line.startswith("Small: 0 "):
                os.kill(child.pid, how)
                break
        told = lines.read()
    code = child.wait()
    records = [json.loads(line) for line in (out / JOURNAL_NAME).read_bytes().splitlines()[:-1]]
    if how is signal.SIGINT:
        assert code == ExitCode.INTERRUPTED
        assert "the same command goes on from what is in" in told
        assert len(read_trials(out / TABLE_NAME)) >= len(records)
    more = ["--trials", max(record["trial"] for record in records) + 20, "--workers", 1]
    flown(capsys, "campaign", definition, *STOPPED, *more, "--out", out)
    flown(capsys, "campaign", definition, *STOPPED, *more, "--out", whole)
    assert (out / TABLE_NAME).read_bytes() == (whole / TABLE_NAME).read_bytes()
