"""From sensor events to an approved velocity setpoint: one pure core for flight and emulation.

Events carry their own time; nothing here reads a clock, a socket or a file. `perceive` is the heavy
half (odometry) and may run in a worker thread; `decide` is the light half and runs where setpoints are
sent. `handle` does both, for callers without threads.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from companion.clock import seconds_to_ns
from companion.messages import (
    Authorisation,
    ControlEvent,
    ExternalOdometry,
    FlightState,
    ImuSample,
    LidarScan,
    ModeRequest,
    NeighbourTracks,
    Odometry,
    OdometryStatus,
    Output,
    PerceptionUpdate,
    PlanUpdate,
    RegisteredScan,
    SensorEvent,
    Setpoint,
    Severity,
    StateChange,
    StatusText,
    Surroundings,
    Tick,
    VehicleMode,
    VehicleState,
    VelocityCommand,
)
from companion.safety.checks import Checks, Facts
from companion.safety.limits import VelocityLimiter
from companion.safety.pose_gate import PoseGate
from companion.safety.settings import SafetySettings
from companion.safety.supervisor import COMMANDING, Supervisor

_STREAM_BEFORE_ENGAGE_NS = seconds_to_ns(0.5)
_REPEAT_REQUEST_NS = seconds_to_ns(1.0)
_BRAKE_BEFORE_STOP_NS = seconds_to_ns(1.0)
_STALL_NS = seconds_to_ns(0.5)
_GRANT_LIFETIME_NS = seconds_to_ns(0.5)

_SEVERITY = {
    FlightState.LOST: Severity.CRITICAL,
    FlightState.HOLDING: Severity.WARNING,
    FlightState.PILOT: Severity.NOTICE,
    FlightState.LISTENING: Severity.WARNING,
}


class Estimator(Protocol):
    """Own motion from sensor events."""

    def handle(self, event: SensorEvent) -> Sequence[PerceptionUpdate]:
        """Take one event in; return the estimates that became known."""
        ...


class Tracker(Protocol):
    """Other UAVs from registered scans."""

    def observe(self, scan: RegisteredScan) -> NeighbourTracks:
        """Take one scan in; return all tracks at its end."""
        ...


class RoleDecision(Protocol):
    """What a role answers to `Role.decide`."""

    @property
    def command(self) -> VelocityCommand:
        """The velocity it wants."""
        ...

    @property
    def plan(self) -> PlanUpdate | None:
        """Its path, when it changed."""
        ...

    @property
    def finished(self) -> bool:
        """Nothing is left to do but to land."""
        ...

    @property
    def remarks(self) -> Sequence[StatusText | Surroundings]:
        """What it has to tell."""
        ...


class Role(Protocol):
    """What the vehicle should do: leader or follower."""

    @property
    def counters(self) -> object | None:
        """Counters for the log, fields of a slotted dataclass; None if it counts nothing."""
        ...

    def meet(self, tracks: NeighbourTracks) -> None:
        """Learn where the others are; the scan that shows them follows."""
        ...

    def observe(self, scan: RegisteredScan) -> None:
        """See the surroundings."""
        ...

    def decide(self, odometry: Odometry, t_ns: int) -> RoleDecision:
        """Choose a velocity at host time `t_ns`."""
        ...

    def reset(self, odometry: Odometry) -> None:
        """Begin anew from the present pose: control has just been taken."""
        ...


class Pipeline:
    """Everything between the drivers."""

    def __init__(
        self,
        *,
        estimator: Estimator,
        tracker: Tracker,
        role: Role,
        safety: SafetySettings,
        authorisation_sources: Sequence[str],
    ) -> None:
        """Join the parts of one vehicle; `authorisation_sources` are those the profile permits."""
        self._estimator = estimator
        self._tracker = tracker
        self._role = role
        self._safety = safety
        self._sources = frozenset(authorisation_sources)
        self._supervisor = Supervisor()
        self._checks = Checks(safety)
        self._limiter = VelocityLimiter(safety)
        self._pose_gate = PoseGate(safety)
        self._odometry: Odometry | None = None
        self._vehicle: VehicleState | None = None
        self._t_scan_ns = 0
        self._grant: Authorisation | None = None
        self._revoked = False
        self._finished = False
        self._entered_ns = 0
        self._requested_ns = 0
        self._mode_at_engaging = VehicleMode.UNKNOWN
        self._switch_armed = False
        self._stop_ns: int | None = None
        self._ticked_ns: int | None = None

    @property
    def state(self) -> FlightState:
        """The supervisor's present state."""
        return self._supervisor.state

    @property
    def role_counters(self) -> object | None:
        """What the role counts, None if nothing."""
        return self._role.counters

    def handle(self, event: SensorEvent | ControlEvent) -> list[Output]:
        """Process one event completely; return what should happen, in order."""
        if isinstance(event, (ImuSample, LidarScan, ExternalOdometry)):
            outputs: list[Output] = []
            for update in self.perceive(event):
                outputs.extend(self.decide(update))
            return outputs
        return self.decide(event)

    def perceive(self, event: SensorEvent) -> Sequence[PerceptionUpdate]:
        """Heavy half: estimate own motion, follow the others. Never call it from two threads at once."""
        updates: list[PerceptionUpdate] = []
        for update in self._estimator.handle(event):
            if isinstance(update, RegisteredScan):
                updates.append(self._tracker.observe(update))
            updates.append(update)
        return updates

    def decide(self, event: ControlEvent) -> list[Output]:
        """Light half: keep the newest of everything; on a tick, choose and approve a setpoint."""
        match event:
            case Odometry():
                admitted = self._odometry = self._pose_gate.admit(event, self._vehicle)
                usable = admitted.status in (OdometryStatus.TRACKING, OdometryStatus.DEGRADED)
                return [admitted] if usable else []
            case NeighbourTracks():
                if not self._pose_gate.withholds:
                    self._role.meet(event)
                return []
            case RegisteredScan():
                if not self._pose_gate.withholds:
                    self._t_scan_ns = event.t_ns
                    self._role.observe(replace(event, odometry=self._pose_gate.counted(event.odometry)))
                return []
            case VehicleState():
                self._vehicle = event
                return []
            case Authorisation():
                return self._authorise(event)
            case Tick():
                return self._tick(event.t_ns)

    def request_stop(self, t_ns: int) -> None:
        """End the flight from outside: brake for a second if in control, then fall silent for good."""
        if self._stop_ns is None:
            self._stop_ns = t_ns

    def refusal(self, event: Authorisation) -> str:
        """Return why an authorisation would not be followed now, or an empty string."""
        if not event.granted:
            return ""
        if event.source not in self._sources:
            return f"{event.source} not permitted"
        return self._supervisor.refusal(self._facts(event.t_ns, authorised=True))

    def _authorise(self, event: Authorisation) -> list[Output]:
        if not event.granted:
            self._revoked = True
            self._grant = None
            return []
        refusal = self.refusal(event)
        if refusal:
            return [_text(event.t_ns, Severity.WARNING, f"engage refused: {refusal}")]
        self._grant = event
        return []

    def _facts(self, t_ns: int, *, authorised: bool) -> Facts:
        mode = self._vehicle.mode if self._vehicle is not None else VehicleMode.UNKNOWN
        engaging = self.state is FlightState.ENGAGING
        in_state_ns = t_ns - self._entered_ns
        return self._checks.facts(
            self._odometry,
            self._vehicle,
            self._t_scan_ns,
            t_ns,
            authorised=authorised,
            revoked=self._revoked,
            finished=self._finished,
            engage_timed_out=engaging and in_state_ns > seconds_to_ns(self._safety.engage_timeout_s),
            mode_left=engaging and mode not in (VehicleMode.OFFBOARD, self._mode_at_engaging),
            stopping=self._stop_ns is not None and t_ns - self._stop_ns >= _BRAKE_BEFORE_STOP_NS,
            stalled=self._ticked_ns is not None and t_ns - self._ticked_ns > _STALL_NS,
        )

    def _tick(self, t_ns: int) -> list[Output]:
        self._checks.observe(self._odometry, self._vehicle, self._t_scan_ns, t_ns)
        # A permission is for now: one that waited, in a queue or through a stall, is none.
        fresh = self._grant is not None and t_ns - self._grant.t_ns <= _GRANT_LIFETIME_NS
        facts = self._facts(t_ns, authorised=False)
        granted = (fresh or self._switched(facts)) and not facts.stalled
        if granted:
            facts = replace(facts, authorised=True)
        self._ticked_ns = t_ns
        outputs = self._step(facts, t_ns)
        self._grant = None
        self._revoked = False
        outputs.extend(self._mode_requests(facts, t_ns))
        if self._streams() and self._odometry is not None:
            outputs.extend(self._setpoint(self._odometry, facts, t_ns))
        return outputs

    def _switched(self, facts: Facts) -> bool:
        """Whether the pilot has just selected OFFBOARD: the change counts, not the mode."""
        if self.state is not FlightState.READY or "mode_switch" not in self._sources:
            self._switch_armed = False
            return False
        if facts.mode is not VehicleMode.OFFBOARD:
            self._switch_armed = facts.mode is not VehicleMode.UNKNOWN
            return False
        return self._switch_armed

    def _step(self, facts: Facts, t_ns: int) -> list[Output]:
        previous = self.state
        transition = self._supervisor.step(facts)
        if transition is None:
            return []
        self._entered_ns = t_ns
        self._requested_ns = 0
        current = self.state
        if current is FlightState.ENGAGING and self._odometry is not None:
            self._mode_at_engaging = facts.mode
            self._finished = False
            self._role.reset(self._odometry)
            self._limiter.restart(np.zeros(3))
        reason = transition.reason.format(problem=facts.problem)
        change = StateChange(t_ns, previous, current, reason)
        text = _text(t_ns, _SEVERITY.get(current, Severity.INFO), f"{current.value}: {reason}")
        return [change, text]

    def _streams(self) -> bool:
        in_offboard = self._vehicle is not None and self._vehicle.mode is VehicleMode.OFFBOARD
        match self.state:
            case FlightState.READY:
                return "mode_switch" in self._sources
            case FlightState.LANDING:
                return in_offboard
            case state:
                return state in COMMANDING

    def _mode_requests(self, facts: Facts, t_ns: int) -> list[Output]:
        wanted: VehicleMode | None = None
        if self.state is FlightState.ENGAGING and t_ns - self._entered_ns >= _STREAM_BEFORE_ENGAGE_NS:
            wanted = VehicleMode.OFFBOARD
        elif self.state is FlightState.LANDING and facts.mode is VehicleMode.OFFBOARD:
            wanted = VehicleMode.LAND
        if wanted is None or facts.mode is wanted or t_ns - self._requested_ns < _REPEAT_REQUEST_NS:
            return []
        self._requested_ns = t_ns
        return [ModeRequest(t_ns, wanted)]

    def _setpoint(self, odometry: Odometry, facts: Facts, t_ns: int) -> list[Output]:
        outputs: list[Output] = []
        v_wanted_map, yaw_rate, reason = np.zeros(3), 0.0, f"hold: {self.state.value}"
        if self.state is FlightState.ACTIVE and facts.odometry_usable and self._stop_ns is None:
            decision = self._decision(odometry, t_ns, outputs)
            if decision is not None:
                v_wanted_map, yaw_rate = decision.command.v_map, decision.command.yaw_rate
                reason = "role"
                if decision.plan is not None:
                    outputs.append(decision.plan)
                outputs.extend(decision.remarks)
                self._finished = self._finished or decision.finished
        v_map = self._limiter.limit(v_wanted_map, float(odometry.p_map[2]), t_ns)
        # Braking rests on the decision to brake, not on old sensor data: its data are as new as the tick.
        t_data_ns = odometry.t_ns if reason == "role" else t_ns
        outputs.append(
            Setpoint(
                t_ns=t_ns,
                t_data_ns=t_data_ns,
                t_scan_ns=self._t_scan_ns,
                v_map=v_map,
                yaw_rate=self._limiter.limit_yaw_rate(yaw_rate),
                reason=reason,
            )
        )
        return outputs

    def _decision(self, odometry: Odometry, t_ns: int, outputs: list[Output]) -> RoleDecision | None:
        """Ask the role; one that breaks has flown for the last time, and the vehicle brakes."""
        try:
            return self._role.decide(odometry, t_ns)
        except Exception as error:
            self.request_stop(t_ns)
            outputs.append(_text(t_ns, Severity.CRITICAL, f"role failed: {error!r}"))
            return None


def _text(t_ns: int, severity: Severity, text: str) -> StatusText:
    return StatusText(t_ns, severity, text)
