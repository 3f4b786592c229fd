"""The learned model of a follower, before and at take-off."""

import json
from pathlib import Path

import pytest

pytest.importorskip("onnx")

from companion import flight
from companion.assembly import assemble
from companion.cli import main
from companion.clock import SystemClock
from companion.config import load_profile, profile_text
from companion.control.followers.settings import FollowerSettings
from companion.errors import ModelError
from companion.exit_codes import ExitCode
from companion.preflight import table
from companion.preflight.policy import check_policy
from tests.control.models import save

PROFILE = """\
vehicle: {name: uav7}
role: follower
follower: {controller: policy, model: models/a.onnx}
"""


class FixedClock(SystemClock):
    """Every look at it takes so long."""

    def __init__(self, step_ns: int) -> None:
        self.t_ns, self.step_ns = 0, step_ns

    def now_ns(self) -> int:
        self.t_ns += self.step_ns
        return self.t_ns


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    (tmp_path / "models").mkdir()
    path = tmp_path / "uav7.yaml"
    path.write_text(PROFILE, encoding="utf-8")
    return path


@pytest.fixture
def no_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what has nothing to do with models and takes its time."""
    for module in (flight, table):
        monkeypatch.setattr(module, "load_kernels", lambda: 0)


def settings_of(profile: Path) -> FollowerSettings:
    follower = load_profile(profile).follower
    assert follower is not None
    return follower


def test_the_model_is_found_beside_the_profile_and_named(profile: Path, tmp_path: Path) -> None:
    save(tmp_path / "models" / "a.onnx")
    follower = settings_of(profile)
    assert follower.model == str((tmp_path / "models" / "a.onnx").resolve())
    check = check_policy(follower, FixedClock(300_000))
    assert check.verdict == "ok"
    assert check.reason.startswith("a.onnx ")
    assert "contract best-2, configuration aaaaaaaaaaaa, commit c0ffee, 0.30 ms" in check.reason


@pytest.mark.parametrize(("step_ns", "verdict"), [(3_000_000, "warn"), (11_000_000, "fail")])
def test_a_slow_model_is_told(step_ns: int, verdict: str, profile: Path, tmp_path: Path) -> None:
    save(tmp_path / "models" / "a.onnx")
    assert check_policy(settings_of(profile), FixedClock(step_ns)).verdict == verdict


def test_other_limits_than_in_training_are_told(profile: Path, tmp_path: Path) -> None:
    save(tmp_path / "models" / "a.onnx")
    slow = FollowerSettings.model_validate(
        {**settings_of(profile).model_dump(), "command": {"max_speed_mps": 1.5}}
    )
    check = check_policy(slow, FixedClock(1000))
    assert check.verdict == "warn"
    assert check.reason.endswith("max_speed_mps is 1.5, it was trained with 2")


@pytest.mark.usefixtures("no_kernels")
def test_check_refuses_a_model_that_does_not_fit(
    profile: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(profile), "--offline", "--json"]) == ExitCode.NO_GO
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    found = {check["name"]: check for check in result["checks"]}["policy"]
    assert found["verdict"] == "fail"
    assert found["reason"] == f"{tmp_path / 'models' / 'a.onnx'}: no such model"


@pytest.mark.usefixtures("no_kernels")
def test_nothing_takes_off_with_a_model_that_does_not_fit(
    profile: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "models" / "a.onnx", shapes={"ego": (15,)})
    with pytest.raises(ModelError, match=r"\(batch, 15\), wanted tensor\(float\) \(batch, 14\)"):
        assemble(load_profile(profile))
    for name in ("RUNTIME_DIRECTORY", "LOGS_DIRECTORY", "STATE_DIRECTORY"):
        monkeypatch.setenv(name, str(tmp_path / name.lower()))
    assert main(["fly", str(profile)]) == ExitCode.CONFIG
    assert "(batch, 15), wanted tensor(float) (batch, 14)" in capsys.readouterr().err


def test_a_configuration_from_a_log_names_the_same_file(profile: Path, tmp_path: Path) -> None:
    save(tmp_path / "models" / "a.onnx")
    loaded = load_profile(profile)
    copy = tmp_path / "elsewhere"
    copy.mkdir()
    (copy / "uav7.yaml").write_text(profile_text(loaded), encoding="utf-8")
    assert load_profile(copy / "uav7.yaml") == loaded
    assert assemble(loaded).role_counters is not None
    # Another model of the same name is not taken for the one that flew.
    save(tmp_path / "models" / "a.onnx", offset=(0.1, 0.0, 0.0))
    with pytest.raises(ModelError, match=r"sha256 [0-9a-f]{64}, the profile wants [0-9a-f]{64}"):
        assemble(load_profile(copy / "uav7.yaml"))
