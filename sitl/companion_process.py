"""The companion as a process of its own: exactly what runs on a vehicle, against the emulators."""

import asyncio
import os
import signal
import sys
import tempfile
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, TypeVar

from companion.directories import SOCKET_NAME
from companion.errors import StartError
from companion.logs.log_queue import LogEntry
from companion.logs.recovery import add_messages

_STOP_TIMEOUT_S = 10.0
_CONSOLE_NAME = "companion.log"
_Result = TypeVar("_Result")


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

    def log(self) -> Path | None:
        """Return the flight log that the process left, finished or not, if there is one."""
        found = sorted(self._logs.glob("*.mcap*"))
        return found[-1] if found else None

    def hand_over_log(self, truth: Sequence[LogEntry], log_path: Path) -> None:
        """Move the flight log to `log_path` with the truth added, however the flight ended.

        A process that never started has none, and whatever kept it from starting is what should be heard.

        Raises:
            StartError: if there is no log, with the last line of the console output.
            LogError: if it cannot be copied; it then stays where it is.
        """
        if self._process is None:
            self._logs.rmdir()
            return
        log = self.log()
        if log is None:
            raise StartError(f"the companion wrote no log: {self.last_words()}")
        add_messages(log, truth, log_path)
        for path in self._logs.iterdir():
            path.unlink()
        self._logs.rmdir()


def run_until_terminated(flight: Coroutine[Any, Any, _Result]) -> _Result:
    """Run a flight; SIGTERM ends it in order like Ctrl-C, so that no companion is left behind.

    Raises:
        KeyboardInterrupt: if it was ended by a signal.
    """

    async def watched() -> _Result:
        task = asyncio.current_task()
        assert task is not None
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
        return await flight

    try:
        return asyncio.run(watched())
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None
