"""The autopilot rig behind its MAVLink emulator, and a peer that speaks through pymavlink."""

import struct
from typing import Any

from pymavlink.dialects.v20 import development as dialect

from sitl.mavlink_emulator import EmulatorSettings, MavlinkEmulator, Outgoing, Peer
from tests.sitl.autopilot_rig import STEP_NS, Rig


class PeerRig:
    """Autopilot, body and emulator in lockstep, with everything received by name."""

    def __init__(self, rig: Rig | None = None, clock_slow: float = 0.0) -> None:
        self.rig = rig or Rig()
        self.emulator = MavlinkEmulator(self.rig.autopilot, EmulatorSettings(clock_slow=clock_slow))
        self.received: dict[Peer, list[tuple[int, Any]]] = {Peer.COMPANION: [], Peer.GROUND: []}
        self._packers = {
            Peer.COMPANION: dialect.MAVLink(None, srcSystem=1, srcComponent=191),
            Peer.GROUND: dialect.MAVLink(None, srcSystem=255, srcComponent=190),
        }
        self._parsers = {peer: dialect.MAVLink(None) for peer in Peer}

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.rig.run(STEP_NS * 1e-9)
            self._collect(self.emulator.poll(self.rig.t_ns))

    def pack(self, message: Any, peer: Peer = Peer.COMPANION) -> bytes:
        return bytes(message.pack(self._packers[peer]))

    def send(self, message: Any, peer: Peer = Peer.COMPANION) -> None:
        self._collect(self.emulator.receive(self.pack(message, peer), self.rig.t_ns, peer))

    def command(
        self, number: int, *parameters: float, peer: Peer = Peer.COMPANION, component: int = 1
    ) -> None:
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(dialect.MAVLink_command_long_message(1, component, number, 0, *values), peer)

    def of(self, name: str, peer: Peer = Peer.COMPANION, since_ns: int = 0) -> list[Any]:
        return [m for t_ns, m in self.received[peer] if m.get_type() == name and t_ns >= since_ns]

    def last(self, name: str, peer: Peer = Peer.COMPANION) -> Any:
        return self.of(name, peer)[-1]

    def result(self, number: int, *parameters: float, peer: Peer = Peer.COMPANION) -> int:
        """Send a command and return the result of its acknowledgement, -1 if there was none."""
        before = len(self.of("COMMAND_ACK", peer))
        self.command(number, *parameters, peer=peer)
        answers = self.of("COMMAND_ACK", peer)[before:]
        return int(answers[-1].result) if answers and answers[-1].command == number else -1

    def stream_velocity(self, seconds: float, vx: float = 0.0, vz: float = 0.0) -> None:
        for _ in range(round(seconds / 0.05)):
            self.send(velocity_target(vx, vz))
            self.run(0.05)

    def _collect(self, outgoing: list[Outgoing]) -> None:
        for item in outgoing:
            for message in self._parsers[item.peer].parse_buffer(item.payload) or []:
                self.received[item.peer].append((self.rig.t_ns, message))


def velocity_target(vx: float, vz: float = 0.0) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED as a companion sends it: velocity and yaw rate, z-down."""
    zeros = (0.0, 0.0, 0.0)
    return dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0x5C7, *zeros, vx, 0.0, vz, *zeros, 0.0, 0.0
    )


def as_integer(value: float) -> int:
    """Return the integer that travels byte-wise in a PARAM_VALUE."""
    number: int = struct.unpack("<i", struct.pack("<f", value))[0]
    return number
