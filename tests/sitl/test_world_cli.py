"""`sitl world`: says what is in a world, draws it, refuses what is none."""

import json
from pathlib import Path

import pytest

from companion.exit_codes import ExitCode
from sitl.cli import main
from tests.sitl.short_flight import FIELD_CONFIGS
from tests.sitl.worlds.test_mesh import write_box

Output = pytest.CaptureFixture[str]


def test_a_scene_is_described_and_drawn(tmp_path: Path, capsys: Output) -> None:
    page = tmp_path / "world.html"
    assert main(["world", "pillars_10m", "--seed", "1000000007", "--out", str(page), "--json"]) == ExitCode.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["world"] == "pillars_10m"
    assert told["held_out"] is True
    assert told["primitives"]["cylinder"] > 30
    assert told["length_m"] == pytest.approx(30.0)
    assert told["free_m"][0] >= 4.0
    assert told["page"] == str(page)
    assert "pillars_10m, seed 1000000007" in page.read_text("utf-8")


def test_files_are_worlds_too(tmp_path: Path, capsys: Output) -> None:
    assert main(["world", str(FIELD_CONFIGS / "world_courtyard.yaml")]) == ExitCode.OK
    assert "1 ground, 2 sphere, 4 cylinder, 4 box" in capsys.readouterr().out
    mesh = write_box(tmp_path / "hut.obj", (10.0, -1.5, 0.0), (14.0, 1.5, 3.0))
    assert main(["world", str(mesh), "--voxel", "0.5", "--json"]) == ExitCode.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["world"] == "hut"
    assert told["primitives"]["box"] > 3


@pytest.mark.parametrize(
    ("name", "status", "words"),
    [
        ("desert", ExitCode.CONFIG, "neither a site nor a file"),
        ("absent.yaml", ExitCode.NO_INPUT, "absent.yaml"),
        ("absent.ply", ExitCode.CONFIG, "no such file"),
    ],
)
def test_what_is_no_world_is_refused_in_one_line(
    name: str, status: ExitCode, words: str, capsys: Output
) -> None:
    assert main(["world", name]) == status
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
