"""What is installed on the vehicle agrees with the program and with systemd."""

import shutil
import subprocess
from pathlib import Path

import pytest

from companion.cli import main
from companion.drivers.livox_settings import HostPorts, LivoxSettings
from companion.exit_codes import ExitCode

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
UNIT = DEPLOY / "companion@.service"

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")


def directives() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text(encoding="utf-8").splitlines():
        if "=" in line and not line.startswith("#"):
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found


@pytest.fixture
def instance(tmp_path: Path) -> Path:
    """Return the unit as one instance whose program exists on this computer."""
    text = UNIT.read_text(encoding="utf-8").replace("/opt/companion/venv/bin/companion", "/bin/true")
    path = tmp_path / "companion@uav1.service"
    path.write_text(text)
    return path


@needs_systemd
def test_systemd_understands_the_unit_without_a_word(instance: Path) -> None:
    command = ["systemd-analyze", "verify", str(instance)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@needs_systemd
def test_the_unit_is_exposed_little(instance: Path) -> None:
    command = ["systemd-analyze", "security", "--offline=yes", "--threshold=18", "--no-pager", str(instance)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert result.returncode == 0, result.stdout[-200:]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("Type", "notify"),
        ("NotifyAccess", "main"),
        ("WatchdogSec", "2s"),
        ("WatchdogSignal", "SIGKILL"),
        ("Restart", "always"),
        ("RestartSec", "500ms"),
        ("StartLimitIntervalSec", "0"),
        ("KillMode", "mixed"),
        ("TimeoutStopSec", "5"),
        ("RuntimeDirectory", "companion/%i"),
        ("RuntimeDirectoryMode", "0700"),
        ("LogsDirectory", "companion/%i"),
        ("StateDirectory", "companion/%i"),
        ("LimitCORE", "0"),
        ("NoNewPrivileges", "yes"),
        ("CapabilityBoundingSet", ""),
        ("ProtectSystem", "strict"),
        ("DevicePolicy", "closed"),
        ("IPAddressDeny", "any"),
    ],
)
def test_the_unit_keeps_its_promises(key: str, value: str) -> None:
    assert directives()[key] == [value]


def test_compiled_kernels_can_be_loaded_and_cached() -> None:
    unit = directives()
    assert "MemoryDenyWriteExecute" not in unit
    assert "ProcSubset" not in unit
    assert "NUMBA_CACHE_DIR=/var/cache/companion" in unit["Environment"]
    assert "NUMBA_THREADING_LAYER=omp" in unit["Environment"]
    assert unit["CacheDirectory"] == ["companion"]


def test_a_mistake_that_a_restart_cannot_cure_ends_the_restarts() -> None:
    codes = {int(code) for code in directives()["RestartPreventExitStatus"][0].split()}
    assert codes == {ExitCode.USAGE, ExitCode.NO_INPUT, ExitCode.CONFIG}


def test_the_unit_starts_a_command_that_exists(capsys: pytest.CaptureFixture[str]) -> None:
    program, verb, profile = directives()["ExecStart"][0].split()
    assert program.endswith("/companion")
    assert profile == "/etc/companion/%i.yaml"
    assert main([verb, "--help"]) == 0
    assert "PROFILE" in capsys.readouterr().out


def test_the_installer_is_a_shell_script_that_explains_itself() -> None:
    script = DEPLOY / "install.sh"
    assert script.stat().st_mode & 0o111
    subprocess.run(["sh", "-n", str(script)], check=True, timeout=60)
    result = subprocess.run([str(script)], capture_output=True, text=True, check=False, timeout=60)
    assert result.returncode == 1
    assert result.stderr.startswith("install: usage: sudo ")


def test_the_installer_installs_only_what_exists() -> None:
    text = (DEPLOY / "install.sh").read_text(encoding="utf-8")
    names = {part.split('"')[0].split(" ")[0] for part in text.split("$source/")[1:]}
    names |= {part.split('"')[0].split(" ")[0] for part in text.split('$source"/')[1:]}
    assert "deploy/companion@.service" in names
    for name in names:
        assert (ROOT / name.rstrip(";")).exists(), name


def test_the_kernel_grants_the_buffer_that_the_profile_asks_for() -> None:
    assert f"net.core.rmem_max = {LivoxSettings().receive_buffer_bytes}" in (
        DEPLOY / "90-companion.conf"
    ).read_text(encoding="utf-8")


def test_the_network_page_names_every_port_of_the_host() -> None:
    page = (DEPLOY / "network.md").read_text(encoding="utf-8")
    for port in HostPorts().model_dump().values():
        assert str(port) in page
