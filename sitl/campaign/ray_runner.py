"""Tasks on a Ray cluster that exists already; those of a worker or computer that dies are done again."""

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from companion.errors import StartError

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

_RETRIES = 20
"""Of one task, when the worker or the computer under it dies."""
_AHEAD = 3
"""Tasks handed to the cluster for each of its processors."""
_PATIENCE_S = 5.0


def on_cluster(work: Callable[[_Task], _Result], tasks: Sequence[_Task], address: str) -> Iterator[_Result]:
    """Do tasks on an existing cluster, each on one processor.

    Every computer of the cluster must have the same version of this product installed.

    Args:
        work: importable function without side effects.
        tasks: what to do.
        address: of the cluster's head, as ``HOST:PORT``, or ``auto`` for one on this computer.

    Yields:
        The result of every task, in the order in which they end.

    Raises:
        StartError: if there is no such cluster, or Ray is not installed.
    """
    # Said before Ray is loaded: nothing is sent to anybody about this use of it.
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    try:
        import ray
    except ImportError:
        raise StartError("cluster: Ray is not installed; install this product's extra `cluster`") from None
    _knock(address)
    try:
        ray.init(address=address, log_to_driver=False, include_dashboard=None, logging_level="ERROR")
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise StartError(f"cluster: no Ray cluster at {address}: {_first_line(error)}") from None
    try:
        remote = ray.remote(num_cpus=1, max_retries=_RETRIES)(_do)
        yield from _gather(ray, remote, work, tasks)
    finally:
        ray.shutdown()


def _knock(address: str) -> None:
    """Make sure that somebody listens at ``HOST:PORT``: Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    if "/" in address or not host or not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE_S).close()
    except (OSError, OverflowError, UnicodeError) as error:
        raise StartError(f"cluster: no Ray cluster at {address}: {_first_line(error)}") from None


def _do(work: Callable[[_Task], _Result], task: _Task) -> _Result:
    return work(task)


def _gather(ray: Any, remote: Any, work: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[Any]:
    """Keep a bounded number of tasks on the cluster, however large it is by now."""
    waiting: list[Any] = []
    place = 0
    while place < len(tasks) or waiting:
        ahead = max(1, _AHEAD * int(ray.cluster_resources().get("CPU", 1.0)))
        while place < len(tasks) and len(waiting) < ahead:
            waiting.append(remote.remote(work, tasks[place]))
            place += 1
        ready, waiting = ray.wait(waiting, num_returns=1, timeout=_PATIENCE_S)
        for reference in ready:
            yield ray.get(reference)


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or ["no reason given"])[0]
