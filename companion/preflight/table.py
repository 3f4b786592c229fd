"""All checks in the order in which a person would work through them, and the table they make."""

from collections.abc import Iterable
from pathlib import Path

from companion.clock import SystemClock
from companion.config import Profile
from companion.directories import Directories
from companion.kernel_cache import load_kernels
from companion.preflight import hardware, host
from companion.preflight.check import Check, guarded, is_go


def run_checks(
    profile: Profile, profile_path: Path, directories: Directories, clock: SystemClock, *, offline: bool
) -> list[Check]:
    """Run every check that applies.

    Args:
        profile: the vehicle's profile, already valid.
        profile_path: where it came from.
        directories: the folders that `fly` would use.
        clock: the host's time.
        offline: leave out what needs the LiDAR, its network or the autopilot.

    Returns:
        The checks in the order in which a person would work through them.
    """
    checks = [
        Check("profile", "ok", f"{profile_path}: {profile.vehicle.name}, {profile.role}"),
        host.check_python(),
        host.check_packages(),
        guarded("kernels", lambda: host.check_kernels(clock, load_kernels)),
        host.check_calendar(clock.calendar_ns()),
        guarded("log folder", lambda: host.check_log_folder(directories.logs)),
        guarded("disk", lambda: host.check_disk(directories.logs)),
        host.check_receive_buffer(profile.lidar.receive_buffer_bytes),
        host.check_core_files(),
        guarded("single instance", lambda: host.check_single_instance(directories.runtime)),
    ]
    for name, look in hardware.looks(profile, clock):
        checks.append(Check(name, "skipped", "offline") if offline else guarded(name, look))
    return checks


def print_table(checks: Iterable[Check], vehicle: str) -> None:
    """Show the checks to a person."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    rows = list(checks)
    colours = {"ok": "green", "warn": "yellow", "fail": "red", "skipped": "dim"}
    table = Table(title=f"{vehicle}: {'GO' if is_go(rows) else 'NO GO'}", title_justify="left")
    for heading in ("check", "", "reason"):
        table.add_column(heading, overflow="fold")
    for check in rows:
        table.add_row(check.name, Text(check.verdict, style=colours[check.verdict]), Text(check.reason))
    Console(soft_wrap=False).print(table)
