"""The thread in which the heavy half of the pipeline runs."""

import queue
import threading
from collections.abc import Callable, Sequence

from companion.messages import LidarScan, PerceptionUpdate, SensorEvent
from companion.pipeline import Pipeline

_MAX_WAITING_EVENTS = 400  # two seconds of IMU samples
_MAX_WAITING_SCANS = 3
_IDLE_TURN_S = 0.1

Placed = Callable[[SensorEvent, int | None], None]


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

    def submit(self, event: SensorEvent, placed: Placed | None = None) -> int | None:
        """Queue one event, from any thread; when perception is late, scans go first, and are counted.

        Args:
            event: what to work on.
            placed: told the event and the result, before anything can come of the event.

        Returns:
            How many events were queued before this one, None if it was left out.
        """
        with self._lock:
            place = self._place_of(event)
            if placed is not None:
                placed(event, place)
            if place is None:
                self.dropped += 1
                return None
            self._events.put_nowait(event)
            self._waiting_scans += isinstance(event, LidarScan)
            self._taken += 1
            return place

    def _place_of(self, event: SensorEvent) -> int | None:
        """Return how many events stand before this one, None if there is no room for it."""
        no_scan_more = isinstance(event, LidarScan) and self._waiting_scans >= _MAX_WAITING_SCANS
        return None if no_scan_more or self._events.full() else self._taken

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
