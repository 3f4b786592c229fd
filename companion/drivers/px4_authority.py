"""Commands addressed to the companion: who may grant and revoke control over MAVLink."""

from companion.clock import seconds_to_ns
from companion.drivers import px4_commands
from companion.drivers.mavlink_fields import integer, real
from companion.drivers.px4_settings import Px4Settings
from companion.errors import ProtocolError
from companion.messages import Authorisation, MavlinkMessage

_REPEAT_NS = seconds_to_ns(5.0)
_MAX_WAITING = 32


class Authority:
    """Judges every command that arrives.

    MAV_CMD_USER_1 with param1 = 1 grants and 0 revokes. A repetition (confirmation above 0) within 5 s of
    the same command from the same station is acknowledged again but is no second grant: a late one must
    not hand back control that a pilot has taken meanwhile.
    """

    def __init__(self, settings: Px4Settings) -> None:
        """Listen to the settings' ground stations."""
        self._own = (settings.system_id, settings.component_id)
        self.stations = frozenset((s.system_id, s.component_id) for s in settings.ground_stations)
        """Addresses that may authorise."""
        self._waiting: list[Authorisation] = []
        self._last: tuple[tuple[int, int], bool, int] | None = None
        self.wrong_target = 0
        """Commands addressed to somebody else."""
        self.denied = 0
        """Authorisations from somebody who may not give them, or without meaning."""

    def receive(self, message: MavlinkMessage, t_ns: int) -> dict[str, object] | None:
        """Take a COMMAND_LONG or COMMAND_INT; return the fields of its COMMAND_ACK, if it gets one.

        Raises:
            ProtocolError: if its address or number is unusable.
        """
        target = (integer(message, "target_system", 0, 0xFF), integer(message, "target_component", 0, 0xFF))
        number = integer(message, "command", 0, 0xFFFF)
        if target != self._own:
            self.wrong_target += 1
            return None
        result = px4_commands.UNSUPPORTED
        if number == px4_commands.USER_1 and message.name == "COMMAND_LONG":
            result = self._judge(message, t_ns)
        return {
            "command": number,
            "result": result,
            "progress": 0,
            "result_param2": 0,
            "target_system": message.system_id,
            "target_component": message.component_id,
        }

    def drain(self) -> list[Authorisation]:
        """Return the authorisations that arrived since the last call."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def _judge(self, message: MavlinkMessage, t_ns: int) -> int:
        station = (message.system_id, message.component_id)
        try:
            granted = {1.0: True, 0.0: False}.get(real(message, "param1"))
        except ProtocolError:
            granted = None
        if station not in self.stations or granted is None:
            self.denied += 1
            return px4_commands.DENIED
        repeated = integer(message, "confirmation", 0, 0xFF) > 0
        if repeated and self._last is not None:
            last_station, last_granted, last_ns = self._last
            if (last_station, last_granted) == (station, granted) and t_ns - last_ns <= _REPEAT_NS:
                return px4_commands.ACCEPTED
        self._last = (station, granted, t_ns)
        if len(self._waiting) >= _MAX_WAITING:
            del self._waiting[0]
        self._waiting.append(Authorisation(t_ns, granted, "ground_station"))
        return px4_commands.ACCEPTED
