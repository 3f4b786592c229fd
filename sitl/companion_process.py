"""The companion as a process of its own: exactly what runs on a vehicle, against the emulators."""

import asyncio
import os
import sys
import tempfile
from pathlib import Path

from companion.directories import SOCKET_NAME
from companion.errors import StartError

_STOP_TIMEOUT_S = 10.0
_CONSOLE_NAME = "companion.log"


class CompanionProcess:
    """Starts `companion fly`, watches it, ends it and finds its log."""

    def __init__(self, profile: Path, folder: Path) -> None:
        """Prepare; `folder` takes the console output and, in a folder of its own, the flight log."""
        self._profile = profile
        self._console = folder / _CONSOLE_NAME
        self._logs = Path(tempfile.mkdtemp(prefix="logs-", dir=folder))
        # A Unix socket's path must be short, whatever the folder is called.
        self._runtime = tempfile.TemporaryDirectory(prefix="companion-")
        self._process: asyncio.subprocess.Process | None = None

    @property
    def running(self) -> bool:
        """The process has started and not ended."""
        return self._process is not None and self._process.returncode is None

    @property
    def control_socket(self) -> Path:
        """Where `companion engage` speaks to it."""
        return Path(self._runtime.name) / SOCKET_NAME

    @property
    def pid(self) -> int | None:
        """Process id, None before the start."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start the process; it connects by itself."""
        environment = {
            **os.environ,
            "RUNTIME_DIRECTORY": self._runtime.name,
            "LOGS_DIRECTORY": str(self._logs),
            "STATE_DIRECTORY": str(self._logs),
        }
        with self._console.open("wb") as console:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                *("-m", "companion", "fly", str(self._profile), "--log-directory", str(self._logs)),
                stdout=console,
                stderr=console,
                env=environment,
                start_new_session=True,  # Ctrl-C is for the simulation, which then ends the companion
            )

    async def stop(self) -> None:
        """Ask the process to end, wait for it, and kill it only if it does not."""
        process = self._process
        if process is not None and process.returncode is None:
            process.terminate()
            try:
                await asyncio.wait_for(process.wait(), _STOP_TIMEOUT_S)
            except asyncio.TimeoutError:
                process.kill()
                await process.wait()
        self._runtime.cleanup()

    def last_words(self) -> str:
        """Return the last line of its console output."""
        lines = self._console.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if lines else "it said nothing"

    def take_log(self) -> Path:
        """Return the flight log that the process left, finished or not.

        Raises:
            StartError: if there is none, with the last line of the console output.
        """
        found = sorted(self._logs.glob("*.mcap*"))
        if not found:
            raise StartError(f"the companion wrote no log: {self.last_words()}")
        return found[-1]

    def remove_log(self) -> None:
        """Delete the log folder once its content has been taken over."""
        for path in self._logs.iterdir():
            path.unlink()
        self._logs.rmdir()
