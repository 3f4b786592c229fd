"""The sensor's side of the Livox Mid-360 protocol: commands in, datagrams out. No sockets, no clock.

Sensor time is 0 at power-on and runs with the host time of the `t_ns` arguments. Slots and samples come
from the sensor model, already stamped; they leave as packets only while the sensor samples, is told to
send and knows whom to serve.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from companion.drivers import livox_protocol as protocol
from companion.drivers.livox_packets import DataType, TimeType
from companion.drivers.livox_protocol import (
    BROADCAST_IP,
    Command,
    CommandFrame,
    DeviceType,
    Key,
    ReturnCode,
    WorkState,
)
from companion.errors import ProtocolError
from companion.messages import Datagram
from sitl.livox_device import EmulatedDevice, LivoxEmulatorSettings
from sitl.livox_parameters import PUSH_KEYS
from sitl.livox_stream import encode_inertial, encode_points
from sitl.slots import SLOT_PERIOD_NS, SLOTS_PER_PACKET, InertialSlot, PointSlots

__all__ = ["LivoxEmulator", "LivoxEmulatorSettings"]

PUSH_PERIOD_NS = 1_000_000_000
PACKET_PERIOD_NS = SLOTS_PER_PACKET * SLOT_PERIOD_NS
_MAX_BODY_SIZE = protocol.MAX_FRAME_SIZE - protocol.FRAME_HEADER_SIZE
_LOG_COMMANDS = (Command.LOG_ENABLE, Command.LOG_TIME_SYNC, Command.DEBUG_RAW_DATA)
_UPGRADE_COMMANDS = range(Command.UPGRADE_START, Command.UPGRADE_PROGRESS + 1)


@dataclass(slots=True)
class _Run:
    """What starts anew with every power-on."""

    next_push_ns: int
    reboot_ns: int | None = None
    sequence: int = 0
    point_counter: int = 0
    imu_counter: int = 0
    clock_error_ns: int = 0
    pending: PointSlots | None = None


class LivoxEmulator:
    """One sensor on the wire: answers, state pushes, and the packets in the making.

    Attributes:
        commands: requests answered.
        malformed: datagrams that were no valid requests.
    """

    def __init__(self, settings: LivoxEmulatorSettings, boot_host_ns: int = 0) -> None:
        """Power on at host time `boot_host_ns`."""
        self._settings = settings
        self._device = EmulatedDevice(settings, boot_host_ns)
        self.commands = 0
        self.malformed = 0
        self._run = _Run(boot_host_ns)

    @property
    def settings(self) -> LivoxEmulatorSettings:
        """What it was built with."""
        return self._settings

    @property
    def boot_host_ns(self) -> int:
        """Host time at which sensor time was 0."""
        return self._device.boot_host_ns

    def work_state(self, t_ns: int) -> WorkState:
        """Return the working state at host time `t_ns`."""
        self._reboot_if_due(t_ns)
        return self._device.work_state(t_ns)

    def power_cycle(self, boot_host_ns: int) -> None:
        """Lose everything that is not persisted and start again at host time `boot_host_ns`.

        Until then the sensor is off. Slot numbers and sample times count from the new power-on.
        """
        self._device.power_cycle(boot_host_ns)
        self._run = _Run(boot_host_ns)

    def step_clock(self, step_ns: int) -> None:
        """Let the sensor's clock jump by `step_ns` nanoseconds against the slots' own times."""
        self._run.clock_error_ns += step_ns

    def set_fault(self, hms_code: int) -> None:
        """Enter the working state ERROR with a health code, or leave it with 0."""
        self._device.set_fault(hms_code)

    def receive(self, datagram: Datagram) -> list[Datagram]:
        """Take one datagram and return the answers; what is malformed is counted and ignored."""
        t_ns = datagram.t_ns
        self._reboot_if_due(t_ns)
        ip, port = datagram.destination
        if t_ns < self.boot_host_ns or ip not in (self._settings.lidar_ip, BROADCAST_IP):
            return []
        try:
            frame = protocol.parse_frame(datagram.payload)
        except ProtocolError:
            self.malformed += 1
            return []
        if frame.acknowledges or frame.from_lidar:
            return []
        body = self._answer(t_ns, port, frame)
        if body is None:
            return []
        self.commands += 1
        answer = protocol.build_frame(CommandFrame(frame.sequence, frame.command, True, True, body))
        return [Datagram(t_ns, (self._settings.lidar_ip, port), datagram.source, answer)]

    def poll(self, t_ns: int) -> list[Datagram]:
        """Return the state push if one is due at host time `t_ns`."""
        self._reboot_if_due(t_ns)
        if t_ns < max(self._run.next_push_ns, self.boot_host_ns):
            return []
        self._run.next_push_ns += PUSH_PERIOD_NS * ((t_ns - self._run.next_push_ns) // PUSH_PERIOD_NS + 1)
        destination = self._destination(Key.STATE_HOST)
        if destination is None:
            return []
        self._run.sequence += 1
        body = protocol.build_parameters(self._device.read(t_ns, [int(key) for key in PUSH_KEYS]))
        push = protocol.build_frame(CommandFrame(self._run.sequence, Command.PUSH, False, True, body))
        return [Datagram(t_ns, (self._settings.lidar_ip, self._settings.ports.state), destination, push)]

    def points(self, slots: PointSlots) -> list[Datagram]:
        """Take consecutive slots and return the packets that they complete.

        Slots that do not fill a packet are kept for the next call. Each datagram's time is the host time
        at which its last slot fired.
        """
        if not len(slots.points_lidar):
            return []
        last_slot = slots.first_slot + len(slots.points_lidar) - 1
        destination = self._destination(Key.POINT_HOST)
        sends = self._device[Key.POINT_SEND][0] == 0
        if not sends or destination is None or not self._samples_at(last_slot * SLOT_PERIOD_NS):
            self._run.pending = None
            return []
        slots = self._joined(slots)
        complete = len(slots.points_lidar) // SLOTS_PER_PACKET * SLOTS_PER_PACKET
        self._run.pending = _part(slots, complete, len(slots.points_lidar))
        data_type = DataType(self._device[Key.PCL_DATA_TYPE][0])
        payloads = encode_points(
            _part(slots, 0, complete),
            data_type,
            self._run.point_counter,
            TimeType.NONE,
            self._run.clock_error_ns,
        )
        self._run.point_counter = (self._run.point_counter + len(payloads)) & 0xFFFF
        source = (self._settings.lidar_ip, self._settings.ports.points)
        t_sent_ns = self.boot_host_ns + (slots.first_slot + SLOTS_PER_PACKET - 1) * SLOT_PERIOD_NS
        return [
            Datagram(t_sent_ns + index * PACKET_PERIOD_NS, source, destination, payload)
            for index, payload in enumerate(payloads)
        ]

    def inertial(self, slot: InertialSlot) -> list[Datagram]:
        """Take one inertial sample and return its packet, sent at the sample's own time."""
        destination = self._destination(Key.IMU_HOST)
        sends = self._device[Key.IMU_DATA_ENABLE][0] == 1
        if not sends or destination is None or not self._samples_at(slot.t_sensor_ns):
            return []
        payload = encode_inertial(slot, self._run.imu_counter, TimeType.NONE, self._run.clock_error_ns)
        self._run.imu_counter = (self._run.imu_counter + 1) & 0xFFFF
        source = (self._settings.lidar_ip, self._settings.ports.imu)
        return [Datagram(self.boot_host_ns + slot.t_sensor_ns, source, destination, payload)]

    def _reboot_if_due(self, t_ns: int) -> None:
        if self._run.reboot_ns is not None and t_ns >= self._run.reboot_ns:
            self.power_cycle(self._run.reboot_ns)

    def _samples_at(self, t_sensor_ns: int) -> bool:
        return t_sensor_ns >= 0 and self.work_state(self.boot_host_ns + t_sensor_ns) is WorkState.SAMPLING

    def _destination(self, key: Key) -> tuple[str, int] | None:
        return _address(self._device[key])

    def _joined(self, slots: PointSlots) -> PointSlots:
        """Return the slots kept from the last call followed by `slots`, if they are consecutive."""
        kept = self._run.pending
        if kept is None or kept.first_slot + len(kept.points_lidar) != slots.first_slot:
            return slots
        return PointSlots(
            kept.first_slot,
            np.concatenate([kept.points_lidar, slots.points_lidar]),
            np.concatenate([kept.reflectivity, slots.reflectivity]),
            np.concatenate([kept.tags, slots.tags]),
        )

    def _answer(self, t_ns: int, port: int, frame: CommandFrame) -> bytes | None:
        """Return the body of the answer, or None where a real sensor stays silent."""
        ports = self._settings.ports
        if port == ports.discovery:
            return self._search_answer() if frame.command == Command.SEARCH else None
        if port == ports.log:
            return bytes([ReturnCode.OK if frame.command in _LOG_COMMANDS else ReturnCode.NOT_SUPPORTED])
        return self._command_answer(t_ns, frame) if port == ports.command else None

    def _command_answer(self, t_ns: int, frame: CommandFrame) -> bytes:
        command, body = frame.command, frame.data
        if command == Command.SET_PARAMETERS:
            return self._write(t_ns, body)
        if command == Command.GET_PARAMETERS:
            return self._read(t_ns, body)
        if command == Command.REBOOT:
            self._run.reboot_ns = t_ns + int.from_bytes(body[:2], "little") * 1_000_000
            return bytes([ReturnCode.OK])
        if command == Command.FACTORY_RESET:
            if body != self._settings.serial.encode("ascii").ljust(16, b"\0"):
                return bytes([ReturnCode.FAILURE])
            self._run.reboot_ns = t_ns
            return bytes([ReturnCode.OK])
        if command == Command.SET_RMC_TIME:
            return bytes([ReturnCode.OK])
        if command in _UPGRADE_COMMANDS:
            return bytes([ReturnCode.NOT_PERMITTED])
        return bytes([ReturnCode.NOT_SUPPORTED])

    def _search_answer(self) -> bytes:
        settings = self._settings
        answer = protocol.SearchAnswer(
            ReturnCode.OK, DeviceType.MID360, settings.serial, settings.lidar_ip, settings.ports.command
        )
        return protocol.build_search_answer(answer)

    def _write(self, t_ns: int, body: bytes) -> bytes:
        try:
            parameters = protocol.parse_parameters(body)
        except ProtocolError:
            self.malformed += 1
            return protocol.build_set_answer(ReturnCode.KEY_COUNT_MISMATCH)
        return protocol.build_set_answer(*self._device.write(t_ns, parameters))

    def _read(self, t_ns: int, body: bytes) -> bytes:
        try:
            keys = protocol.parse_query(body)
        except ProtocolError:
            self.malformed += 1
            return protocol.build_query_answer(ReturnCode.KEY_COUNT_MISMATCH, [])
        found = self._device.read(t_ns, keys)
        if keys and not found:
            return protocol.build_query_answer(ReturnCode.NOT_SUPPORTED, [])
        answer = protocol.build_query_answer(ReturnCode.OK, found)
        if len(answer) > _MAX_BODY_SIZE:
            return protocol.build_query_answer(ReturnCode.WRONG_LENGTH, [])
        return answer


@lru_cache(maxsize=64)
def _address(value: bytes) -> tuple[str, int] | None:
    """Return where a stream goes according to its parameter, None for nowhere."""
    address = protocol.parse_stream_address(value)
    if address.ip == "0.0.0.0" or address.port == 0:
        return None
    return address.ip, address.port


def _part(slots: PointSlots, start: int, end: int) -> PointSlots:
    return PointSlots(
        slots.first_slot + start,
        slots.points_lidar[start:end],
        slots.reflectivity[start:end],
        slots.tags[start:end],
    )
