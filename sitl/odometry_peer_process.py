"""Somebody else's odometry as a process of its own, beside the companion's."""

import asyncio
import sys
from pathlib import Path

from companion.config import Profile

POINTS_PORT = 57_301
IMU_PORT = 57_401
"""Where copies of the LiDAR's packets go, as from a switch that mirrors a port."""

_STOP_TIMEOUT_S = 5.0
_CONSOLE_NAME = "odometry-peer.log"


def mirrored_ports(profile: Profile) -> dict[int, int]:
    """Return which of the LiDAR's destination ports is copied to which."""
    ports = profile.lidar.host_ports
    return {ports.points: POINTS_PORT, ports.imu: IMU_PORT}


class OdometryPeerProcess:
    """Starts `sitl odometry-peer` and ends it."""

    def __init__(self, profile: Profile, profile_path: Path, folder: Path) -> None:
        """Prepare; `folder` takes the console output."""
        link = profile.external_odometry
        self._arguments = (
            *("odometry-peer", str(profile_path), "--to", f"{link.bind_ip}:{link.port}"),
            *("--points-port", str(POINTS_PORT), "--imu-port", str(IMU_PORT)),
        )
        self._console = folder / _CONSOLE_NAME
        self._process: asyncio.subprocess.Process | None = None

    @property
    def running(self) -> bool:
        """The process has started and not ended."""
        return self._process is not None and self._process.returncode is None

    @property
    def pid(self) -> int | None:
        """Process id, None before the start."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start the process."""
        with self._console.open("wb") as console:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                *("-m", "sitl", *self._arguments),
                stdout=console,
                stderr=console,
                start_new_session=True,
            )

    async def stop(self) -> None:
        """Ask the process to end, wait for it, and kill it only if it does not."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        process.terminate()
        try:
            await asyncio.wait_for(process.wait(), _STOP_TIMEOUT_S)
        except asyncio.TimeoutError:
            process.kill()
            await process.wait()

    def last_words(self) -> str:
        """Return the last line of its console output."""
        lines = self._console.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if lines else "it said nothing"
