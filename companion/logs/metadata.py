"""What a log says about the flight as a whole: who flew, with which configuration and which software."""

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata as distributions
from pathlib import Path
from typing import Literal

from companion import __version__

FLIGHT = "flight"
VERSIONS = "versions"
CONFIGURATION = "configuration.yaml"

_PACKAGES = ("foxglove-sdk", "mavsdk", "mcap", "numba", "numpy", "onnxruntime", "pymavlink", "scipy")
_HEAD_BYTES_MAX = 4096

LogMode = Literal["flight", "wire", "lockstep"]


@dataclass(frozen=True, slots=True)
class FlightMetadata:
    """What is true of the whole log.

    Attributes:
        vehicle: name of the vehicle.
        role: what it flew as: "leader", "follower".
        mode: where the bytes came from: real hardware, emulated hardware on sockets, or lockstep.
        configuration: the complete configuration as YAML or JSON text.
        seed: seed of the simulation, None in flight.
        git_commit: commit of the software, empty if unknown.
        calendar_ns: time of day at the start as Unix nanoseconds, 0 if it must not be recorded
            (lockstep runs with one seed write identical bytes).
        host_ns: host time at that moment, so that logs of several computers can be laid side by side; 0 if
            it is not recorded.
        versions: names and versions of the software.
    """

    vehicle: str
    role: str
    mode: LogMode
    configuration: str = ""
    seed: int | None = None
    git_commit: str = ""
    calendar_ns: int = 0
    host_ns: int = 0
    versions: Mapping[str, str] = field(default_factory=lambda: software_versions())

    def table(self) -> dict[str, str]:
        """Return everything short as texts, sorted by name; what is unknown is left out."""
        known = {
            "calendar_ns": str(self.calendar_ns) if self.calendar_ns else "",
            "git_commit": self.git_commit,
            "host_ns": str(self.host_ns) if self.host_ns else "",
            "mode": self.mode,
            "role": self.role,
            "seed": "" if self.seed is None else str(self.seed),
            "vehicle": self.vehicle,
        }
        return {name: text for name, text in known.items() if text}


def software_versions() -> dict[str, str]:
    """Return the versions of the companion, of Python and of the packages that shape a flight."""
    versions = {package: _version(package) for package in _PACKAGES}
    versions |= {"companion": __version__, "python": platform.python_version()}
    return {name: version for name, version in sorted(versions.items()) if version}


def _version(package: str) -> str:
    try:
        return distributions.version(package)
    except distributions.PackageNotFoundError:
        return ""


def source_commit(root: Path) -> str:
    """Return the git commit checked out at `root`, empty if it is no checkout."""
    try:
        head = _first_line(root / ".git" / "HEAD")
        if not head.startswith("ref: "):
            return head
        return _first_line(root / ".git" / head.removeprefix("ref: "))
    except OSError:
        return ""


def _first_line(path: Path) -> str:
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.readline(_HEAD_BYTES_MAX).strip()
