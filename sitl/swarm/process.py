"""Shares of a swarm in processes of their own, which exchange their truth with every step.

The first share flies in the caller's process, which gathers all rows, lets the referee look, and sends the
whole table to everybody. What a vehicle does depends on that table alone, so the number of processes cannot
be seen in any log.
"""

import contextlib
import gc
import multiprocessing
import signal
from collections.abc import Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

import numpy as np

from companion.errors import CompanionError
from companion.messages import FloatArray
from sitl.swarm.eyes import lent_eyes, midway_of, slots_as_bytes, slots_from_bytes
from sitl.swarm.lockstep import FlightPlan, Share
from sitl.swarm.table import WIDTH, Table

_CLOSING_S = 20.0
_GOING_ON, _START_GIVEN, _OVER = b"\0", b"\1", b"\2"
_ROWS, _ERROR = b"R", b"E"
_TEXT_MAX = 2000


class WorkerLostError(CompanionError):
    """A process that flew some of the vehicles is gone; the text says which, and why."""


class Worker:
    """One share in a process of its own, seen from the process that gathers."""

    def __init__(self, plan: FlightPlan, numbers: Sequence[int], blind: Sequence[int]) -> None:
        """Start the process; it will be told what the vehicles in `blind` see."""
        context = multiprocessing.get_context("spawn")
        self.numbers = list(numbers)
        self.blind = sorted(blind)
        self._connection, theirs = context.Pipe()
        self._process: BaseProcess = context.Process(
            target=_fly_share,
            args=(plan, tuple(numbers), tuple(blind), theirs),
            name="swarm-share",
            daemon=True,
        )
        self._process.start()
        theirs.close()

    @property
    def pid(self) -> int | None:
        """Process id."""
        return self._process.pid

    def rows(self) -> FloatArray:
        """Wait for the rows of this share (k, WIDTH).

        Raises:
            WorkerLostError: if there will be none.
        """
        try:
            data = self._connection.recv_bytes()
        except (EOFError, OSError):
            raise WorkerLostError(self._epitaph()) from None
        if data[:1] == _ERROR:
            raise WorkerLostError(f"{self._name()} failed: {data[1:].decode(errors='replace')}")
        return np.frombuffer(data, np.float64, offset=1).reshape(-1, WIDTH)

    def tell(self, flag: bytes, table: FloatArray) -> None:
        """Send the whole table.

        Raises:
            WorkerLostError: if nobody hears it.
        """
        self.send(flag + table.tobytes())

    def send(self, data: bytes) -> None:
        """Send anything else.

        Raises:
            WorkerLostError: if nobody hears it.
        """
        try:
            self._connection.send_bytes(data)
        except OSError:
            raise WorkerLostError(self._epitaph()) from None

    def close(self) -> None:
        """Hang up, which makes the process complete its logs and end, and wait for that."""
        self._connection.close()
        self._process.join(_CLOSING_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _name(self) -> str:
        return f"the process of vehicles {', '.join(map(str, self.numbers))}"

    def _epitaph(self) -> str:
        self._process.join(_CLOSING_S)
        code = self._process.exitcode
        if code is not None and code < 0:
            return f"{self._name()} was ended by {signal.Signals(-code).name}"
        return f"{self._name()} ended with status {code}"


class Swarm:
    """All vehicles of a flight, wherever they are advanced."""

    def __init__(self, plan: FlightPlan, shares: Sequence[Sequence[int]]) -> None:
        """Switch everybody on: the first share here, every other in a process of its own.

        Raises:
            LogError, OSError: if a log cannot be created.
        """
        self._workers: list[Worker] = []
        self._own = list(shares[0])
        self._size = plan.vehicles
        self._share: Share | None = None
        try:
            lent = lent_eyes(shares)
            for index, numbers in enumerate(shares[1:], start=1):
                self._workers.append(Worker(plan, numbers, lent.get(index, ())))
            hosted = [number for numbers in lent.values() for number in numbers]
            self._share = Share(plan, self._own, hosted=hosted)
        except BaseException:
            self.close()
            raise

    @property
    def workers(self) -> list[Worker]:
        """The other processes."""
        return self._workers

    def first_table(self) -> Table:
        """Return everybody at power-on."""
        assert self._share is not None
        table = self._gathered(self._share.rows())
        self._tell(_GOING_ON, table)
        return table

    def move(self) -> Table:
        """Advance all airframes by 5 ms; return everybody at the end of the step.

        Raises:
            WorkerLostError: if a process is gone.
        """
        assert self._share is not None
        return self._gathered(self._share.move())

    def live(self, before: Table, now: Table, *, start_given: bool) -> None:
        """Let everybody measure and talk during the step just made.

        Raises:
            WorkerLostError: if a process is gone.
        """
        assert self._share is not None
        self._tell(_START_GIVEN if start_given else _GOING_ON, now)
        midway = midway_of(before, now)
        for worker in self._workers:
            for number in worker.blind:
                worker.send(slots_as_bytes(self._share.eyes[number].look(before, now, midway)))
        self._share.live(before, now, midway, start_given=start_given)

    def end(self, now: Table) -> None:
        """Let everybody complete their logs."""
        with contextlib.suppress(WorkerLostError):
            self._tell(_OVER, now)
        self.close()

    def close(self) -> None:
        """Complete the logs of everybody who still can; safe to call twice."""
        workers, self._workers = self._workers, []
        try:
            if self._share is not None:
                self._share.close()
        finally:
            for worker in workers:
                worker.close()

    def _gathered(self, own_rows: FloatArray) -> Table:
        rows = np.empty((self._size, WIDTH))
        rows[self._own] = own_rows
        for worker in self._workers:
            rows[worker.numbers] = worker.rows()
        return Table(rows)

    def _tell(self, flag: bytes, table: Table) -> None:
        for worker in self._workers:
            worker.tell(flag, table.rows)


def _fly_share(
    plan: FlightPlan, numbers: tuple[int, ...], blind: tuple[int, ...], connection: Connection
) -> None:
    """Advance one share until told to end or hung up on; runs in its own process."""
    # Ctrl-C reaches the whole group; the process that gathers decides what follows.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    from companion.kernel_cache import load_kernels

    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError, KeyboardInterrupt):
        try:
            load_kernels()
            share = Share(plan, numbers, blind=blind)
            gc.collect()
            gc.freeze()  # nothing built so far becomes garbage during the flight
            try:
                _serve(share, connection)
            finally:
                share.close()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            raise
        except Exception as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            connection.send_bytes(_ERROR + text[:_TEXT_MAX].encode())


def _serve(share: Share, connection: Connection) -> None:
    before: Table | None = None
    rows = share.rows()
    while True:
        connection.send_bytes(_ROWS + rows.tobytes())
        data = connection.recv_bytes()
        flag, now = data[:1], Table(np.frombuffer(data, np.float64, offset=1).reshape(-1, WIDTH))
        if flag == _OVER:
            return
        if before is not None:
            share.live(
                before,
                now,
                midway_of(before, now),
                start_given=flag == _START_GIVEN,
                receive=lambda: slots_from_bytes(connection.recv_bytes()),
            )
        before = now
        rows = share.move()
