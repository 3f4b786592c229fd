from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as dialect

from companion.messages import VehicleMode
from sitl.mavlink_emulator import Peer
from sitl.operator import Operator, ScriptStatus
from sitl.operator_script import Arm, SelectMode, SetParameter, Step, after, connected, takeoff_and_authorise
from tests.sitl.mavlink_peer import PeerRig, velocity_target

_STANDBY, _ACTIVE = 3, 4


class Crew:
    """Autopilot, operator and a minimal companion that flies forward once it is authorised."""

    def __init__(self, operator: Operator) -> None:
        self.peers = PeerRig()
        self.operator = operator
        self.authorised_ns: int | None = None
        self._seen = {Peer.COMPANION: 0, Peer.GROUND: 0}

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.025)):
            self.peers.run(0.025)
            t_ns = self.peers.rig.t_ns
            for message in self._news(Peer.GROUND):
                self.operator.receive(bytes(message.get_msgbuf()), t_ns)
            for frame in self.operator.poll(t_ns):
                self.peers._collect(self.peers.emulator.receive(frame, t_ns, Peer.GROUND))
            self._companion(t_ns)

    def _companion(self, t_ns: int) -> None:
        for message in self._news(Peer.COMPANION):
            if message.get_type() == "COMMAND_LONG" and message.target_component == 191:
                self.authorised_ns = t_ns
                sender = (message.get_srcSystem(), message.get_srcComponent())
                self.peers.send(dialect.MAVLink_command_ack_message(message.command, 0, 0, 0, *sender))
        if t_ns % 1_000_000_000 < 25_000_000:
            state = _ACTIVE if self.authorised_ns else _STANDBY
            self.peers.send(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, state, 3))
        if self.authorised_ns is not None and t_ns - self.authorised_ns < 12_000_000_000:
            self.peers.send(velocity_target(0.3))
            if t_ns - self.authorised_ns == 100_000_000:
                self.peers.command(176, 1, 6)

    def _news(self, peer: Peer) -> list[Any]:
        inbox = self.peers.received[peer]
        start, self._seen[peer] = self._seen[peer], len(inbox)
        return [message for _, message in inbox[start:]]


def test_the_usual_script_takes_off_authorises_and_sees_the_landing() -> None:
    crew = Crew(Operator(takeoff_and_authorise(1.5, 1.0)))
    crew.run(15.0)
    assert crew.peers.rig.parameters["MIS_TAKEOFF_ALT"] == 1.5
    assert crew.authorised_ns is not None
    assert crew.peers.rig.autopilot.mode is VehicleMode.OFFBOARD
    assert crew.operator.view.companion_was_active
    crew.run(25.0)
    assert not crew.peers.rig.autopilot.armed
    assert crew.operator.status is ScriptStatus.DONE
    names = [line.text for line in crew.operator.log]
    assert [n for n in names if n in ("arm", "authorise", "landed")] == ["arm", "authorise", "landed"]


def test_a_takeover_selects_position_with_sticks_and_the_companion_does_not_get_it_back() -> None:
    crew = Crew(Operator(takeoff_and_authorise(1.5, 1.0, takeover_after_s=2.0)))
    modes = []
    for _ in range(30):
        crew.run(0.5)
        modes.append(crew.operator.view.mode)
    assert modes.index(VehicleMode.OFFBOARD) < modes.index(VehicleMode.POSITION)
    assert crew.peers.rig.autopilot.mode is VehicleMode.POSITION
    held = crew.peers.rig.body.p.copy()
    crew.run(1.0)
    assert np.linalg.norm(crew.peers.rig.body.p - held) < 0.5
    crew.run(12.0)
    assert crew.operator.status is ScriptStatus.DONE
    assert not crew.peers.rig.autopilot.armed


def test_a_refused_action_fails_the_script_with_its_reason() -> None:
    crew = Crew(Operator([Step(connected, Arm(), "arm in hold")]))
    crew.run(8.0)
    assert crew.operator.status is ScriptStatus.FAILED
    assert crew.operator.reason == "arm in hold: refused with result 1"


def test_a_condition_that_never_comes_fails_after_its_timeout() -> None:
    operator = Operator(
        [Step(lambda view, _: view.armed, SelectMode(VehicleMode.LAND), "wait", timeout_s=2.0)]
    )
    crew = Crew(operator)
    crew.run(1.9)
    assert operator.status is ScriptStatus.RUNNING
    crew.run(0.3)
    assert operator.reason == "wait: waited 2 s in vain"


def test_a_silent_autopilot_fails_the_action_and_heartbeats_go_on() -> None:
    operator = Operator([Step(after(0.0), SetParameter("COM_OBL_RC_ACT", 4), "set", timeout_s=1.0)])
    sent = [frame for t in range(60) for frame in operator.poll(t * 100_000_000)]
    assert operator.status is ScriptStatus.FAILED
    assert sum(frame[7] == 0 for frame in sent) == 6, "one heartbeat a second"


@pytest.mark.parametrize("garbage", [b"", b"\xfd" * 300, bytes(range(256)) * 20])
def test_garbage_does_not_disturb_the_operator(garbage: bytes) -> None:
    operator = Operator(takeoff_and_authorise(1.5, 1.0))
    operator.receive(garbage, 0)
    assert operator.poll(0)
    assert operator.status is ScriptStatus.RUNNING
