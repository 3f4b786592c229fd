"""One flight seen from outside: kernels ready, log open, service registered, then the runtime."""

import asyncio
import datetime
import gc
import sys
from collections.abc import Mapping
from pathlib import Path

import structlog

from companion import runtime
from companion.clock import NANOSECONDS_PER_SECOND, SystemClock
from companion.config import Profile, profile_text
from companion.kernel_cache import load_kernels
from companion.logs.metadata import FlightMetadata, source_commit
from companion.logs.writer import FlightLog
from companion.runtime import FlightOutcome
from companion.service import open_service

_log = structlog.get_logger(__name__)


# How long a thread may keep the interpreter while another waits: the event loop must not wait longer.
_SWITCH_INTERVAL_S = 0.001


def _quieten_interpreter() -> None:
    """Keep what start-up has built out of every later garbage collection, and let threads alternate fast."""
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)


def log_path(folder: Path, vehicle: str, calendar_ns: int) -> Path:
    """Return the name of a log that begins at a time of day, given in Unix nanoseconds."""
    seconds, rest_ns = divmod(calendar_ns, NANOSECONDS_PER_SECOND)
    moment = datetime.datetime.fromtimestamp(seconds, tz=datetime.timezone.utc)
    return folder / f"{vehicle}-{moment:%Y%m%dT%H%M%S}{rest_ns // 1_000_000:03d}Z.mcap"


def run_flight(profile: Profile, environ: Mapping[str, str], log_directory: Path | None) -> FlightOutcome:
    """Run the companion on the vehicle until it is told to stop.

    Args:
        profile: the vehicle's profile.
        environ: the process environment, with what the service manager says in it.
        log_directory: folder for the flight log; the service's own by default.

    Raises:
        BusyError: if this vehicle's companion runs already.
        StartError: if a driver cannot start.
    """
    clock = SystemClock()
    with open_service(environ, profile.vehicle.name) as service:
        service.status("starting: kernels")
        _log.info("kernels ready", kernels=load_kernels())
        folder = log_directory or service.directories.logs
        metadata = FlightMetadata(
            vehicle=profile.vehicle.name,
            role=profile.role,
            mode="flight",
            configuration=profile_text(profile),
            git_commit=source_commit(Path(__file__).parents[1]),
            calendar_ns=clock.calendar_ns(),
            host_ns=clock.now_ns(),
        )
        path = log_path(folder, profile.vehicle.name, metadata.calendar_ns)
        log = FlightLog(path, profile.log, metadata, threaded=True, clock=clock)
        _quieten_interpreter()
        try:
            return asyncio.run(runtime.fly(profile, clock=clock, service=service, log=log))
        finally:
            log.close()
