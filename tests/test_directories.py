"""Where a companion lives, and that it lives there alone."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from companion.directories import (
    SOCKET_NAME,
    BusyError,
    Directories,
    control_sockets,
    only_instance,
    runtime_root,
)
from companion.errors import StartError


def test_the_service_manager_says_where() -> None:
    environ = {
        "RUNTIME_DIRECTORY": "/run/companion/uav1:/run/other",
        "LOGS_DIRECTORY": "/var/log/companion/uav1",
        "STATE_DIRECTORY": "/var/lib/companion/uav1",
        "XDG_RUNTIME_DIR": "/run/user/1000",
    }
    assert Directories.resolve(environ, "uav9") == Directories(
        runtime=Path("/run/companion/uav1"),
        logs=Path("/var/log/companion/uav1"),
        state=Path("/var/lib/companion/uav1"),
    )


def test_without_a_service_manager_the_xdg_folders_are_used_per_vehicle() -> None:
    environ = {"XDG_RUNTIME_DIR": "/run/user/1000", "XDG_STATE_HOME": "/s", "HOME": "/home/pilot"}
    directories = Directories.resolve(environ, "uav1")
    assert directories.runtime == Path("/run/user/1000/companion/uav1")
    assert directories.state == Path("/s/companion/uav1")
    assert directories.logs == Path("/s/companion/uav1/logs")


def test_relative_folders_in_the_environment_are_ignored() -> None:
    environ = {
        "XDG_RUNTIME_DIR": "run",
        "XDG_STATE_HOME": "s",
        "RUNTIME_DIRECTORY": "x",
        "HOME": "/home/pilot",
    }
    directories = Directories.resolve(environ, "uav1")
    assert directories.runtime == runtime_root({}) / "uav1"
    assert directories.state == Path("/home/pilot/.local/state/companion/uav1")


def test_the_runtime_folder_is_created_private(tmp_path: Path) -> None:
    directories = Directories(tmp_path / "r" / "uav1", tmp_path / "logs", tmp_path / "state")
    directories.create()
    directories.create()
    assert directories.runtime.stat().st_mode & 0o777 == 0o700
    assert directories.logs.is_dir()
    assert directories.state.is_dir()


def test_a_runtime_folder_that_others_can_write_is_refused(tmp_path: Path) -> None:
    runtime = tmp_path / "uav1"
    runtime.mkdir()
    runtime.chmod(0o777)
    with pytest.raises(StartError, match="can be changed by other users"):
        Directories(runtime, tmp_path / "logs", tmp_path / "state").create()


def test_a_folder_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StartError, match=re.escape(str(tmp_path / "file"))):
        Directories(tmp_path / "uav1", tmp_path / "file" / "logs", tmp_path / "state").create()


def test_sockets_of_running_vehicles_are_found(tmp_path: Path) -> None:
    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    for name in ("uav1", "uav2"):
        folder = runtime_root(environ) / name
        folder.mkdir(parents=True)
        (folder / SOCKET_NAME).touch()
    found = control_sockets(environ)
    assert {"uav1", "uav2"} <= set(found)
    assert found["uav1"] == tmp_path / "companion" / "uav1" / SOCKET_NAME


def test_a_second_instance_is_refused_with_the_process_of_the_first(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    with only_instance(lock), pytest.raises(BusyError, match=f"process {os.getpid()} "), only_instance(lock):
        pass
    with only_instance(lock):
        pass


def test_the_lock_of_a_killed_process_is_free(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    script = (
        "import os, signal, pathlib\n"
        "from companion.directories import only_instance\n"
        f"with only_instance(pathlib.Path({str(lock)!r})): os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=False, timeout=60)
    assert lock.read_text().strip().isdecimal()
    with only_instance(lock):
        assert lock.read_text() == f"{os.getpid()}\n"


def test_a_lock_is_never_taken_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "lock").symlink_to(tmp_path / "victim")
    with pytest.raises(StartError, match="lock: cannot open"), only_instance(tmp_path / "lock"):
        pass
    assert not (tmp_path / "victim").exists()
