"""Carries messages between a PX4 autopilot and the session, by MAVSDK's MavlinkDirect.

Choices, each against a measured habit of MAVSDK 4.1:

* Its Offboard plugin repeats the last setpoint from C++ for as long as the process lives. Here nothing
  repeats: one `send` is one message, so a stalled event loop ends the stream and PX4's failsafe acts.
* The *server* side of MavlinkDirect is used. It sends as our own component, needs no discovered system
  and hears every system on the link, so the configured autopilot is chosen here, not by who speaks first,
  and a ground station's commands arrive.
* MAVSDK sends heartbeats of its own for our component, always in state UNINIT. They are stopped on
  their way out; those of the session, with the true state, pass.
* Its asyncio layer puts every subscription into a queue without bound and every call into the default
  executor. Here a bounded queue takes what arrives, and the few blocking calls have their own thread.
  Sending does not block: MAVSDK encodes the message and its own thread writes it.
"""

import asyncio
import ctypes
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mavsdk
import structlog
from mavsdk.cmavsdk_loader import _cmavsdk_lib
from mavsdk.plugins import mavlink_direct_server as direct

from companion.clock import Clock, seconds_to_ns
from companion.drivers.mavlink_json import fields_from_json, fields_to_json
from companion.drivers.px4_session import Px4Session
from companion.drivers.px4_settings import Px4Settings
from companion.errors import ProtocolError, StartError
from companion.messages import FlightState, MavlinkMessage

_log = structlog.get_logger(__name__)

OnMessage = Callable[[MavlinkMessage, int], None]
Starting = Callable[[int], list[MavlinkMessage]]

# Everything the session uses; the rest is never turned into Python objects.
_RECEIVED = (
    "HEARTBEAT",
    "CURRENT_MODE",
    "LOCAL_POSITION_NED",
    "ATTITUDE_QUATERNION",
    "ODOMETRY",
    "EXTENDED_SYS_STATE",
    "ESTIMATOR_STATUS",
    "SYS_STATUS",
    "BATTERY_STATUS",
    "STATUSTEXT",
    "TIMESYNC",
    "COMMAND_ACK",
    "COMMAND_LONG",
    "COMMAND_INT",
    "PARAM_VALUE",
)
# Two seconds of telemetry: whatever waits longer is of no use to anybody.
_INBOX_SIZE = 512
_START_POLL_S = 0.05
_LOG_METHODS = {0: "debug", 1: "info", 2: "warning", 3: "error"}
_UNINITIALISED = b'"system_status":0'


class _OutgoingMessage(ctypes.Structure):
    """`mavsdk_message_t` of MAVSDK's C interface."""

    _fields_ = [
        ("message_name", ctypes.c_char_p),
        ("system_id", ctypes.c_uint32),
        ("component_id", ctypes.c_uint32),
        ("target_system_id", ctypes.c_uint32),
        ("target_component_id", ctypes.c_uint32),
        ("fields_json", ctypes.c_char_p),
    ]


_OutgoingCallback = ctypes.CFUNCTYPE(ctypes.c_int, _OutgoingMessage, ctypes.c_void_p)


def _pass_outgoing(message: Any, _: object) -> int:
    """Let every message pass but MAVSDK's own heartbeats; runs on MAVSDK's thread."""
    return 0 if message.message_name == b"HEARTBEAT" and _UNINITIALISED in message.fields_json else 1


class _HeartbeatFilter:
    """Keeps MAVSDK's own heartbeats from the wire, by the C interface that its Python part leaves out."""

    def __init__(self, carrier: Any) -> None:
        library = _cmavsdk_lib
        subscribe = library.mavsdk_subscribe_outgoing_messages_json
        subscribe.argtypes = [ctypes.c_void_p, _OutgoingCallback, ctypes.c_void_p]
        subscribe.restype = ctypes.c_void_p
        self._unsubscribe = library.mavsdk_unsubscribe_outgoing_messages_json
        self._unsubscribe.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        self._unsubscribe.restype = None
        self._carrier = carrier
        self._callback = _OutgoingCallback(_pass_outgoing)
        self._handle: int | None = subscribe(carrier._handle, self._callback, None)

    def remove(self) -> None:
        if self._handle is not None and self._carrier._handle:
            self._unsubscribe(self._carrier._handle, self._handle)
        self._handle = None


def _log_mavsdk(level: int, message: str, file: str | None, line: int) -> bool:
    method = _LOG_METHODS.get(int(level), "info")
    getattr(_log, method)("mavsdk", text=message.strip()[:300])
    return True


class Px4Link:
    """The link to one autopilot; lives on one event loop."""

    def __init__(
        self,
        settings: Px4Settings,
        session: Px4Session,
        clock: Clock,
        on_message: OnMessage,
        starting: Starting | None = None,
    ) -> None:
        """Prepare; nothing is opened before `start`.

        Args:
            settings: link and identities.
            session: tells whether the configured autopilot has been heard. It is fed by `on_message`.
            clock: stamps what arrives.
            on_message: called on the event loop with every message and its host time of arrival. It
                hands the message to the session.
            starting: asked for what to send while nobody has been heard; the session itself by default.
        """
        self._settings = settings
        self._session = session
        self._clock = clock
        self._on_message = on_message
        self._starting = starting or (lambda t_ns: session.poll(t_ns, FlightState.STARTING))
        self._executor: ThreadPoolExecutor | None = None
        self._carrier: Any = None
        self._plugin: Any = None
        self._filter: _HeartbeatFilter | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._inbox: deque[tuple[Any, int]] = deque(maxlen=_INBOX_SIZE)
        self._drain_scheduled = False
        self._heard = asyncio.Event()
        self.dropped = 0
        """Messages that arrived while the event loop did not take any."""
        self.malformed = 0
        """Messages that MAVSDK handed over in an unreadable form."""
        self.unsent = 0
        """Messages that MAVSDK refused to send."""

    async def start(self, timeout_s: float) -> None:
        """Open the link and wait for the configured autopilot's first heartbeat.

        Args:
            timeout_s: how long to wait for it, in seconds.

        Raises:
            StartError: if the link cannot be opened, or nobody or only a foreign autopilot is heard.
        """
        self._loop = asyncio.get_running_loop()
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="mavsdk")
        try:
            await self._loop.run_in_executor(self._executor, self._open)
            await self._wait_for_autopilot(timeout_s)
        except BaseException:
            await self.stop()
            raise
        _log.info("autopilot found", system_id=self._settings.system_id, url=self._settings.url)

    async def send(self, messages: Sequence[MavlinkMessage]) -> None:
        """Send messages now, each once; those that cannot be sent are counted.

        Takes about 0.1 ms a message and does not wait for the wire.
        """
        plugin = self._plugin
        for message in messages:
            target_system = message.fields.get("target_system", 0)
            target_component = message.fields.get("target_component", 0)
            try:
                plugin.send_message(
                    direct.MavlinkMessage(
                        message.name,
                        message.system_id,
                        message.component_id,
                        target_system,
                        target_component,
                        fields_to_json(message.fields),
                    )
                )
            except (
                direct.MavlinkDirectServerError,
                AttributeError,
                RuntimeError,
                TypeError,
                ValueError,
            ) as e:
                self.unsent += 1
                if self.unsent == 1:
                    _log.error("a message was not sent", name=message.name, error=str(e))

    async def stop(self) -> None:
        """Close the link; may be called again."""
        executor, self._executor = self._executor, None
        if executor is None:
            return
        await asyncio.get_running_loop().run_in_executor(executor, self._close)
        executor.shutdown(wait=False)
        self._loop = None
        self._inbox.clear()

    def _open(self) -> None:
        """Build MAVSDK's objects and open the connection; blocks."""
        mavsdk.log_subscribe(_log_mavsdk)
        configuration = mavsdk.Configuration.create_with_component_type(
            mavsdk.ComponentType.COMPANION_COMPUTER
        )
        configuration.system_id = self._settings.system_id
        configuration.component_id = self._settings.component_id
        self._carrier = mavsdk.Mavsdk(configuration)
        try:
            self._filter = _HeartbeatFilter(self._carrier)
        except AttributeError:
            # The vehicle flies all the same; ground stations see our state flicker.
            _log.warning("this MAVSDK cannot be kept from sending heartbeats of its own")
        self._plugin = direct.MavlinkDirectServer(self._carrier.server_component(0))
        for name in _RECEIVED:
            self._plugin.subscribe_message(name, self._arrived)
        result = self._carrier.add_any_connection(self._settings.url)
        if result != mavsdk.ConnectionResult.SUCCESS:
            raise StartError(f"autopilot: cannot open {self._settings.url}: {result.name.lower()}")

    def _close(self) -> None:
        """Take MAVSDK's objects down in the reverse order; blocks."""
        if self._filter is not None:
            self._filter.remove()
        if self._plugin is not None:
            self._plugin.destroy()
        if self._carrier is not None:
            self._carrier.destroy()
        self._filter = self._plugin = self._carrier = None

    async def _wait_for_autopilot(self, timeout_s: float) -> None:
        deadline_ns = self._clock.now_ns() + seconds_to_ns(timeout_s)
        while not self._session.vehicle_state(self._clock.now_ns()).connected:
            now_ns = self._clock.now_ns()
            if now_ns >= deadline_ns:
                raise StartError(self._nobody())
            # On a serial line PX4 speaks only to those who speak.
            await self.send(self._starting(now_ns))
            self._heard.clear()
            try:
                await asyncio.wait_for(self._heard.wait(), _START_POLL_S)
            except asyncio.TimeoutError:
                continue

    def _nobody(self) -> str:
        wanted, url = self._settings.system_id, self._settings.url
        foreign = self._session.foreign_autopilots()
        if self._session.statistics(self._clock.now_ns()).received.get("HEARTBEAT"):
            return f"autopilot: system id {wanted} answers on {url}, but it is not a PX4"
        if not foreign:
            return f"autopilot: system id {wanted} is silent on {url}"
        heard = ", ".join(str(system_id) for system_id in foreign)
        return f"autopilot: system id {wanted} is silent on {url}, where only system id {heard} is heard"

    def _arrived(self, message: Any, _: object) -> None:
        """Take one message on MAVSDK's thread."""
        if len(self._inbox) == _INBOX_SIZE:
            self.dropped += 1
        self._inbox.append((message, self._clock.now_ns()))
        loop = self._loop
        if self._drain_scheduled or loop is None:
            return
        self._drain_scheduled = True
        try:
            loop.call_soon_threadsafe(self._drain)
        except RuntimeError:  # the loop has closed: nobody listens any more
            self._drain_scheduled = False

    def _drain(self) -> None:
        """Hand over all that has arrived, in order, on the event loop."""
        self._drain_scheduled = False
        while self._inbox and self._loop is not None:
            raw, t_ns = self._inbox.popleft()
            own = (
                raw.system_id == self._settings.system_id and raw.component_id == self._settings.component_id
            )
            if own:
                continue
            try:
                fields = fields_from_json(raw.fields_json)
            except ProtocolError:
                self.malformed += 1
                continue
            self._on_message(MavlinkMessage(raw.message_name, raw.system_id, raw.component_id, fields), t_ns)
        self._heard.set()
