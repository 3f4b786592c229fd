"""The command line: statuses, one line per mistake, JSON for scripts, help that shows an example."""

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from companion import __version__, cli
from companion.cli import main
from companion.config import Profile, schema_text
from companion.control_socket import NotRunningError
from companion.directories import BusyError
from companion.errors import CompanionError, LogError, ProtocolError, StartError
from companion.exit_codes import ExitCode
from companion.messages import FlightState
from companion.preflight.check import Check
from tests.profiles import GOOD, WRONG

COMMANDS = (
    "fly",
    "check",
    "report",
    "recover",
    "replay",
    "trajectory",
    "metrics",
    "schema",
    "engage",
    "status",
    "warmup",
)
ONE_LINE = re.compile(r"[^:\n]+:\d+:\d+: [^\n]+\n")

Output = pytest.CaptureFixture[str]


@pytest.fixture
def good(tmp_path: Path) -> Path:
    path = tmp_path / "good.yaml"
    path.write_text(GOOD)
    return path


@pytest.fixture(autouse=True)
def logging_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the commands from pointing the test process's log at a stream that is closed afterwards."""
    monkeypatch.setattr("companion.service.write_logs_to_stderr", lambda: None)


def process(*arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "companion.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def last_json(text: str) -> Any:
    return json.loads(text.rstrip("\n").rpartition("\n")[2])


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself_with_an_example(command: str, capsys: Output) -> None:
    assert main([command, "--help"]) == 0
    out = capsys.readouterr().out
    assert f"Example: companion {command}" in out
    assert "--json" in out


def test_the_version_is_one_line(capsys: Output) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"companion {__version__}\n"


@pytest.mark.parametrize(
    "arguments", [[], ["flly"], ["fly"], ["fly", "a.yaml", "b.yaml"], ["check", "--fast", "a.yaml"], ["--no"]]
)
def test_a_wrong_command_line_is_status_64(arguments: Sequence[str], capsys: Output) -> None:
    assert main(arguments) == ExitCode.USAGE
    assert "Usage:" in "".join(capsys.readouterr())


def test_a_wrong_command_line_still_answers_scripts_in_json(capsys: Output) -> None:
    assert main(["fly", "--json"]) == ExitCode.USAGE
    assert last_json(capsys.readouterr().out) == {"error": "wrong command line", "exit": 64}


@pytest.mark.parametrize("command", ["fly", "check"])
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_profile_is_status_78_and_one_line(
    command: str, name: str, tmp_path: Path, capsys: Output
) -> None:
    text, expected = WRONG[name]
    path = tmp_path / "wrong.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert main([command, str(path)]) == ExitCode.CONFIG
    out, err = capsys.readouterr()
    assert out == ""
    assert ONE_LINE.fullmatch(err), err
    assert expected in err


def test_a_wrong_profile_in_a_process_of_its_own_leaves_no_traceback(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(GOOD + "safty: {}\n")
    result = process("fly", str(path))
    assert result.returncode == 78
    assert result.stdout == ""
    assert result.stderr == f"{path}:7:1: safty: unknown key, did you mean safety?\n"


def test_a_missing_profile_is_status_66(tmp_path: Path, capsys: Output) -> None:
    assert main(["fly", str(tmp_path / "gone.yaml")]) == ExitCode.NO_INPUT
    assert ONE_LINE.fullmatch(capsys.readouterr().err)


def test_json_is_the_last_line_of_a_refusal_too(tmp_path: Path, capsys: Output) -> None:
    path = tmp_path / "empty.yaml"
    path.write_text("")
    assert main(["check", str(path), "--json"]) == ExitCode.CONFIG
    out, err = capsys.readouterr()
    assert last_json(out) == {"error": err.rstrip("\n"), "exit": 78}


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (StartError("LiDAR: no answer"), 69),
        (ProtocolError("nonsense"), 69),
        (NotRunningError("nobody"), 69),
        (BusyError("already running as process 7"), 75),
        (LogError("not a log"), 65),
        (FileNotFoundError("gone"), 66),
        (PermissionError("denied"), 73),
        (OSError("disk on fire"), 74),
        (CompanionError("other"), 70),
    ],
)
def test_every_expected_error_has_its_status_and_one_line(
    error: Exception, code: int, good: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    def fail(path: Path) -> Profile:
        raise error

    monkeypatch.setattr(cli, "_load", fail)
    assert main(["check", str(good), "--json"]) == code
    out, err = capsys.readouterr()
    assert err == f"{error}\n"
    assert last_json(out) == {"error": str(error), "exit": code}


def test_a_bug_is_status_70_with_its_traceback(
    good: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    monkeypatch.setattr(cli, "_load", lambda path: 1 / 0)
    assert main(["fly", str(good), "--json"]) == ExitCode.INTERNAL
    out, err = capsys.readouterr()
    assert "Traceback" in err
    assert last_json(out)["error"] == "internal error: ZeroDivisionError: division by zero"


def test_the_keyboard_ends_a_command_with_status_130(
    good: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    def interrupt(path: Path) -> Profile:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_load", interrupt)
    assert main(["check", str(good)]) == ExitCode.INTERRUPTED
    assert capsys.readouterr().err == "interrupted; what was recorded so far is kept\n"


@pytest.mark.parametrize(("verdict", "code"), [("ok", 0), ("warn", 0), ("skipped", 0), ("fail", 3)])
def test_check_leaves_with_go_or_no_go(
    verdict: Any, code: int, good: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    checks = [Check("profile", "ok", "fine"), Check("disk", verdict, "1 GB free")]
    monkeypatch.setattr("companion.preflight.table.run_checks", lambda *given, **options: checks)
    assert main(["check", str(good)]) == code
    out = capsys.readouterr().out
    assert ("NO GO" in out) == (code == 3)
    assert "1 GB free" in out
    assert main(["check", str(good), "--json"]) == code
    assert last_json(capsys.readouterr().out) == {
        "go": code == 0,
        "checks": [check.as_dict() for check in checks],
        "exit": code,
    }


def test_the_schema_is_what_the_profiles_ship(capsys: Output) -> None:
    assert main(["schema"]) == 0
    assert capsys.readouterr().out == schema_text()
    assert main(["schema", "--json"]) == 0
    assert last_json(capsys.readouterr().out)["schema"] == json.loads(schema_text())


class TestRunningCompanion:
    @pytest.fixture(autouse=True)
    def found(self, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
        sockets = {"uav1": Path("/run/1"), "uav2": Path("/run/2")}
        monkeypatch.setattr("companion.directories.control_sockets", lambda environ: sockets)
        return sockets

    def answer(self, monkeypatch: pytest.MonkeyPatch, answer: dict[str, object]) -> list[Any]:
        asked: list[Any] = []

        def ask(path: Path, request: dict[str, object]) -> dict[str, object]:
            asked.append((path, request))
            return answer

        monkeypatch.setattr("companion.control_socket.ask", ask)
        return asked

    @pytest.mark.parametrize(("options", "verb"), [([], "engage"), (["--release"], "release")])
    def test_engage_asks_the_named_vehicle(
        self, options: list[str], verb: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        asked = self.answer(monkeypatch, {"ok": True, "state": "engaging"})
        assert main(["engage", "--vehicle", "uav2", *options]) == 0
        assert asked == [(Path("/run/2"), {"verb": verb})]

    def test_a_refusal_is_status_3_with_its_reason(
        self, monkeypatch: pytest.MonkeyPatch, capsys: Output
    ) -> None:
        self.answer(monkeypatch, {"ok": False, "error": "not airborne"})
        assert main(["engage", "--vehicle", "uav1", "--json"]) == ExitCode.NO_GO
        assert last_json(capsys.readouterr().out) == {"ok": False, "error": "not airborne", "exit": 3}
        assert main(["engage", "--vehicle", "uav1"]) == ExitCode.NO_GO
        assert capsys.readouterr().out == "refused: not airborne\n"

    def test_status_shows_what_the_companion_says(
        self, monkeypatch: pytest.MonkeyPatch, capsys: Output
    ) -> None:
        self.answer(monkeypatch, {"ok": True, "state": "ready"})
        assert main(["status", "--vehicle", "uav1"]) == 0
        assert capsys.readouterr().out == "state: ready\n"

    @pytest.mark.parametrize(
        ("options", "message"), [([], "uav1, uav2"), (["--vehicle", "uav9"], "no companion named uav9")]
    )
    def test_without_one_clear_vehicle_nothing_is_asked(
        self, options: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: Output
    ) -> None:
        asked = self.answer(monkeypatch, {"ok": True})
        assert main(["status", *options]) == ExitCode.UNAVAILABLE
        assert message in capsys.readouterr().err
        assert asked == []


class TestFly:
    @pytest.mark.parametrize(("reason", "code"), [("SIGTERM", 0), ("SIGINT", 130), ("mission finished", 0)])
    def test_the_end_of_a_flight_is_told_in_one_line(
        self, reason: str, code: int, good: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
    ) -> None:
        flight = pytest.importorskip("companion.flight")
        runtime = pytest.importorskip("companion.runtime")
        seen: list[Any] = []

        def run_flight(profile: Profile, environ: Any, log_directory: Path | None) -> Any:
            seen.append((profile.vehicle.name, log_directory))
            return runtime.FlightOutcome(FlightState.STANDBY, reason, Path("/log/uav1.mcap"))

        monkeypatch.setattr(flight, "run_flight", run_flight)
        assert main(["fly", str(good), "--log-directory", "/log"]) == code
        assert capsys.readouterr().out == f"standby: {reason}; log /log/uav1.mcap\n"
        assert seen == [("uav1", Path("/log"))]
        assert main(["fly", str(good), "--json"]) == code
        assert last_json(capsys.readouterr().out) == {
            "state": "standby",
            "reason": reason,
            "log": "/log/uav1.mcap",
            "exit": code,
        }


@pytest.mark.parametrize("command", ["report", "recover"])
def test_a_missing_log_is_status_66_and_a_wrong_one_65(command: str, tmp_path: Path, capsys: Output) -> None:
    if command == "report":
        pytest.importorskip("companion.logs.report")
    assert main([command, str(tmp_path / "gone.mcap")]) == ExitCode.NO_INPUT
    assert capsys.readouterr().err == f"{tmp_path / 'gone.mcap'}: no such file\n"
    wrong = tmp_path / "wrong.mcap"
    wrong.write_bytes(b"this is no log")
    assert main([command, str(wrong)]) == ExitCode.DATA
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_help_needs_no_heavy_library() -> None:
    script = (
        "import sys; from companion.cli import main; main(['fly', '--help'])\n"
        "heavy = {'numpy', 'numba', 'mavsdk', 'rich', 'scipy', 'yaml'}\n"
        "sys.exit(f'imported {heavy & set(sys.modules)}' if heavy & set(sys.modules) else 0)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=60
    )
    assert result.returncode == 0, result.stderr
