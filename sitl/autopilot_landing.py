"""Land detector of the emulated autopilot."""

from companion.clock import seconds_to_ns

_LANDED_AFTER_NS = seconds_to_ns(1.5)
_AIRBORNE_AFTER_NS = seconds_to_ns(0.1)
_DESCENT_M_S = -0.1


class LandDetector:
    """Believes in the ground after contact with descent commanded, and in the air after leaving it.

    Attributes:
        landed: the verdict.
    """

    def __init__(self) -> None:
        self.landed = True
        self._t_change_ns: int | None = None

    def step(self, t_ns: int, contact: bool, armed: bool, climb_local: float) -> bool:
        """Return whether the vehicle counts as landed.

        Args:
            t_ns: present time.
            contact: the landing gear touches the ground.
            armed: motors turn.
            climb_local: commanded climb rate, m/s.
        """
        if self.landed:
            changes = armed and not contact
            after_ns = _AIRBORNE_AFTER_NS
        else:
            changes = contact and (not armed or climb_local < _DESCENT_M_S)
            after_ns = _LANDED_AFTER_NS
        if not changes:
            self._t_change_ns = None
        elif self._t_change_ns is None:
            self._t_change_ns = t_ns
        elif t_ns - self._t_change_ns >= after_ns:
            self.landed = not self.landed
            self._t_change_ns = None
        return self.landed
