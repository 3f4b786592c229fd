"""What a service manager needs from the process: readiness, proof of life, an orderly end.

The watchdog is fed only when every part of the pipeline has moved since it was last fed, never by a timer
alone: a process whose odometry thread hangs looks dead from outside, and is restarted.
"""

import asyncio
import os
import signal
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import structlog

from companion.clock import SystemClock
from companion.directories import LOCK_NAME, Directories, only_instance

NANOSECONDS_PER_MICROSECOND = 1_000
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_MAX_STATUS_LENGTH = 200

_log = structlog.get_logger(__name__)


def write_logs_to_stderr() -> None:
    """Send log lines to the error output: JSON for the journal, readable text for a terminal."""
    terminal = sys.stderr.isatty()
    stamp = structlog.processors.TimeStamper(fmt="%H:%M:%S" if terminal else "iso", utc=not terminal)
    renderer = structlog.dev.ConsoleRenderer() if terminal else structlog.processors.JSONRenderer()
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            stamp,
            structlog.processors.format_exc_info,
            renderer,
        ],
        logger_factory=structlog.WriteLoggerFactory(sys.stderr),
    )


class Notifier:
    """Speaks systemd's notification protocol; silent when nobody listens."""

    def __init__(self, address: str | None) -> None:
        """Send to a Unix datagram socket; a leading ``@`` means the abstract namespace."""
        self._address = "\0" + address[1:] if address and address.startswith("@") else address
        self.failures = 0

    def ready(self) -> bool:
        """Tell that start-up is complete."""
        return self._send("READY=1")

    def status(self, text: str) -> bool:
        """Set the line that ``systemctl status`` shows."""
        line = " ".join(text.split())[:_MAX_STATUS_LENGTH]
        return self._send(f"STATUS={line}")

    def watchdog(self) -> bool:
        """Prove that the process is alive."""
        return self._send("WATCHDOG=1")

    def stopping(self) -> bool:
        """Tell that the process is about to end."""
        return self._send("STOPPING=1")

    def _send(self, state: str) -> bool:
        """Send one datagram; returns whether somebody took it. Never blocks, never raises."""
        if not self._address:
            return False
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
                connection.setblocking(False)
                connection.sendto(state.encode("utf-8"), self._address)
        except OSError as error:
            self.failures += 1
            if self.failures == 1:
                _log.warning("service manager does not listen", error=error.strerror)
            return False
        return True


def watchdog_interval_ns(environ: Mapping[str, str]) -> int | None:
    """Return how often the service manager wants proof of life, None when it does not."""
    interval, owner = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", "")
    if not interval.isdecimal() or int(interval) == 0:
        return None
    if owner and owner != str(os.getpid()):
        return None
    return int(interval) * NANOSECONDS_PER_MICROSECOND


class Liveness:
    """Counters that every part of the pipeline must keep moving."""

    def __init__(self, parts: Iterable[str] = ()) -> None:
        """Name the parts; each has one thread or task that moves it."""
        self._moves = dict.fromkeys(parts, 0)
        self._seen = dict(self._moves)

    def require(self, part: str) -> None:
        """Add a part; from now on life includes it."""
        self._moves.setdefault(part, 0)
        self._seen.setdefault(part, 0)

    def release(self, part: str) -> None:
        """Remove a part that has ended on purpose."""
        self._moves.pop(part, None)
        self._seen.pop(part, None)

    def move(self, part: str) -> None:
        """Count one unit of work of a part.

        Raises:
            KeyError: if the part was never named.
        """
        self._moves[part] += 1

    def idle(self) -> tuple[str, ...]:
        """Return the parts that have not moved since `advance` last returned True."""
        return tuple(part for part, count in self._moves.items() if count == self._seen.get(part))

    def advance(self) -> bool:
        """Return whether every part has moved, and if so begin the next round; False without parts."""
        if not self._moves or self.idle():
            return False
        self._seen = dict(self._moves)
        return True


class StopSignal:
    """A request to end, with its reason; the first one counts."""

    def __init__(self) -> None:
        """Start without a request."""
        self._event = asyncio.Event()
        self._reason = ""

    @property
    def requested(self) -> bool:
        """Whether somebody asked to end."""
        return self._event.is_set()

    @property
    def reason(self) -> str:
        """Why; empty while nobody asked."""
        return self._reason

    def request(self, reason: str) -> None:
        """Ask to end; call on the event loop's thread."""
        if not self._event.is_set():
            self._reason = reason
            self._event.set()

    async def wait(self) -> str:
        """Wait for the request and return its reason."""
        await self._event.wait()
        return self._reason


class Service:
    """One running vehicle seen from outside: its folders, proof of life and request to end."""

    def __init__(
        self, directories: Directories, notifier: Notifier, watchdog_ns: int | None, parts: Iterable[str] = ()
    ) -> None:
        """Join the parts; `watchdog_ns` is the service manager's interval or None."""
        self.directories = directories
        self.notifier = notifier
        self.liveness = Liveness(parts)
        self.stop = StopSignal()
        self._watchdog_ns = watchdog_ns

    def ready(self) -> None:
        """Report that kernels are compiled, sockets are open and the log is running."""
        self.notifier.ready()

    def status(self, text: str) -> None:
        """Report one line about the present state."""
        self.notifier.status(text)

    @contextmanager
    def signals(self) -> Iterator[None]:
        """Turn the stop signals into a stop request while the body runs; call on the event loop."""
        loop = asyncio.get_running_loop()
        for number in STOP_SIGNALS:
            loop.add_signal_handler(number, self.stop.request, number.name)
        try:
            yield
        finally:
            for number in STOP_SIGNALS:
                loop.remove_signal_handler(number)

    async def keep_watchdog(self, clock: SystemClock) -> None:
        """Feed the watchdog for as long as everything moves; returns at once when nobody asked for it."""
        if self._watchdog_ns is None:
            return
        warned: tuple[str, ...] = ()
        last_fed_ns = clock.now_ns()
        while True:
            await clock.sleep(self._watchdog_ns // 8)
            now_ns = clock.now_ns()
            if self.liveness.advance():
                self.notifier.watchdog()
                last_fed_ns, warned = now_ns, ()
            elif now_ns - last_fed_ns > self._watchdog_ns // 2 and self.liveness.idle() != warned:
                warned = self.liveness.idle()
                _log.error("watchdog not fed", idle=list(warned))


@contextmanager
def open_service(environ: Mapping[str, str], vehicle: str) -> Iterator[Service]:
    """Create the folders and take the instance lock while the body runs.

    Args:
        environ: the process environment.
        vehicle: name of the vehicle, used for folders outside systemd.

    Raises:
        BusyError: if this vehicle's companion runs already.
        StartError: if a folder or the lock cannot be created.
    """
    directories = Directories.resolve(environ, vehicle)
    directories.create()
    with only_instance(directories.runtime / LOCK_NAME):
        service = Service(directories, Notifier(environ.get("NOTIFY_SOCKET")), watchdog_interval_ns(environ))
        try:
            yield service
        finally:
            service.notifier.stopping()
