"""Tasks on the cores of this computer: processes that come and go, and results as they are ready."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import structlog
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool

from companion.errors import StartError

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

_DEATHS_IN_A_ROW = 3
_WATCH_PERIOD_S = 1.0

_log = structlog.get_logger(__name__)


class WorkersError(StartError):
    """Worker processes die again and again, or cannot be had; the text says what is known."""


def cores() -> int:
    """Return how many processes this one may run at once."""
    return len(os.sched_getaffinity(0))


def on_processes(work: Callable[[_Task], _Result], tasks: Sequence[_Task], workers: int) -> Iterator[_Result]:
    """Do tasks in worker processes, or in this one if there is to be one worker.

    When a worker dies, all are replaced and the tasks without a result are done again.

    Args:
        work: importable function without side effects.
        tasks: what to do; each is sent to a worker by itself.
        workers: processes.

    Yields:
        The result of every task, in the order in which they end.

    Raises:
        WorkersError: if workers die several times in a row without a result in between.
    """
    if workers == 1:
        yield from map(work, tasks)
        return
    left = dict(enumerate(tasks))
    deaths = 0
    while left:
        pool = Parallel(
            n_jobs=workers,
            backend="loky",
            return_as="generator_unordered",
            batch_size=1,
            pre_dispatch="3*n_jobs",
            initializer=_obey,
            initargs=(os.getpid(),),
        )
        results = pool(delayed(_numbered)(work, number, task) for number, task in list(left.items()))
        try:
            for number, result in results:
                del left[number]
                deaths = 0
                yield result
        except BrokenProcessPool:
            deaths += 1
            if deaths == _DEATHS_IN_A_ROW:
                raise WorkersError(
                    f"worker processes ended {deaths} times in a row without a result: out of memory?"
                ) from None
            _log.warning("a worker process ended; its tasks are done again", left=len(left))


def _numbered(work: Callable[[_Task], _Result], number: int, task: _Task) -> tuple[int, _Result]:
    return number, work(task)


def _obey(parent: int) -> None:
    """Make this process end when its parent does, and only then.

    Ctrl-C reaches the whole group of processes, but only the parent knows how to end in order. If the parent
    is killed it can tell nobody, so somebody has to look.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        never = threading.Event()
        while os.getppid() == parent:
            never.wait(_WATCH_PERIOD_S)
        os._exit(0)

    threading.Thread(target=watch, name="parent-watch", daemon=True).start()
