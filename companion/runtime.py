"""What runs on the vehicle: drivers feed the pipeline, the pipeline feeds the autopilot, all is logged.

Three threads share the work. The LiDAR thread receives packets; the perception thread estimates motion;
the event loop decides and sends. Setpoints are made and sent on the event loop only, one message each,
so whatever stalls it, or kills the process, ends the stream and lets PX4's failsafe act.
"""

import asyncio
import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from companion.assembly import assemble
from companion.clock import SystemClock, seconds_to_ns
from companion.config import Profile
from companion.control_socket import ControlSocket, JsonObject
from companion.decision_schedule import DecisionSchedule
from companion.directories import SOCKET_NAME
from companion.drivers.external_odometry_link import ExternalOdometryLink
from companion.drivers.livox import LivoxDriver
from companion.drivers.px4 import Px4Link
from companion.drivers.px4_session import Px4Session
from companion.exchange import Exchange
from companion.logs.writer import FlightLog
from companion.messages import (
    Authorisation,
    FlightState,
    MavlinkMessage,
    PerceptionUpdate,
    RegisteredScan,
    SensorEvent,
)
from companion.perception_thread import PerceptionThread
from companion.safety.supervisor import COMMANDING
from companion.service import Service

_log = structlog.get_logger(__name__)

_START_TIMEOUT_S = 20.0
_STATISTICS_PERIOD_NS = seconds_to_ns(1.0)
_MAX_STOP_NS = seconds_to_ns(3.0)
# An outgoing message that waited longer than this is dropped: late is worse than never. What has to
# arrive is repeated by the session.
_MAX_OUTBOX_AGE_NS = seconds_to_ns(0.04)
_OUTBOX_SIZE = 256
_PARTS = ("decision", "perception", "sending")


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """How a run of the service ended: the last state, why it ended, and where the log is."""

    state: FlightState
    reason: str
    log: Path


@dataclass(frozen=True, slots=True)
class Backlog:
    """What was given up because the process could not keep pace: sensor events and messages."""

    sensor_events_dropped: int
    messages_dropped: int


@dataclass(frozen=True, slots=True)
class _Outgoing:
    """Messages that wait to be sent: since when, and how many were posted before them."""

    t_ns: int
    first: int
    messages: list[MavlinkMessage]


class Flight:
    """One run of the companion on one vehicle."""

    def __init__(self, profile: Profile, *, clock: SystemClock, service: Service, log: FlightLog) -> None:
        """Build every part; sockets are opened by `run`."""
        self._clock = clock
        self._service = service
        self._flight_log = log
        self._period_ns = round(1e9 / profile.autopilot.setpoint_hz)
        self._schedule: DecisionSchedule | None = None  # while decisions are made
        pipeline = self._pipeline = assemble(profile, clock)
        session = Px4Session(profile.autopilot)
        self._exchange = Exchange(pipeline, session, log)
        self._link = Px4Link(profile.autopilot, session, clock, self._on_mavlink, self._exchange.starting)
        self._perception = PerceptionThread(
            pipeline, self._on_estimates, lambda: service.liveness.move("perception"), self._on_failure
        )
        self._lidar = LivoxDriver(profile.lidar, clock, self._on_sensor_event, self._exchange.record_datagram)
        self._external: ExternalOdometryLink | None = None
        if profile.odometry.source == "external":
            self._external = ExternalOdometryLink(profile.external_odometry, clock, self._on_sensor_event)
        self._control = ControlSocket(service.directories.runtime / SOCKET_NAME, self._on_request)
        self._outbox: asyncio.Queue[_Outgoing] = asyncio.Queue(_OUTBOX_SIZE)
        self._posted = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._dropped = 0
        self._failure: BaseException | None = None

    async def run(self) -> FlightOutcome:
        """Fly until asked to stop.

        Raises:
            StartError: if a driver cannot start; the text names the stage.
        """
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(self._on_loop_error)
        for part in _PARTS:
            self._service.liveness.require(part)
        async with contextlib.AsyncExitStack() as drivers:
            if await self._start_unless_stopped(drivers):
                await self._fly()
        if self._failure is not None:
            raise self._failure
        return FlightOutcome(self._exchange.state, self._service.stop.reason, self._flight_log.path)

    async def _fly(self) -> None:
        tasks = [
            asyncio.create_task(self._decide_forever(), name="decision"),
            asyncio.create_task(self._send_forever(), name="sending"),
            asyncio.create_task(self._service.keep_watchdog(self._clock), name="watchdog"),
        ]
        tasks[-1].add_done_callback(self._on_watchdog_end)
        self._service.ready()
        _log.info("ready")
        stop = asyncio.create_task(self._service.stop.wait(), name="stop")
        try:
            await self._until_stopped_or_failed(stop, tasks)
        finally:
            for task in (*tasks, stop):
                task.cancel()
            await asyncio.gather(*tasks, stop, return_exceptions=True)

    async def _start_unless_stopped(self, drivers: contextlib.AsyncExitStack) -> bool:
        """Start all drivers; returns False when told to stop meanwhile, at once."""
        start = asyncio.create_task(self._start(drivers), name="start")
        stop = asyncio.create_task(self._service.stop.wait(), name="stop")
        await asyncio.wait([start, stop], return_when=asyncio.FIRST_COMPLETED)
        stopped = not start.done()
        for task in (start, stop):
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await start
        return not stopped

    async def _start(self, drivers: contextlib.AsyncExitStack) -> None:
        self._perception.start()
        drivers.callback(self._perception.stop)
        await self._control.start()
        drivers.push_async_callback(self._control.close)
        self._service.status("starting: autopilot")
        drivers.push_async_callback(self._link.stop)
        await self._link.start(_START_TIMEOUT_S)
        if self._external is not None:
            drivers.push_async_callback(self._external.stop)
            await self._external.start()
        self._service.status("starting: LiDAR")
        drivers.push_async_callback(self._lidar.stop)
        await self._lidar.start(_START_TIMEOUT_S)

    async def _until_stopped_or_failed(
        self, stop: asyncio.Task[str], tasks: Sequence[asyncio.Task[None]]
    ) -> None:
        """Wait for the end; in the air, brake first so that PX4's failsafe takes over a vehicle at rest."""
        working = [task for task in tasks if task.get_name() != "watchdog"]
        await asyncio.wait([stop, *working], return_when=asyncio.FIRST_COMPLETED)
        for task in working:
            if task.done():
                task.result()  # a decision or sending task ends only by failing: let it be seen
        self._exchange.request_stop(self._clock.now_ns())
        deadline_ns = self._clock.now_ns() + _MAX_STOP_NS
        while self._exchange.state in COMMANDING and self._clock.now_ns() < deadline_ns:
            await self._clock.sleep(self._period_ns)

    async def _decide_forever(self) -> None:
        next_statistics_ns = self._clock.now_ns()
        schedule = self._schedule = DecisionSchedule(self._period_ns, next_statistics_ns)
        try:
            while True:
                now_ns = self._clock.now_ns()
                if schedule.due(now_ns):
                    self._post(now_ns, self._exchange.tick(now_ns))
                    schedule.decided(self._clock.now_ns())
                self._service.liveness.move("decision")
                if now_ns >= next_statistics_ns:
                    next_statistics_ns = now_ns + _STATISTICS_PERIOD_NS
                    self._record_statistics(now_ns)
                await self._clock.sleep_until(schedule.next_ns)
        finally:
            self._schedule = None

    async def _send_forever(self) -> None:
        while True:
            outgoing = await self._outbox.get()
            now_ns = self._clock.now_ns()
            if now_ns - outgoing.t_ns > _MAX_OUTBOX_AGE_NS:
                self._give_up(outgoing, now_ns)
                continue
            await self._link.send(outgoing.messages)
            self._exchange.record_sent(outgoing.messages, self._clock.now_ns())
            self._service.liveness.move("sending")

    def _post(self, t_ns: int, messages: list[MavlinkMessage]) -> None:
        if not messages:
            return
        if self._outbox.full():
            self._give_up(self._outbox.get_nowait(), t_ns)
        self._outbox.put_nowait(_Outgoing(t_ns, self._posted, messages))
        self._posted += len(messages)

    def _give_up(self, outgoing: _Outgoing, t_ns: int) -> None:
        self._dropped += len(outgoing.messages)
        self._exchange.record_unsent(outgoing.first, len(outgoing.messages), t_ns)

    def _on_mavlink(self, message: MavlinkMessage, t_ns: int) -> None:
        self._post(t_ns, self._exchange.receive(message, t_ns))

    def _on_sensor_event(self, event: SensorEvent) -> None:
        self._exchange.record_sensor_event(event)
        self._perception.submit(event, self._exchange.record_place)

    def _on_failure(self, error: Exception) -> None:
        """End the flight because a thread has failed."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has closed already
                self._loop.call_soon_threadsafe(self._fail, error)

    def _on_loop_error(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """End the flight because a callback has failed: going on without it would be going on blind."""
        error = context.get("exception")
        if error is None:
            loop.default_exception_handler(context)
        else:
            self._fail(error)

    def _on_watchdog_end(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._fail(error)

    def _fail(self, error: BaseException) -> None:
        if self._failure is None:
            self._failure = error
            _log.error("internal error, the flight ends", error=repr(error))
            self._service.stop.request("internal error")

    def _on_estimates(self, updates: Sequence[PerceptionUpdate]) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has closed: nobody flies any more
                self._loop.call_soon_threadsafe(self._take_estimates, updates)

    def _take_estimates(self, updates: Sequence[PerceptionUpdate]) -> None:
        now_ns = self._clock.now_ns()
        for update in updates:
            self._post(now_ns, self._exchange.update(update, now_ns))
        if self._schedule is not None and any(isinstance(update, RegisteredScan) for update in updates):
            self._post(now_ns, self._exchange.tick(now_ns))
            self._schedule.seen(now_ns)

    def _on_request(self, request: JsonObject) -> JsonObject:
        """Answer an operator on this computer."""
        now_ns = self._clock.now_ns()
        verb = request["verb"]
        if verb in ("engage", "release"):
            authorisation = Authorisation(now_ns, granted=verb == "engage", source="command")
            refusal = self._exchange.refusal(authorisation)
            self._post(now_ns, self._exchange.authorise(authorisation))
            if refusal:
                return {"ok": False, "error": refusal}
        return {"ok": True, "state": self._exchange.state.value}

    def _record_statistics(self, t_ns: int) -> None:
        state = self._exchange.state
        self._service.status(state.value)
        self._exchange.record_counters("lidar", self._lidar.statistics(), t_ns)
        if self._external is not None:
            self._exchange.record_counters("external_odometry", self._external.statistics(), t_ns)
        self._exchange.record_link(t_ns)
        if self._pipeline.role_counters is not None:
            self._exchange.record_counters("policy", self._pipeline.role_counters, t_ns)
        self._exchange.record_counters("runtime", Backlog(self._perception.dropped, self._dropped), t_ns)
        self._flight_log.record(self._flight_log.status().statistics(t_ns), t_ns)


async def fly(profile: Profile, *, clock: SystemClock, service: Service, log: FlightLog) -> FlightOutcome:
    """Run the companion until a stop is requested.

    Raises:
        StartError: if a driver cannot start.
    """
    with service.signals():
        return await Flight(profile, clock=clock, service=service, log=log).run()
