"""The thread in which the heavy half of the pipeline runs."""

import queue
import threading
from collections.abc import Callable, Sequence

from companion.messages import LidarScan, PerceptionUpdate, SensorEvent
from companion.pipeline import Pipeline

_MAX_WAITING_EVENTS = 400  # two seconds of IMU samples
_MAX_WAITING_SCANS = 3
_IDLE_TURN_S = 0.1


class PerceptionThread:
    """Runs `Pipeline.perceive` beside the event loop."""

    def __init__(
        self,
        pipeline: Pipeline,
        deliver: Callable[[Sequence[PerceptionUpdate]], None],
        moved: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:
        """Prepare; all functions are called from this thread.

        Args:
            pipeline: whose `perceive` runs here.
            deliver: takes new estimates.
            moved: called on every turn, as proof of life.
            failed: told what ended the thread, if it was not `stop`.
        """
        self._pipeline = pipeline
        self._deliver = deliver
        self._moved = moved
        self._failed = failed
        self._events: queue.Queue[SensorEvent] = queue.Queue(_MAX_WAITING_EVENTS)
        self._stopping = threading.Event()
        self._waiting_scans = 0
        self._lock = threading.Lock()
        self._taken = 0
        self._thread = threading.Thread(target=self._run, name="perception", daemon=True)
        self.dropped = 0

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def stop(self) -> None:
        """Finish what waits and end; gives up after two seconds."""
        self._stopping.set()
        self._thread.join(timeout=2.0)

    def submit(self, event: SensorEvent) -> int | None:
        """Queue one event, from any thread; when perception is late, scans go first, and are counted.

        Returns:
            How many events were queued before this one, None if it was left out.
        """
        is_scan = isinstance(event, LidarScan)
        with self._lock:
            if is_scan and self._waiting_scans >= _MAX_WAITING_SCANS:
                self.dropped += 1
                return None
            try:
                self._events.put_nowait(event)
            except queue.Full:
                self.dropped += 1
                return None
            self._waiting_scans += is_scan
            self._taken += 1
            return self._taken - 1

    def _run(self) -> None:
        try:
            self._work()
        except Exception as error:
            self._failed(error)

    def _work(self) -> None:
        while not (self._stopping.is_set() and self._events.empty()):
            self._moved()
            try:
                event = self._events.get(timeout=_IDLE_TURN_S)
            except queue.Empty:
                continue
            if isinstance(event, LidarScan):
                with self._lock:
                    self._waiting_scans -= 1
            updates = self._pipeline.perceive(event)
            if updates:
                self._deliver(updates)
