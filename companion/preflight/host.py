"""Preflight checks of this computer: software, disk, limits; none needs the vehicle's hardware."""

import os
import platform
import re
import resource
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

from companion.clock import NANOSECONDS_PER_SECOND, SystemClock, ns_to_seconds
from companion.directories import LOCK_NAME, BusyError, only_instance
from companion.preflight.check import Check, Verdict

MIN_PYTHON = (3, 10)
FREE_BYTES_WANTED = 5_000_000_000  # half an hour of raw LiDAR data at 2.8 MB/s
FREE_BYTES_NEEDED = 1_000_000_000
EARLIEST_CALENDAR_NS = 1_767_225_600 * NANOSECONDS_PER_SECOND  # 2026-01-01: older is a clock never set
SLOW_KERNELS_S = 10.0
_SHOWN_PACKAGES = ("mavsdk", "numba", "numpy", "pydantic")


def check_python() -> Check:
    """Compare the interpreter with the oldest supported one."""
    version = platform.python_version()
    verdict: Verdict = "ok" if sys.version_info[:2] >= MIN_PYTHON else "fail"
    return Check("python", verdict, f"{version} on {platform.machine()}")


def check_packages() -> Check:
    """See that every package the product needs is installed."""
    missing = []
    for requirement in metadata.requires("companion") or []:
        if ";" in requirement:
            continue  # optional, or one of two builds of the same package
        match = re.match(r"[A-Za-z0-9._-]+", requirement)
        assert match is not None
        try:
            metadata.version(match.group())
        except metadata.PackageNotFoundError:
            missing.append(match.group())
    if missing:
        return Check("packages", "fail", f"not installed: {', '.join(sorted(missing))}")
    return Check("packages", "ok", ", ".join(f"{name} {metadata.version(name)}" for name in _SHOWN_PACKAGES))


def check_kernels(clock: SystemClock, load: Callable[[], int]) -> Check:
    """Make every numerical kernel ready, as the start of a flight does, and see how long that takes."""
    begin_ns = clock.now_ns()
    kernels = load()
    seconds = ns_to_seconds(clock.now_ns() - begin_ns)
    if seconds > SLOW_KERNELS_S:
        advice = "they were compiled just now; run `companion warmup` as the user who flies"
        return Check("kernels", "warn", f"{kernels} kernels took {seconds:.0f} s: {advice}")
    return Check("kernels", "ok", f"{kernels} kernels ready in {seconds:.1f} s")


def check_calendar(calendar_ns: int) -> Check:
    """See that the time of day is set: flight does not depend on it, names and times of logs do."""
    if calendar_ns < EARLIEST_CALENDAR_NS:
        return Check("clock", "warn", "the time of day was never set: logs will carry a wrong date")
    return Check("clock", "ok", "the time of day is set")


def check_log_folder(folder: Path) -> Check:
    """Write, sync and remove a small file where the log will be."""
    existing = _nearest_existing(folder)
    with tempfile.NamedTemporaryFile(dir=existing, prefix=".preflight-") as file:
        file.write(b"preflight")
        file.flush()
        os.fsync(file.fileno())
    unfinished = len(list(folder.glob("*.mcap.open"))) if existing == folder else 0
    if unfinished:
        return Check("log folder", "warn", f"{folder}: {unfinished} unfinished logs, see `companion recover`")
    note = "" if existing == folder else " (will be created)"
    return Check("log folder", "ok", f"{folder}{note}")


def check_disk(folder: Path) -> Check:
    """Compare the free space with what a flight records."""
    free = shutil.disk_usage(_nearest_existing(folder)).free
    text = f"{free / 1e9:.1f} GB free, a flight of 15 minutes takes up to 2.5 GB"
    if free < FREE_BYTES_NEEDED:
        return Check("disk", "fail", text)
    return Check("disk", "ok" if free >= FREE_BYTES_WANTED else "warn", text)


def check_receive_buffer(wanted_bytes: int) -> Check:
    """Ask the kernel for the LiDAR socket's buffer and see what it grants."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
        granted = probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # the kernel doubles it
    if granted < wanted_bytes:
        advice = f"run `sysctl -w net.core.rmem_max={wanted_bytes}`"
        return Check("receive buffer", "warn", f"{granted} of {wanted_bytes} bytes granted: {advice}")
    return Check("receive buffer", "ok", f"{granted} bytes granted")


def check_core_files() -> Check:
    """See that a crash would not spend seconds on writing memory to the disk before the restart."""
    limit = resource.getrlimit(resource.RLIMIT_CORE)[0]
    if limit != 0:
        return Check("core files", "warn", "core files are allowed: a crash may fill the disk (LimitCORE=0)")
    return Check("core files", "ok", "switched off")


def check_single_instance(runtime: Path) -> Check:
    """See that this vehicle's companion does not run already."""
    if not runtime.is_dir():
        return Check("single instance", "ok", "not running")
    try:
        with only_instance(runtime / LOCK_NAME):
            return Check("single instance", "ok", "not running")
    except BusyError as error:
        return Check("single instance", "fail", str(error))


def _nearest_existing(folder: Path) -> Path:
    """Return the folder, or the nearest one above it that exists."""
    return next(parent for parent in (folder, *folder.parents) if parent.is_dir())
