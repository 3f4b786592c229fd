"""Where a running companion keeps its socket, logs and state, and the lock that makes it the only one.

Under systemd the unit's RUNTIME_DIRECTORY, LOGS_DIRECTORY and STATE_DIRECTORY say where; elsewhere the XDG
directories of the user, with one folder per vehicle.
"""

import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from companion.errors import CompanionError, StartError

APPLICATION = "companion"
LOCK_NAME = "lock"
SOCKET_NAME = "control.sock"
SERVICE_RUNTIME = Path("/run") / APPLICATION


class BusyError(CompanionError):
    """Another companion of the same vehicle is running; the text names its process."""


@dataclass(frozen=True, slots=True)
class Directories:
    """Folders of one running vehicle.

    Attributes:
        runtime: control socket and lock; gone after a reboot.
        logs: flight logs.
        state: what has to outlive a restart.
    """

    runtime: Path
    logs: Path
    state: Path

    @classmethod
    def resolve(cls, environ: Mapping[str, str], vehicle: str) -> "Directories":
        """Choose the folders from the environment; creates nothing."""
        state = _from_service(environ, "STATE_DIRECTORY") or (
            _xdg(environ, "XDG_STATE_HOME", _home(environ) / ".local" / "state") / APPLICATION / vehicle
        )
        return cls(
            runtime=_from_service(environ, "RUNTIME_DIRECTORY") or runtime_root(environ) / vehicle,
            logs=_from_service(environ, "LOGS_DIRECTORY") or state / "logs",
            state=state,
        )

    def create(self) -> None:
        """Create what is missing; the runtime folder is private to the user.

        Raises:
            StartError: if a folder cannot be created or the runtime folder belongs to someone else.
        """
        try:
            for folder in (self.state, self.logs):
                folder.mkdir(parents=True, exist_ok=True)
            self.runtime.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self.runtime.mkdir(mode=0o700, exist_ok=True)
            for folder in (self.runtime.parent, self.runtime):
                _refuse_foreign(folder)
        except OSError as error:
            raise StartError(f"directories: cannot create {error.filename}: {error.strerror}") from None


def runtime_root(environ: Mapping[str, str]) -> Path:
    """Return the folder that holds one runtime folder per vehicle outside systemd."""
    private = Path(tempfile.gettempdir()) / f"{APPLICATION}-{os.getuid()}"
    given = environ.get("XDG_RUNTIME_DIR", "")
    return Path(given) / APPLICATION if given.startswith("/") else private


def control_sockets(environ: Mapping[str, str]) -> dict[str, Path]:
    """Return the control sockets found on this computer by vehicle or service instance name."""
    found = {}
    for root in (SERVICE_RUNTIME, runtime_root(environ)):
        for path in sorted(root.glob(f"*/{SOCKET_NAME}")):
            found[path.parent.name] = path
    return found


@contextmanager
def only_instance(path: Path) -> Iterator[None]:
    """Hold a lock file while the body runs; the kernel releases it even if the process is killed.

    Raises:
        BusyError: if another process holds it.
        StartError: if the file cannot be opened.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise StartError(f"lock: cannot open {path}: {error.strerror}") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 32).decode("ascii", "replace").strip() or "unknown"
            raise BusyError(f"already running as process {holder} (lock {path})") from None
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode("ascii"))
        yield
    finally:
        os.close(descriptor)


def _from_service(environ: Mapping[str, str], name: str) -> Path | None:
    """Return the first folder that systemd passed in a variable (it may pass several, colon separated)."""
    first = environ.get(name, "").partition(":")[0]
    return Path(first) if first.startswith("/") else None


def _xdg(environ: Mapping[str, str], name: str, default: Path) -> Path:
    given = environ.get(name, "")
    return Path(given) if given.startswith("/") else default


def _home(environ: Mapping[str, str]) -> Path:
    given = environ.get("HOME", "")
    return Path(given) if given.startswith("/") else Path.home()


def _refuse_foreign(folder: Path) -> None:
    """Refuse a runtime folder in which somebody else could plant a socket."""
    details = folder.lstat()
    if not stat.S_ISDIR(details.st_mode):
        raise StartError(f"directories: {folder} is not a folder")
    writable_by_others = details.st_mode & stat.S_IWOTH and not details.st_mode & stat.S_ISVTX
    if details.st_uid not in (0, os.getuid()) or writable_by_others:
        raise StartError(f"directories: {folder} can be changed by other users")
