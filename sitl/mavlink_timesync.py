"""The emulated autopilot's side of time synchronisation, per link."""

CONVERGED_AFTER = 500
_ROUND_TRIP_MAX_US = 10_000
_DEVIATION_MAX_US = 100_000
_OUTLIERS_MAX = 10
_GAIN_START = 0.05
_GAIN_END = 0.003
_U64 = 1 << 64


class Timesync:
    """Estimates the peer's clock from TIMESYNC replies and moves its stamps into boot time.

    Until 500 good samples have arrived (50 s at 10 Hz) a peer's stamps are not believed, and the time of
    arrival is used. Afterwards the stamp plus the offset is used as it is, however absurd.

    Attributes:
        samples: good samples in a row since the last restart.
        offset_us: boot time minus the peer's time.
    """

    def __init__(self) -> None:
        self.samples = 0
        self.offset_us = 0.0
        self._slow = 0
        self._deviating = 0

    @property
    def converged(self) -> bool:
        """Whether stamps are believed."""
        return self.samples >= CONVERGED_AFTER

    def reply(self, now_us: int, sent_us: int, peer_us: int) -> None:
        """Take one answer.

        Args:
            now_us: boot time of its arrival.
            sent_us: boot time at which it was asked.
            peer_us: the peer's time when it answered.
        """
        round_trip_us = now_us - sent_us
        if round_trip_us < 0 or round_trip_us > _ROUND_TRIP_MAX_US:
            self._slow += 1
            if self._slow > _OUTLIERS_MAX:
                self._restart()
            return
        self._slow = 0
        offset_us = 0.5 * (now_us + sent_us) - peer_us
        if self.samples == 0:
            self.offset_us = offset_us
        if abs(offset_us - self.offset_us) > _DEVIATION_MAX_US:
            self._deviating += 1
            if self._deviating > _OUTLIERS_MAX:
                self._restart()
            return
        self._deviating = 0
        progress = min(1.0, self.samples / CONVERGED_AFTER)
        gain = _GAIN_START + progress * (_GAIN_END - _GAIN_START)
        self.offset_us += gain * (offset_us - self.offset_us)
        self.samples += 1

    def to_boot_us(self, stamp_us: int, now_us: int) -> int:
        """Return the boot time of a peer's stamp; unsigned arithmetic wraps as on the autopilot."""
        if not self.converged:
            return now_us
        return (stamp_us + round(self.offset_us)) % _U64

    def _restart(self) -> None:
        self.samples = 0
        self._slow = 0
        self._deviating = 0
