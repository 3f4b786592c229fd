"""When to decide on the next setpoint: at a steady rate, and at once when something new has been seen."""


class DecisionSchedule:
    """Instants of decisions on the host's clock.

    A scan that waited for the next regular instant would be up to a period older when it first moves the
    vehicle. So a new scan is answered at once, and the regular instants follow from there: they fall in
    step with the scans, and no two decisions are further apart than the period.
    """

    def __init__(self, period_ns: int, t_ns: int) -> None:
        """Be due at `t_ns` and then every `period_ns`."""
        self._period_ns = period_ns
        self.next_ns = t_ns

    def due(self, t_ns: int) -> bool:
        """Whether a regular decision is due."""
        return t_ns >= self.next_ns

    def decided(self, t_ns: int) -> None:
        """Note a regular decision; instants that were missed are gone, a burst would be worse than a gap."""
        self.next_ns += self._period_ns
        if self.next_ns <= t_ns:
            self.next_ns = t_ns + self._period_ns

    def seen(self, t_ns: int) -> None:
        """Note a decision made because something new was seen."""
        self.next_ns = t_ns + self._period_ns
