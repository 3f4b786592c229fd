"""Which packets of one stream were lost, doubled, late, or came after a jump of the clock.

Neither signal suffices alone: the packet counter wraps every 31 s and a pausing sender stops it, and
stamps alone cannot tell a jumping clock from an outage. Here both are judged together.
"""

from enum import Enum

from companion.clock import seconds_to_ns

COUNTER_RANGE = 1 << 16
MAX_COUNTER_GAP = 1023
MAX_LATENESS_NS = seconds_to_ns(0.5)
# A forward gap this long is no longer explained by this stream alone; it is counted as an outage.
OUTAGE_NS = seconds_to_ns(0.5)
SUSPICIOUS_LATENESS_NS = seconds_to_ns(0.05)
_REMEMBERED = 1024


class Arrival(Enum):
    """How a packet stands to those before it."""

    IN_ORDER = "in order"
    DUPLICATE = "duplicate"
    LATE = "late"
    JUMP = "jump"


class LossAccount:
    """Account of one stream of packets with a 16-bit counter and a stamp.

    Attributes:
        epoch: the number of restarts of the sensor's clock that this stream has followed.
        received: packets accepted, late ones included, duplicates not.
        lost: packets missing by counter or stamp, less those that came late after all.
        jumps: discontinuities of stamps that no loss explains.
        outages: gaps longer than half a second.
    """

    def __init__(self, period_ns: int) -> None:
        """Start for a stream with one packet every `period_ns` nanoseconds."""
        self._period_ns = period_ns
        self._seen = [-1] * _REMEMBERED
        self._last_ns: int | None = None
        self._last_counter = 0
        self.epoch = 0
        self.received = 0
        self.lost = 0
        self.duplicates = 0
        self.reordered = 0
        self.jumps = 0
        self.outages = 0

    def observe(self, counter: int, t_sensor_ns: int, epoch: int, lateness_ns: int = 0) -> Arrival:
        """Account for one packet.

        Args:
            counter: the packet's counter, 16 bits.
            t_sensor_ns: its stamp.
            epoch: number of restarts of the sensor's clock known so far.
            lateness_ns: by how much it came later than the clock's offset makes expect.
        """
        if self._last_ns is None:
            return self._accept(counter, t_sensor_ns, epoch, Arrival.IN_ORDER)
        elapsed_ns = t_sensor_ns - self._last_ns
        if elapsed_ns == self._period_ns and counter == self._last_counter + 1 and epoch == self.epoch:
            # The next one, as nearly always.
            return self._accept(counter, t_sensor_ns, epoch, Arrival.IN_ORDER)
        place = t_sensor_ns // self._period_ns % _REMEMBERED
        identity = t_sensor_ns * COUNTER_RANGE + counter
        if self._seen[place] == identity and epoch == self.epoch:
            self.duplicates += 1
            return Arrival.DUPLICATE
        step = (counter - self._last_counter) % COUNTER_RANGE
        if epoch != self.epoch:
            return self._jump(counter, t_sensor_ns, epoch)
        if elapsed_ns <= 0:
            counter_agrees = COUNTER_RANGE - step <= MAX_COUNTER_GAP
            if not counter_agrees or elapsed_ns < -MAX_LATENESS_NS:
                return self._jump(counter, t_sensor_ns, epoch)
            self.received += 1
            self.reordered += 1
            self.lost = max(0, self.lost - 1)
            self._seen[place] = identity
            return Arrival.LATE
        by_counter = step - 1 if 1 <= step <= MAX_COUNTER_GAP else 0
        by_time = (elapsed_ns + self._period_ns // 2) // self._period_ns - 1
        counter_restarted = not 1 <= step <= MAX_COUNTER_GAP and step != (by_time + 1) % COUNTER_RANGE
        if counter_restarted and lateness_ns > SUSPICIOUS_LATENESS_NS:
            # The sensor lost power, and its new stamps happen to lie ahead of its old ones.
            return self._jump(counter, t_sensor_ns, epoch)
        self.lost += max(by_counter, by_time, 0)
        self.outages += elapsed_ns > OUTAGE_NS
        return self._accept(counter, t_sensor_ns, epoch, Arrival.IN_ORDER)

    def _jump(self, counter: int, t_sensor_ns: int, epoch: int) -> Arrival:
        self.jumps += 1
        self._seen = [-1] * _REMEMBERED
        return self._accept(counter, t_sensor_ns, epoch, Arrival.JUMP)

    def _accept(self, counter: int, t_sensor_ns: int, epoch: int, arrival: Arrival) -> Arrival:
        self.received += 1
        self._last_ns = t_sensor_ns
        self._last_counter = counter
        self.epoch = epoch
        place = t_sensor_ns // self._period_ns % _REMEMBERED
        self._seen[place] = t_sensor_ns * COUNTER_RANGE + counter
        return arrival
