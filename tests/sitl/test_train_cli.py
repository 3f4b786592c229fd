import json
import os
import signal
from pathlib import Path

import pytest

from companion.exit_codes import ExitCode
from sitl import cli, train_cli
from sitl.training import checkpoints
from tests.sitl.training.point_mass import PointMass

SMALL = """
title: Points
network: {azimuth_channels: [2], neighbour_width: 8, hidden: [16], critic_hidden: [16]}
ppo: {steps: 4, epochs: 1, minibatches: 2, critic_warm_up: 1, precision: float32}
schedule: {updates: 3, evaluate_every: 0}
"""


class Interrupted(PointMass):
    """Presses Ctrl-C in its sixth step, amid the second update."""

    def __init__(self, streams: int, seed: int) -> None:
        super().__init__(streams, seed)
        self.steps = 0

    def step(self, velocity, *, is_shown=True):  # type: ignore[no-untyped-def]
        self.steps += 1
        if self.steps == 6:
            os.kill(os.getpid(), signal.SIGINT)
        return super().step(velocity, is_shown=is_shown)


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(train_cli, "_batch", lambda *_: PointMass(8, 1))
    path = tmp_path / "points.yaml"
    path.write_text(SMALL)
    return path


def test_a_training_leaves_checkpoint_curve_and_configuration(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert cli.main(["train", str(file), "--out", str(out), "--json"]) == ExitCode.OK
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["update"] == 3
    assert said["samples"] == 3 * 4 * 8
    assert len(said["parameters_sha256"]) == 64
    assert said["samples_per_s"] > 0.0
    names = {Path(name).name for name in said["files"]}
    assert names == {"last.pt", "curve.csv", "configuration.yaml"}
    assert any((out / "tensorboard").iterdir())
    assert checkpoints.load(out / "last.pt").settings.title == "Points"


def test_more_updates_go_on_where_it_stopped(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "out"), "--json"]
    assert cli.main(["train", str(file), *out]) == ExitCode.OK
    assert cli.main(["train", str(file), *out]) == ExitCode.CONFIG
    assert "--resume" in capsys.readouterr().err
    assert cli.main(["train", str(file), *out, "--resume", "--updates", "5"]) == ExitCode.OK
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["update"] == 5


def test_ctrl_c_ends_the_update_and_saves(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(train_cli, "_batch", lambda *_: Interrupted(8, 1))
    handler = signal.getsignal(signal.SIGINT)
    out = tmp_path / "out"
    assert cli.main(["train", str(file), "--out", str(out)]) == ExitCode.INTERRUPTED
    assert "stopped after update 2; --resume goes on" in capsys.readouterr().err
    assert checkpoints.load(out / "last.pt").update == 2
    assert signal.getsignal(signal.SIGINT) == handler


def test_a_wrong_change_is_refused_before_anything_is_built(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert cli.main(["train", str(file), "--out", str(out), "--set", "ppo.epoch=3"]) == ExitCode.CONFIG
    assert "ppo.epoch: unknown key, did you mean epochs?" in capsys.readouterr().err
    assert not out.exists()


def test_a_start_that_is_not_there_is_refused(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["train", str(file), "--out", str(tmp_path / "out"), "--set", "start=none.pt"]
    assert cli.main(arguments) == ExitCode.CONFIG
    assert "none.pt" in capsys.readouterr().err


def test_the_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["train", "--help"]) == ExitCode.OK
    assert "Example: sitl train" in capsys.readouterr().out
