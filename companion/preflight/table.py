"""All checks in the order in which a person would work through them, and the table they make."""

import asyncio
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from companion.clock import SystemClock
from companion.config import Profile
from companion.directories import Directories
from companion.kernel_cache import load_kernels
from companion.preflight import host
from companion.preflight.check import Check, guarded, is_go

EXTERNAL_ODOMETRY = "external odometry"
HARDWARE = ("LiDAR network", "LiDAR", "autopilot")


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
    looks: list[tuple[str, Callable[[], Check | Sequence[Check]]]] = [
        (
            "profile",
            lambda: Check("profile", "ok", f"{profile_path}: {profile.vehicle.name}, {profile.role}"),
        ),
        ("python", host.check_python),
        ("packages", host.check_packages),
        ("kernels", lambda: host.check_kernels(clock, load_kernels)),
        ("clock", lambda: host.check_calendar(clock.calendar_ns())),
        ("log folder", lambda: host.check_log_folder(directories.logs)),
        ("disk", lambda: host.check_disk(directories.logs)),
        ("receive buffer", lambda: host.check_receive_buffer(profile.lidar.receive_buffer_bytes)),
        ("core files", host.check_core_files),
        ("single instance", lambda: host.check_single_instance(directories.runtime)),
    ]
    if profile.follower is not None and profile.follower.controller == "policy":
        # Its runtime takes a moment to import, and most vehicles fly without.
        from companion.preflight.policy import NAME, check_policy

        follower = profile.follower
        looks.append((NAME, lambda: check_policy(follower, clock)))
    external = profile.odometry.source == "external"
    if offline:
        names = (*HARDWARE, EXTERNAL_ODOMETRY) if external else HARDWARE
        skipped = [Check(name, "skipped", "offline") for name in names]
        return [check for name, look in looks for check in guarded(name, look)] + skipped

    # The drivers take a second to import; offline nothing needs them.
    from companion.preflight.autopilot import check_autopilot
    from companion.preflight.lidar import STREAM_TIMEOUT_S, check_lidar, check_lidar_network

    looks += [
        ("LiDAR network", lambda: check_lidar_network(profile.lidar)),
        ("LiDAR", lambda: asyncio.run(check_lidar(profile.lidar, clock, STREAM_TIMEOUT_S))),
        ("autopilot", lambda: asyncio.run(check_autopilot(profile, clock))),
    ]
    if external:
        from companion.preflight.external_odometry import check_external_odometry

        looks.append((EXTERNAL_ODOMETRY, lambda: asyncio.run(check_external_odometry(profile, clock))))
    return [check for name, look in looks for check in guarded(name, look)]


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
