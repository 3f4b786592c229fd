"""How a swarm takes off: everybody climbs and hovers, and all companions are authorised at once."""

from sitl.operator import Operator, OperatorSettings
from sitl.operator_script import (
    Authorise,
    Look,
    OperatorView,
    Step,
    companion_ready,
    landed_and_disarmed,
    takeoff,
)

_FOREVER_S = 3600.0
_TAKEOFF_TIMEOUT_S = 60.0


class StartSignal:
    """What the person at one vehicle shows the others, and what they all wait for.

    Attributes:
        ready: this vehicle hovers and its companion could take control.
        given: all vehicles are ready: authorise.
    """

    def __init__(self, hover_s: float) -> None:
        """Be ready only after hovering for `hover_s`."""
        self._hover_s = hover_s
        self.ready = False
        self.given = False

    def awaited(self, view: OperatorView, elapsed_s: float) -> bool:
        """Condition of the script: all are ready."""
        self.ready = elapsed_s >= self._hover_s and companion_ready(view, elapsed_s)
        return self.ready and self.given


def swarm_operator(settings: OperatorSettings, takeoff_height_m: float, signal: StartSignal) -> Operator:
    """Return the person at one vehicle of a swarm.

    Args:
        settings: whom to attend to.
        takeoff_height_m: where to hover.
        signal: how to wait for the others.
    """
    script = [
        *takeoff(takeoff_height_m),
        Step(signal.awaited, Authorise(), "authorise", timeout_s=_TAKEOFF_TIMEOUT_S),
        Step(landed_and_disarmed, Look(), "landed", timeout_s=_FOREVER_S),
    ]
    return Operator(script, settings)
