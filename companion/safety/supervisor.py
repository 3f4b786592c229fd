"""The state machine that has the last word: who may command the vehicle, and when nobody may.

Rules it keeps, whatever the sensors and the autopilot do:

* it never arms, and asks for OFFBOARD only after an explicit authorisation;
* when the autopilot leaves OFFBOARD, for a pilot or for its own failsafe, the stream ends and only a new
  authorisation brings it back;
* a process that wakes up in the air listens only;
* after a stall it stays silent, because the autopilot may have begun its failsafe;
* without usable odometry it brakes, and soon after it falls silent, so that PX4's own failsafe acts.

`TRANSITIONS` is the whole machine: in each state the first condition that holds wins.
"""

from collections.abc import Callable
from dataclasses import dataclass

from companion.messages import FlightState, VehicleMode
from companion.safety.checks import Facts

Condition = Callable[[Facts], bool]


@dataclass(frozen=True, slots=True)
class Transition:
    """Leave a state for `target` when `condition` holds; `{problem}` in the reason is filled in."""

    condition: Condition
    target: FlightState
    reason: str


def _lost_offboard(facts: Facts) -> bool:
    return facts.link and facts.mode is not VehicleMode.OFFBOARD


def _may_engage(facts: Facts) -> bool:
    flying = facts.armed and facts.airborne and not facts.failsafe
    return facts.authorised and flying and facts.healthy and not facts.map_jumped


_GROUNDED = Transition(lambda f: f.link and f.on_ground, FlightState.STANDBY, "on the ground, disarmed")
_STOPPED = Transition(lambda f: f.stopping, FlightState.LOST, "told to stop")
_STALLED = Transition(lambda f: f.stalled, FlightState.LOST, "stalled in flight")
_REVOKED = Transition(lambda f: f.revoked, FlightState.PILOT, "authorisation withdrawn")
_TAKEOVER_FAILSAFE = Transition(
    lambda f: _lost_offboard(f) and f.failsafe, FlightState.PILOT, "autopilot failsafe"
)
_TAKEOVER_PILOT = Transition(_lost_offboard, FlightState.PILOT, "autopilot left OFFBOARD")
_LINK_LOST = Transition(lambda f: not f.link, FlightState.LOST, "link to the autopilot lost")
_BLIND = Transition(lambda f: f.odometry_lost, FlightState.LOST, "{problem}")
_DISAGREES = Transition(lambda f: not f.estimates_agree, FlightState.LOST, "{problem}")
_ENGAGE = Transition(_may_engage, FlightState.ENGAGING, "authorised")

TRANSITIONS: dict[FlightState, tuple[Transition, ...]] = {
    FlightState.STARTING: (
        Transition(
            lambda f: f.link and f.airborne and f.armed,
            FlightState.LISTENING,
            "in the air before it was ready",
        ),
        Transition(lambda f: f.healthy and f.standing, FlightState.STANDBY, "odometry and autopilot ready"),
    ),
    FlightState.STANDBY: (
        _STOPPED,
        Transition(
            lambda f: f.standing and not (f.link and f.odometry_usable), FlightState.STARTING, "{problem}"
        ),
        Transition(
            lambda f: f.armed and f.airborne and f.healthy,
            FlightState.READY,
            "airborne, waiting for authorisation",
        ),
    ),
    FlightState.READY: (
        _STOPPED,
        _GROUNDED,
        _LINK_LOST,
        _BLIND,
        _DISAGREES,
        _ENGAGE,
    ),
    FlightState.ENGAGING: (
        _STOPPED,
        _STALLED,
        _REVOKED,
        _LINK_LOST,
        Transition(lambda f: f.failsafe, FlightState.PILOT, "autopilot failsafe"),
        Transition(lambda f: f.mode_left, FlightState.PILOT, "mode changed while engaging"),
        Transition(lambda f: not f.healthy, FlightState.READY, "not engaged: {problem}"),
        Transition(lambda f: f.mode is VehicleMode.OFFBOARD, FlightState.ACTIVE, "autopilot is in OFFBOARD"),
        Transition(lambda f: f.engage_timed_out, FlightState.READY, "autopilot did not enter OFFBOARD"),
    ),
    FlightState.ACTIVE: (
        _STOPPED,
        _STALLED,
        _REVOKED,
        _TAKEOVER_FAILSAFE,
        _TAKEOVER_PILOT,
        _LINK_LOST,
        _DISAGREES,
        Transition(lambda f: f.map_jumped, FlightState.LANDING, "odometry restarted, the map moved"),
        Transition(lambda f: not f.odometry_usable, FlightState.HOLDING, "{problem}"),
        Transition(lambda f: f.finished, FlightState.LANDING, "mission finished"),
    ),
    FlightState.HOLDING: (
        _STOPPED,
        _STALLED,
        _REVOKED,
        _TAKEOVER_FAILSAFE,
        _TAKEOVER_PILOT,
        _LINK_LOST,
        _BLIND,
        _DISAGREES,
        Transition(lambda f: f.map_jumped and f.odometry_usable, FlightState.LANDING, "the map moved"),
        Transition(lambda f: f.odometry_usable, FlightState.ACTIVE, "odometry usable again"),
    ),
    FlightState.LANDING: (
        Transition(lambda f: f.link and f.on_ground, FlightState.DONE, "landed and disarmed"),
        _STOPPED,
        _STALLED,
        _REVOKED,
        Transition(
            # On touch-down the autopilot disarms and changes the mode by itself.
            lambda f: f.link and f.airborne and f.mode not in (VehicleMode.OFFBOARD, VehicleMode.LAND),
            FlightState.PILOT,
            "autopilot left OFFBOARD",
        ),
        _LINK_LOST,
        Transition(
            lambda f: f.odometry_lost and f.mode is VehicleMode.OFFBOARD, FlightState.LOST, "{problem}"
        ),
    ),
    FlightState.PILOT: (_GROUNDED, _ENGAGE),
    FlightState.LISTENING: (_GROUNDED, _ENGAGE),
    FlightState.LOST: (_GROUNDED, _ENGAGE),
    FlightState.DONE: (Transition(lambda f: f.armed, FlightState.STANDBY, "armed again"),),
}

COMMANDING = frozenset({FlightState.ENGAGING, FlightState.ACTIVE, FlightState.HOLDING, FlightState.LANDING})
"""States in which setpoints are streamed (in READY too when a mode switch may authorise)."""


class Supervisor:
    """Holds the present state and applies the table."""

    def __init__(self) -> None:
        """Begin before anything is known."""
        self.state = FlightState.STARTING

    def step(self, facts: Facts) -> Transition | None:
        """Apply the first transition whose condition holds; return it, or None to stay."""
        for transition in TRANSITIONS[self.state]:
            if transition.condition(facts):
                self.state = transition.target
                return transition
        return None

    def refusal(self, facts: Facts) -> str:
        """Return why an authorisation cannot be followed now, or an empty string."""
        if not facts.link:
            return "no link to the autopilot"
        if self.state in COMMANDING:
            return "already in control"
        if not (facts.armed and facts.airborne):
            return "vehicle is not flying"
        if facts.failsafe:
            return "autopilot is in failsafe"
        if not facts.healthy:
            return facts.problem or "estimates disagree"
        if facts.map_jumped:
            return "the map moved since take-off"
        return (
            ""
            if self.state in (FlightState.READY, FlightState.PILOT, FlightState.LISTENING, FlightState.LOST)
            else f"state is {self.state.value}"
        )
