"""A run of the companion whose drivers are played, and whose time moves only by sleeping."""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion import runtime
from companion.clock import SystemClock
from companion.config import Profile
from companion.directories import SOCKET_NAME, Directories
from companion.drivers.livox_framing import LivoxStatistics
from companion.logs import channels
from companion.logs.metadata import FlightMetadata
from companion.logs.reader import FlightRecording
from companion.logs.records import Statistics
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import (
    ControlEvent,
    FlightState,
    LidarScan,
    MavlinkMessage,
    OdometryStatus,
    Output,
    PerceptionUpdate,
    RegisteredScan,
    SensorEvent,
)
from companion.pipeline import Pipeline
from companion.runtime import Flight, FlightOutcome
from companion.safety.settings import SafetySettings
from companion.service import Notifier, Service
from companion.yaml_source import loads
from tests.drivers.px4_peer import MS, an_odometry
from tests.hold_role import HoldRole
from tests.pipeline_rig import NoTracker
from tests.profiles import GOOD

SECOND_NS = 1_000_000_000


class SteppedClock(SystemClock):
    """Host time that moves only by sleeping, or when told to."""

    def __init__(self) -> None:
        self.t_ns = 1000 * SECOND_NS

    def now_ns(self) -> int:
        return self.t_ns

    async def sleep(self, duration_ns: int) -> None:
        self.t_ns += max(0, duration_ns)
        await super().sleep(0)


class FineSteppedClock(SteppedClock):
    """Wakes sleepers every 6 ms, so that something can happen between two decisions."""

    async def sleep(self, duration_ns: int) -> None:
        await super().sleep(min(duration_ns, 6 * MS))


class EchoEstimator:
    """Turns every event into an estimate of the same time; remembers its thread."""

    thread = ""
    error: Exception | None = None

    def handle(self, event: SensorEvent) -> list[PerceptionUpdate]:
        self.thread = threading.current_thread().name
        if self.error is not None:
            raise self.error
        if isinstance(event, LidarScan):
            return [
                RegisteredScan(
                    t_ns=event.t_ns,
                    sequence=event.sequence,
                    points_map=np.zeros((0, 3), np.float32),
                    reflectivity=np.zeros(0, np.uint8),
                    odometry=an_odometry(event.t_ns),
                    ages_ns=np.zeros(0, np.int32),
                )
            ]
        return [an_odometry(event.t_ns, status=OdometryStatus.INITIALISING)]


class InControl(Pipeline):
    """Is in control from the start until a while after it has been told to stop."""

    braking_ns: float = 0.0
    stop_ns: int | None = None
    last_ns = 0

    @property
    def state(self) -> FlightState:
        stopped = self.stop_ns is not None and self.last_ns - self.stop_ns >= self.braking_ns
        return FlightState.LISTENING if stopped else FlightState.ACTIVE

    def decide(self, event: ControlEvent) -> list[Output]:
        self.last_ns = max(self.last_ns, event.t_ns)
        return []

    def request_stop(self, t_ns: int) -> None:
        self.stop_ns = t_ns


class RecordingNotifier(Notifier):
    """What the service manager would be told."""

    def __init__(self, story: list[str]) -> None:
        super().__init__(None)
        self._story = story

    def ready(self) -> bool:
        self._story.append("ready")
        return True

    def status(self, text: str) -> bool:
        self._story.append(f"status {text}")
        return True


async def nothing() -> None:
    """Return at once."""


@dataclass
class Bench:
    """A flight whose drivers are played; `story` tells what happened in which order."""

    folder: Path
    monkeypatch: pytest.MonkeyPatch
    clock: SystemClock = field(default_factory=SteppedClock)
    story: list[str] = field(default_factory=list)
    sent: list[MavlinkMessage] = field(default_factory=list)
    pipeline_type: type[Pipeline] = Pipeline
    on_link_start: Callable[[], Awaitable[None]] = nothing
    on_lidar_start: Callable[[], Awaitable[None]] = nothing
    on_send: Callable[[Sequence[MavlinkMessage]], Awaitable[None]] | None = None

    def __post_init__(self) -> None:
        bench = self

        class Link:
            def __init__(
                self, settings: Any, session: Any, clock: Any, on_message: Any, starting: Any
            ) -> None:
                bench.hear = on_message
                bench.poll = starting

            async def start(self, timeout_s: float) -> None:
                bench.story.append("link starts")
                await bench.on_link_start()
                bench.story.append("link runs")

            async def send(self, messages: Sequence[MavlinkMessage]) -> None:
                if bench.on_send is not None:
                    await bench.on_send(messages)
                bench.sent.extend(messages)

            async def stop(self) -> None:
                bench.story.append("link stops")

        class Lidar:
            def __init__(self, settings: Any, clock: Any, on_event: Any, on_raw: Any) -> None:
                bench.sense = on_event

            async def start(self, timeout_s: float) -> None:
                bench.story.append("LiDAR starts")
                await bench.on_lidar_start()
                bench.story.append("LiDAR runs")

            async def stop(self) -> None:
                bench.story.append("LiDAR stops")

            def statistics(self) -> LivoxStatistics:
                return LivoxStatistics(packets=17)

        self.hear: Callable[[MavlinkMessage, int], None]
        self.poll: Callable[[int], list[MavlinkMessage]]
        self.sense: Callable[[SensorEvent], None]
        self.estimator = EchoEstimator()
        self.monkeypatch.setattr(runtime, "Px4Link", Link)
        self.monkeypatch.setattr(runtime, "LivoxDriver", Lidar)
        self.monkeypatch.setattr(runtime, "assemble", self._assemble)
        self.directories = Directories(self.folder / "run", self.folder / "logs", self.folder / "state")
        self.directories.create()
        self.service = Service(self.directories, RecordingNotifier(self.story), None)
        metadata = FlightMetadata(vehicle="uav1", role="leader", mode="flight", configuration=GOOD)
        self.log = FlightLog(self.folder / "flight.mcap", LogSettings(), metadata, threaded=False)

    def _assemble(self, profile: Profile, clock: SystemClock) -> Pipeline:
        return self.pipeline_type(
            estimator=self.estimator,
            tracker=NoTracker(),
            role=HoldRole(),
            safety=SafetySettings(),
            authorisation_sources=profile.authorisation.sources,
        )

    @property
    def control_socket(self) -> Path:
        return self.directories.runtime / SOCKET_NAME

    async def run(self, during: Awaitable[None] | None = None) -> FlightOutcome:
        """Run a flight; once it is ready, `during` happens and then it is told to stop."""

        async def scene() -> None:
            await self.until(lambda: "ready" in self.story)
            if during is not None:
                await during
            self.service.stop.request("enough")

        flight = Flight(loads(GOOD, Profile), clock=self.clock, service=self.service, log=self.log)
        acting = asyncio.create_task(scene())
        try:
            return await asyncio.wait_for(flight.run(), 20.0)
        finally:
            acting.cancel()
            with suppress(asyncio.CancelledError):
                await acting

    async def until(self, condition: Callable[[], bool]) -> None:
        """Let everything else go on until a condition holds."""
        real = SystemClock()
        end_ns = real.now_ns() + 10 * SECOND_NS
        while not condition():
            assert real.now_ns() < end_ns, f"waited in vain; {self.story[-5:]}"
            await real.sleep(MS)

    async def until_more(self, items: Sequence[object], than: int) -> None:
        """Let everything else go on until there are more than so many items."""
        await self.until(lambda: len(items) > than)

    async def pass_time(self, messages: int) -> None:
        """Let everything else go on until so many more messages have been logged."""
        enough = self.log.status().written + messages
        await self.until(lambda: self.log.status().written >= enough)

    def recorded(self, *wanted: channels.Channel) -> list[object]:
        self.log.close()
        return [entry.message for entry in FlightRecording(self.log.path).messages(*wanted)]

    def backlog(self) -> dict[str, float]:
        """Return the last count of what was given up."""
        found = [
            entry
            for entry in self.recorded(channels.STATISTICS)
            if isinstance(entry, Statistics) and entry.source == "runtime"
        ]
        return dict(found[-1].values)
