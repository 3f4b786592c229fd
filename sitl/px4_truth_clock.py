"""Maps a simulator's clock, slightly slow and seen through jittered arrivals, onto the host's clock."""

_OFFSET_SIGMA_S = 0.02
_RATE_SIGMA = 0.01
_JITTER_SIGMA_S = 0.005
_OFFSET_WALK_S2_PER_S = 1.0e-9
_RATE_WALK_PER_S = 1.0e-10


class ClockMap:
    """Kalman filter of host time = simulator time + offset, with the offset drifting at a steady rate.

    Times are seconds relative to the first pair, so that double precision is never at stake.
    """

    def __init__(self, simulator_us: int, host_ns: int) -> None:
        """Start with one pair of times."""
        self._simulator_start_us = simulator_us
        self._host_start_ns = host_ns
        self._simulator_s = 0.0
        self._offset_s = 0.0
        self._drift = 0.0
        self._p_oo, self._p_od, self._p_dd = _OFFSET_SIGMA_S**2, 0.0, _RATE_SIGMA**2

    @property
    def rate(self) -> float:
        """Simulator seconds per host second."""
        return 1.0 / (1.0 + self._drift)

    def update(self, simulator_us: int, host_ns: int) -> int:
        """Take one pair of times and return the host time at which the simulator time was true, in ns.

        The mean transport delay cannot be observed and stays in the result.
        """
        simulator_s = (simulator_us - self._simulator_start_us) * 1.0e-6
        host_s = (host_ns - self._host_start_ns) * 1.0e-9
        dt = simulator_s - self._simulator_s
        self._simulator_s = simulator_s
        self._offset_s += self._drift * dt
        self._p_oo += dt * (2.0 * self._p_od + dt * self._p_dd) + _OFFSET_WALK_S2_PER_S * dt
        self._p_od += dt * self._p_dd
        self._p_dd += _RATE_WALK_PER_S * dt
        innovation = host_s - simulator_s - self._offset_s
        total = self._p_oo + _JITTER_SIGMA_S**2
        gain_o, gain_d = self._p_oo / total, self._p_od / total
        self._offset_s += gain_o * innovation
        self._drift += gain_d * innovation
        self._p_dd -= gain_d * self._p_od
        self._p_od -= gain_o * self._p_od
        self._p_oo -= gain_o * self._p_oo
        return self._host_start_ns + round((simulator_s + self._offset_s) * 1.0e9)
