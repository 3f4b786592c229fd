"""The conversation that makes a Livox Mid-360 stream to this host, and keeps it streaming.

No sockets, no clock: `poll` and `receive` return what to send. The steps run in order; each is repeated
until it is answered, nothing is ever given up, and every step may be repeated without harm. After
silence the whole conversation starts again, because a sensor that lost power forgets whom to serve.

    SEARCHING -> IDENTIFYING -> ADDRESSING -> CONFIGURING -> VERIFYING -> AWAITING_DATA -> STREAMING
        ^____________________________ silence of any stream _________________________________|
"""

from dataclasses import dataclass, replace

from companion.drivers import livox_protocol as protocol
from companion.drivers.livox_diagnosis import LOADER, Evidence, describe
from companion.drivers.livox_health import LidarInfo, with_parameters
from companion.drivers.livox_packets import DataType
from companion.drivers.livox_protocol import BROADCAST_IP, Command, CommandFrame, Key, ReturnCode, WorkState
from companion.drivers.livox_settings import LivoxSettings, PointFormat
from companion.drivers.livox_stage import Stage
from companion.errors import ProtocolError
from companion.messages import Datagram

DATA_TYPES: dict[PointFormat, DataType] = {
    "cartesian_32": DataType.CARTESIAN_32,
    "cartesian_16": DataType.CARTESIAN_16,
    "spherical": DataType.SPHERICAL,
}
# Firmware that does not know a query must not keep us from flying: it is skipped when refused this often
REFUSED_QUERY_ATTEMPTS = 3
# or not answered this often.
SILENT_QUERY_ATTEMPTS = 6
# With data flowing all the same, unanswered or refused commands are no reason to refuse the data.
ATTEMPTS_WITH_DATA = 6
# A sensor that has answered nothing this often is searched anew.
SILENT_ATTEMPTS = 10
MAX_STRANGERS = 16
"""Other sensors remembered for the diagnosis."""


@dataclass(frozen=True, slots=True)
class _Step:
    stage: Stage
    command: Command
    body: bytes
    optional: bool = False


class LivoxHandshake:
    """State machine of the host's side of the control protocol, for one sensor."""

    def __init__(self, settings: LivoxSettings, host_ip: str) -> None:
        """Prepare for the sensor of `settings`; `host_ip` is the resolved own address."""
        self._settings = settings
        self._host_ip = host_ip
        self._timeout_ns = settings.command_timeout_ms * 1_000_000
        ports = settings.host_ports
        self._wanted = {
            Key.STATE_HOST: protocol.StreamAddress(host_ip, ports.state, settings.lidar_ports.state),
            Key.POINT_HOST: protocol.StreamAddress(host_ip, ports.points, settings.lidar_ports.points),
            Key.IMU_HOST: protocol.StreamAddress(host_ip, ports.imu, settings.lidar_ports.imu),
        }
        self._steps = self._plan()
        self._step = 0
        self._sequence = 0
        self._sequences: set[int] = set()
        self._attempts = 0
        self._t_next_ns: int | None = None
        self._t_configured_ns = 0
        self._t_points_ns: int | None = None
        self._t_imu_ns: int | None = None
        self._t_state_ns: int | None = None
        self._info = LidarInfo()
        self._evidence = Evidence()
        self._reruns = 0
        self._malformed = 0

    @property
    def stage(self) -> Stage:
        """The step being worked on."""
        if self._step < len(self._steps):
            return self._steps[self._step].stage
        return Stage.AWAITING_DATA if self._step == len(self._steps) else Stage.STREAMING

    @property
    def info(self) -> LidarInfo:
        """What the sensor last said about itself."""
        return self._info

    @property
    def reruns(self) -> int:
        """How often the conversation had to start again."""
        return self._reruns

    @property
    def malformed(self) -> int:
        """Datagrams that were no valid frames or answers."""
        return self._malformed

    def diagnosis(self) -> str:
        """Return one sentence on where the conversation stands and what to check."""
        evidence = replace(self._evidence, attempts=self._attempts)
        return describe(self.stage, self._settings, self._host_ip, self._info, evidence)

    def observe_data(self, t_points_ns: int | None, t_imu_ns: int | None) -> None:
        """Tell when the last good point and inertial packets were received, None for never."""
        self._t_points_ns = t_points_ns
        self._t_imu_ns = t_imu_ns

    def observe_send_error(self, text: str) -> None:
        """Tell why a datagram could not be sent; an empty text clears it."""
        self._evidence = replace(self._evidence, send_error=text)

    def poll(self, t_ns: int) -> list[Datagram]:
        """Return what is to be sent now; call it every 50 ms or so."""
        if self.stage is Stage.STREAMING:
            self._watch_silence(t_ns)
        elif self.stage is Stage.AWAITING_DATA:
            self._await_data(t_ns)
        elif self._attempts >= ATTEMPTS_WITH_DATA and self._data_flows(t_ns):
            self._evidence = replace(self._evidence, unconfirmed=self.stage)
            self._move(len(self._steps) + 1)
        if self._step >= len(self._steps) or (self._t_next_ns is not None and t_ns < self._t_next_ns):
            return []
        self._give_up_waiting(t_ns)
        return self._send(t_ns) if self._step < len(self._steps) else []

    def receive(self, datagram: Datagram) -> list[Datagram]:
        """Take one datagram of the command, discovery or state port; return what is to be sent."""
        try:
            frame = protocol.parse_frame(datagram.payload)
            if not frame.from_lidar:
                return []
            if datagram.source[0] != self._settings.lidar_ip:
                self._remember_stranger(datagram.source[0], frame)
                return []
            if not frame.acknowledges:
                if frame.command == Command.PUSH:
                    self._info = with_parameters(self._info, protocol.parse_parameters(frame.data))
                    self._t_state_ns = datagram.t_ns
                return []
            return self._receive_answer(datagram.t_ns, frame)
        except ProtocolError:
            self._malformed += 1
            return []

    def _plan(self) -> list[_Step]:
        def one(key: Key, value: int) -> bytes:
            return protocol.build_parameters([(key, bytes([value]))])

        addresses = [(int(key), address.pack()) for key, address in self._wanted.items()]
        set_command, get_command = Command.SET_PARAMETERS, Command.GET_PARAMETERS
        data_type = DATA_TYPES[self._settings.point_format]
        verified = protocol.build_query([Key.POINT_HOST, Key.IMU_HOST])
        return [
            _Step(Stage.SEARCHING, Command.SEARCH, b""),
            _Step(Stage.IDENTIFYING, get_command, protocol.build_query([Key.FIRMWARE_TYPE]), optional=True),
            _Step(Stage.ADDRESSING, set_command, protocol.build_parameters(addresses)),
            _Step(Stage.CONFIGURING, set_command, one(Key.PCL_DATA_TYPE, data_type)),
            _Step(Stage.CONFIGURING, set_command, one(Key.WORK_TARGET, WorkState.SAMPLING)),
            _Step(Stage.CONFIGURING, set_command, one(Key.IMU_DATA_ENABLE, 1)),
            _Step(Stage.VERIFYING, get_command, verified, optional=True),
        ]

    def _send(self, t_ns: int) -> list[Datagram]:
        """Return the present step's request, and arm its timer."""
        step = self._steps[self._step]
        self._attempts += 1
        self._t_next_ns = t_ns + self._timeout_ns
        if len(self._sequences) > 64:
            self._sequences.clear()
        lidar, own = self._settings.lidar_ports, self._settings.host_ports
        lidar_ip = self._settings.lidar_ip
        if step.command is not Command.SEARCH:
            return [self._request(t_ns, own.command, (lidar_ip, lidar.command), step)]
        # The command port answers even where the search is lost, so it is asked at the same time.
        targets = [lidar_ip, BROADCAST_IP] if self._settings.broadcast_search else [lidar_ip]
        searches = [self._request(t_ns, own.discovery, (ip, lidar.discovery), step) for ip in targets]
        identify = self._request(t_ns, own.command, (lidar_ip, lidar.command), self._steps[1])
        return [*searches, identify]

    def _request(self, t_ns: int, port: int, destination: tuple[str, int], step: _Step) -> Datagram:
        self._sequence = self._sequence % protocol.MAX_SEQUENCE + 1
        self._sequences.add(self._sequence)
        frame = CommandFrame(self._sequence, step.command, False, False, step.body)
        return Datagram(t_ns, (self._host_ip, port), destination, protocol.build_frame(frame))

    def _receive_answer(self, t_ns: int, frame: CommandFrame) -> list[Datagram]:
        if self._step >= len(self._steps) or frame.sequence not in self._sequences:
            return []
        step = self._steps[self._step]
        if step.stage is Stage.SEARCHING and frame.command == Command.SEARCH:
            answer = protocol.parse_search_answer(frame.data)
            self._info = replace(self._info, serial=answer.serial, device_type=answer.device_type)
            accepted = answer.return_code == ReturnCode.OK
        elif step.stage is Stage.SEARCHING and frame.command == Command.GET_PARAMETERS:
            protocol.parse_query_answer(frame.data)
            self._advance(t_ns)
            step = self._steps[self._step]
            accepted = self._judge_query(step, frame)
        elif frame.command != step.command:
            return []
        elif step.command is Command.GET_PARAMETERS:
            accepted = self._judge_query(step, frame)
        else:
            accepted = self._judge_setting(frame)
        if not accepted:
            return []
        self._advance(t_ns)
        return self._send(t_ns) if self._step < len(self._steps) else []

    def _judge_setting(self, frame: CommandFrame) -> bool:
        return_code, error_key = protocol.parse_set_answer(frame.data)
        if return_code in (ReturnCode.OK, ReturnCode.NEEDS_REBOOT):
            return True
        self._evidence = replace(self._evidence, refusal=(return_code, error_key))
        return False

    def _judge_query(self, step: _Step, frame: CommandFrame) -> bool:
        return_code, values = protocol.parse_query_answer(frame.data)
        if step.stage is Stage.IDENTIFYING:
            if Key.FIRMWARE_TYPE not in values:
                self._evidence = replace(self._evidence, refusal=(return_code, int(Key.FIRMWARE_TYPE)))
                return False
            self._info = with_parameters(self._info, values.items())
            return self._info.firmware_type != LOADER
        if Key.POINT_HOST not in values or Key.IMU_HOST not in values:
            self._evidence = replace(self._evidence, refusal=(return_code, int(Key.POINT_HOST)))
            return False
        for key in (Key.POINT_HOST, Key.IMU_HOST):
            found = protocol.parse_stream_address(values[key])
            if (found.ip, found.port) != (self._wanted[key].ip, self._wanted[key].port):
                self._evidence = replace(self._evidence, other_host=f"{found.ip}:{found.port}")
                # Another program wrote its own address in between: set ours again, after a pause.
                self._step = next(i for i, s in enumerate(self._steps) if s.stage is Stage.ADDRESSING)
                self._sequences.clear()
                return False
        self._evidence = replace(self._evidence, other_host="")
        return True

    def _give_up_waiting(self, t_ns: int) -> None:
        """Skip a query that the sensor does not know; search anew when it answers nothing at all."""
        step, evidence = self._steps[self._step], self._evidence
        if step.stage is Stage.IDENTIFYING and self._info.firmware_type == LOADER:
            return
        limit = SILENT_QUERY_ATTEMPTS if evidence.refusal is None else REFUSED_QUERY_ATTEMPTS
        if step.optional and self._attempts >= limit:
            self._advance(t_ns)
        elif self._step and self._attempts >= SILENT_ATTEMPTS and evidence.refusal is None:
            self._restart()

    def _advance(self, t_ns: int) -> None:
        self._t_configured_ns = t_ns
        self._move(self._step + 1)

    def _move(self, step: int) -> None:
        self._step = step
        self._sequences.clear()
        self._attempts = 0
        self._t_next_ns = None
        self._evidence = replace(self._evidence, refusal=None)

    def _restart(self) -> None:
        self._reruns += 1
        self._t_state_ns = None
        self._move(0)

    def _data_flows(self, t_ns: int) -> bool:
        limit_ns = t_ns - self._settings.silence_timeout_ms * 1_000_000
        times = (self._t_points_ns, self._t_imu_ns)
        return all(t is not None and t >= limit_ns for t in times)

    def _await_data(self, t_ns: int) -> None:
        have_points = self._t_points_ns is not None and self._t_points_ns >= self._t_configured_ns
        have_imu = self._t_imu_ns is not None and self._t_imu_ns >= self._t_configured_ns
        self._evidence = replace(self._evidence, have_points=have_points, have_imu=have_imu)
        if have_points and have_imu:
            self._evidence = replace(self._evidence, rounds_without_data=0, unconfirmed=None)
            self._move(len(self._steps) + 1)
            return
        starting = self._info.work_state in (WorkState.SELF_CHECK, WorkState.MOTOR_STARTUP)
        state_age_limit_ns = self._settings.state_silence_timeout_ms * 1_000_000
        if starting and self._t_state_ns is not None and t_ns - self._t_state_ns < state_age_limit_ns:
            self._t_configured_ns = t_ns
        if t_ns - self._t_configured_ns > self._settings.data_timeout_ms * 1_000_000:
            rounds = self._evidence.rounds_without_data + 1
            self._evidence = replace(self._evidence, rounds_without_data=rounds)
            self._restart()

    def _watch_silence(self, t_ns: int) -> None:
        state_limit_ns = self._settings.state_silence_timeout_ms * 1_000_000
        state_silent = self._t_state_ns is not None and t_ns - self._t_state_ns > state_limit_ns
        if state_silent or not self._data_flows(t_ns):
            self._restart()

    def _remember_stranger(self, ip: str, frame: CommandFrame) -> None:
        serial = ""
        if frame.command == Command.SEARCH and frame.acknowledges:
            serial = protocol.parse_search_answer(frame.data).serial
        elif frame.command == Command.PUSH:
            serial = with_parameters(LidarInfo(), protocol.parse_parameters(frame.data)).serial
        strangers = dict(self._evidence.strangers)
        if ip in strangers or len(strangers) < MAX_STRANGERS:
            strangers[ip] = serial or strangers.get(ip, "")
            self._evidence = replace(self._evidence, strangers=tuple(strangers.items()))
