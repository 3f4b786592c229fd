"""The person with the ground station and the transmitter: a scripted peer that speaks MAVLink bytes."""

import struct
from dataclasses import dataclass
from enum import Enum
from typing import Any

from pydantic import Field

from companion.clock import seconds_to_ns
from companion.messages import LandedState, VehicleMode
from companion.settings import Settings
from sitl.autopilot_filter import seconds_between
from sitl.mavlink_commands import ARM, DO_SET_MODE
from sitl.mavlink_frames import Frame, FrameCutter, FrameEncoder
from sitl.mavlink_modes import custom_mode, landed_code, mode_of
from sitl.operator_script import (
    Arm,
    Authorise,
    HoldSticks,
    Look,
    OperatorView,
    SelectMode,
    SetParameter,
    Step,
)

_HEARTBEAT_PERIOD_NS = seconds_to_ns(1.0)
_STICK_PERIOD_NS = seconds_to_ns(0.05)
_RETRY_PERIOD_NS = seconds_to_ns(0.5)
_REFUSALS_MAX = 10
_ACCEPTED = 0
_AUTHORISE_COMMAND = 31010
_AUTOPILOT_COMPONENT = 1
_TEXTS_MAX = 64
_LANDED = {landed_code(state): state for state in LandedState}


class OperatorSettings(Settings):
    """Identities on the ground station's link."""

    system_id: int = Field(255, ge=1, le=255)
    """The ground station's own system."""
    component_id: int = Field(190, ge=1, le=255)
    """Its component."""
    vehicle_system_id: int = Field(1, ge=1, le=255)
    """The vehicle it attends to."""
    companion_component_id: int = Field(191, ge=1, le=255)
    """The companion on that vehicle."""


class ScriptStatus(Enum):
    """Progress of the script."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class LogLine:
    """One thing the operator did or met."""

    t_ns: int
    text: str


class Operator:
    """Runs a script of steps against what the ground station's link shows.

    Attributes:
        view: what is known.
        status: progress; FAILED stops the script, while heartbeats and held sticks go on.
        reason: why it failed, or the present step's name.
        log: what was done, oldest first.
    """

    def __init__(self, script: list[Step], settings: OperatorSettings | None = None) -> None:
        """Begin with the first step at the first poll."""
        self._settings = settings or OperatorSettings()
        self._script = list(script)
        self.view = OperatorView()
        self.status = ScriptStatus.RUNNING if script else ScriptStatus.DONE
        self.reason = script[0].name if script else ""
        self.log: list[LogLine] = []
        self._index = 0
        self._cutter = FrameCutter()
        self._encoders: dict[str, FrameEncoder] = {}
        self._sequence = 0
        self._sticks: HoldSticks | None = None
        self._next_heartbeat_ns: int | None = None
        self._next_sticks_ns = 0
        self._t_step_ns: int | None = None
        self._t_acting_ns: int | None = None
        self._next_try_ns = 0
        self._refusals = 0
        self._acknowledged: int | None = None
        self._echoed: tuple[str, bytes] | None = None

    def follow(self, script: list[Step]) -> None:
        """Drop the present script, finished or not, and begin another one."""
        self._script = list(script)
        self._index = 0
        self._t_step_ns = self._t_acting_ns = None
        self.status = ScriptStatus.RUNNING if script else ScriptStatus.DONE
        self.reason = script[0].name if script else ""

    def receive(self, data: bytes, t_ns: int) -> None:
        """Take bytes from the link; what is not understood is skipped."""
        for frame in self._cutter.feed(data):
            if frame.system_id == self._settings.vehicle_system_id:
                self._look(frame, t_ns)

    def poll(self, t_ns: int) -> list[bytes]:
        """Return the frames to send at `t_ns`."""
        frames: list[bytes] = []
        if self._next_heartbeat_ns is None or t_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = t_ns + _HEARTBEAT_PERIOD_NS
            frames.append(self._frame("HEARTBEAT", (6, 8, 0, 0, 4, 3)))
        if self._sticks is not None and t_ns >= self._next_sticks_ns:
            self._next_sticks_ns = t_ns + _STICK_PERIOD_NS
            frames.append(self._frame("MANUAL_CONTROL", self._stick_fields(self._sticks)))
        while self.status is ScriptStatus.RUNNING:
            step = self._script[self._index]
            if self._t_step_ns is None:
                self._t_step_ns = t_ns
            if self._t_acting_ns is None:
                elapsed_s = seconds_between(self._t_step_ns, t_ns)
                if not step.when(self.view, elapsed_s):
                    if elapsed_s > step.timeout_s:
                        self._fail(t_ns, f"{step.name}: waited {step.timeout_s:g} s in vain")
                    break
                self._begin(t_ns, step)
            if not self._act(t_ns, step, frames):
                break
        return frames

    def _begin(self, t_ns: int, step: Step) -> None:
        self._t_acting_ns = t_ns
        self._next_try_ns = t_ns
        self._refusals = 0
        self._acknowledged = None
        self._echoed = None
        self._note(t_ns, step.name)

    def _act(self, t_ns: int, step: Step, frames: list[bytes]) -> bool:
        """Pursue the step's action; return whether the step is finished."""
        action = step.do
        if isinstance(action, HoldSticks):
            self._sticks = action if action.held else None
        if isinstance(action, Look | HoldSticks) or self._is_done(action):
            self._next_step(t_ns)
            return True
        if self._acknowledged not in (None, _ACCEPTED):
            self._refusals += 1
            result, self._acknowledged = self._acknowledged, None
            if self._refusals >= _REFUSALS_MAX:
                self._fail(t_ns, f"{step.name}: refused with result {result}")
                return False
        if self._t_acting_ns is not None and seconds_between(self._t_acting_ns, t_ns) > step.timeout_s:
            self._fail(t_ns, f"{step.name}: no answer")
            return False
        if t_ns >= self._next_try_ns:
            self._next_try_ns = t_ns + _RETRY_PERIOD_NS
            frames.append(self._request(action))
        return False

    def _is_done(self, action: SelectMode | Arm | Authorise | SetParameter) -> bool:
        if isinstance(action, SetParameter):
            return self._echoed == (action.name, _wire_value(action.value))
        return self._acknowledged == _ACCEPTED

    def _next_step(self, t_ns: int) -> None:
        self._index += 1
        self._t_step_ns = t_ns
        self._t_acting_ns = None
        if self._index >= len(self._script):
            self.status = ScriptStatus.DONE
            self.reason = ""
        else:
            self.reason = self._script[self._index].name

    def _fail(self, t_ns: int, reason: str) -> None:
        self.status = ScriptStatus.FAILED
        self.reason = reason
        self._note(t_ns, reason)

    def _note(self, t_ns: int, text: str) -> None:
        self.log.append(LogLine(t_ns, text))

    def _request(self, action: SelectMode | Arm | Authorise | SetParameter) -> bytes:
        settings = self._settings
        if isinstance(action, SetParameter):
            kind = 6 if isinstance(action.value, int) else 9
            value = struct.unpack("<f", _wire_value(action.value))[0]
            ids = (settings.vehicle_system_id, _AUTOPILOT_COMPONENT)
            return self._frame("PARAM_SET", (*ids, action.name.encode(), value, kind))
        if isinstance(action, SelectMode):
            code = custom_mode(action.mode)
            return self._command(_AUTOPILOT_COMPONENT, DO_SET_MODE, (1.0, code >> 16 & 0xFF, code >> 24))
        if isinstance(action, Arm):
            return self._command(_AUTOPILOT_COMPONENT, ARM, (float(action.arm), 0.0, 0.0))
        granted = 1.0 if action.granted else 0.0
        return self._command(settings.companion_component_id, _AUTHORISE_COMMAND, (granted, 0.0, 0.0))

    def _command(self, component_id: int, command: int, parameters: tuple[float, float, float]) -> bytes:
        values = (self._settings.vehicle_system_id, component_id, command, 0, *parameters, 0.0, 0.0, 0.0, 0.0)
        return self._frame("COMMAND_LONG", values)

    def _frame(self, name: str, values: tuple[Any, ...]) -> bytes:
        encoder = self._encoders.get(name)
        if encoder is None:
            encoder = self._encoders[name] = FrameEncoder(name)
        ids = (self._settings.system_id, self._settings.component_id)
        frame = encoder.frame(self._sequence, *ids, values)
        self._sequence = (self._sequence + 1) & 0xFF
        return frame

    def _stick_fields(self, sticks: HoldSticks) -> tuple[Any, ...]:
        axes = (
            sticks.pitch * 1000.0,
            sticks.roll * 1000.0,
            (sticks.throttle + 1.0) * 500.0,
            sticks.yaw * 1000.0,
        )
        return (self._settings.vehicle_system_id, *map(round, axes), 0, *(0,) * 10)

    def _look(self, frame: Frame, t_ns: int) -> None:
        message, view = frame.message, self.view
        name = message.get_type()
        if frame.component_id == self._settings.companion_component_id:
            if name == "HEARTBEAT":
                view.companion_state = message.system_status
                view.companion_was_active |= message.system_status == 4
        elif frame.component_id == _AUTOPILOT_COMPONENT:
            self._look_at_autopilot(name, message)
        if name == "COMMAND_ACK" and self._is_mine(message):
            self._acknowledge(message)
        elif name == "STATUSTEXT":
            view.texts = [*view.texts[1 - _TEXTS_MAX :], message.text]
            self._note(t_ns, message.text)

    def _look_at_autopilot(self, name: str, message: Any) -> None:
        view = self.view
        if name == "HEARTBEAT":
            view.connected = True
            view.armed = bool(message.base_mode & 0x80)
            view.failsafe = message.system_status == 5
            main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24
            view.mode = mode_of(main, sub) or VehicleMode.UNKNOWN
        elif name == "ESTIMATOR_STATUS":
            view.estimator_flags = message.flags
        elif name == "LOCAL_POSITION_NED":
            view.height = -message.z
        elif name == "EXTENDED_SYS_STATE":
            view.landed = _LANDED.get(message.landed_state, LandedState.UNKNOWN)
        elif name == "PARAM_VALUE":
            self._echoed = (message.param_id, struct.pack("<f", message.param_value))

    def _is_mine(self, message: Any) -> bool:
        ids = (self._settings.system_id, self._settings.component_id)
        return (message.target_system, message.target_component) in (ids, (0, 0))

    def _acknowledge(self, message: Any) -> None:
        if self._t_acting_ns is None or self.status is not ScriptStatus.RUNNING:
            return
        action = self._script[self._index].do
        wanted = {SelectMode: DO_SET_MODE, Arm: ARM, Authorise: _AUTHORISE_COMMAND}.get(type(action))
        if message.command == wanted:
            self._acknowledged = message.result


def _wire_value(value: int | float) -> bytes:
    return struct.pack("<i", value) if isinstance(value, int) else struct.pack("<f", value)
