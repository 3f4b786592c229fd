"""What the exchange hands on, in which order, what it keeps in the log, and what must not leave."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from companion.drivers.px4_commands import DO_SET_MODE, NAV_LAND
from companion.drivers.px4_session import Px4Session
from companion.exchange import Exchange
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.metadata import FlightMetadata
from companion.logs.reader import FlightRecording
from companion.logs.records import FrameSummary, QueuePlace, Statistics
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import (
    Authorisation,
    ControlEvent,
    Datagram,
    FlightState,
    ImuSample,
    LidarScan,
    MavlinkMessage,
    ModeRequest,
    Odometry,
    OdometryStatus,
    Output,
    PerceptionUpdate,
    PlanUpdate,
    SensorEvent,
    Setpoint,
    Severity,
    StateChange,
    StatusText,
    Surroundings,
    Tick,
    VehicleMode,
    VehicleState,
)
from companion.perception.neighbours import nobody
from companion.pipeline import Pipeline
from companion.safety.settings import SafetySettings
from tests.drivers.px4_peer import (
    MS,
    STATION,
    SYSTEM,
    T0,
    a_setpoint,
    an_odometry,
    command,
    connected,
    message,
    settings,
)
from tests.hold_role import HoldRole
from tests.pipeline_rig import NoTracker

DATAGRAM = Datagram(T0, ("127.0.0.2", 56300), ("127.0.0.1", 56301), b"\x00" * 24)

SCAN = LidarScan(
    t_ns=T0,
    sequence=3,
    t_sensor_start_ns=0,
    t_sensor_end_ns=100 * MS,
    clock_offset_ns=5,
    points_lidar=np.ones((2, 3), np.float32),
    offsets_ns=np.zeros(2, np.int32),
    reflectivity=np.zeros(2, np.uint8),
    tags=np.zeros(2, np.uint8),
    packets=207,
    packets_expected=208,
)


class NoEstimator:
    def handle(self, event: SensorEvent) -> list[PerceptionUpdate]:
        return []


SAMPLE = ImuSample(T0, 7, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 9.81]))


class ScriptedPipeline(Pipeline):
    """Remembers what it is asked to decide, and answers each tick with what was put in."""

    def __init__(self, sources: tuple[str, ...] = ("ground_station",)) -> None:
        super().__init__(
            estimator=NoEstimator(),
            tracker=NoTracker(),
            role=HoldRole(),
            safety=SafetySettings(),
            authorisation_sources=sources,
        )
        self.decided: list[ControlEvent] = []
        self.wishes: list[Output] = []
        self.stops: list[int] = []

    def decide(self, event: ControlEvent) -> list[Output]:
        self.decided.append(event)
        outputs = super().decide(event)
        return self.wishes if isinstance(event, Tick) else outputs

    def request_stop(self, t_ns: int) -> None:
        self.stops.append(t_ns)


@dataclass
class Rig:
    """An exchange between a scripted pipeline, a real session and a real log."""

    folder: Path
    pipeline: ScriptedPipeline = field(default_factory=ScriptedPipeline)
    session: Px4Session = field(default_factory=connected)

    def __post_init__(self) -> None:
        metadata = FlightMetadata(vehicle="uav1", role="leader", mode="flight", configuration="")
        path = self.folder / "flight.mcap"
        self.log = FlightLog(path, LogSettings(imu=True), metadata, threaded=False)
        self.exchange = Exchange(self.pipeline, self.session, self.log)

    def tick(self, *wishes: Output, t_ns: int = T0) -> list[MavlinkMessage]:
        self.pipeline.wishes = list(wishes)
        return self.exchange.tick(t_ns)

    def recorded(self, *wanted: Channel) -> list[object]:
        self.log.close()
        return [entry.message for entry in FlightRecording(self.log.path).messages(*wanted)]


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    yield rig
    rig.log.close()


def names(messages: list[MavlinkMessage]) -> list[str]:
    return [message.name for message in messages]


class TestPlaces:
    def test_what_perception_never_saw_is_kept_by_its_stamps(self, rig: Rig) -> None:
        rig.exchange.record_place(SCAN, 4)
        rig.exchange.record_place(SCAN, None)
        rig.exchange.record_place(SAMPLE, 5)
        rig.exchange.record_place(SAMPLE, None)
        assert rig.recorded(channels.QUEUE_PLACE) == [
            QueuePlace(SCAN.t_ns, "scan", SCAN.t_sensor_start_ns, -1),
            QueuePlace(SAMPLE.t_ns, "imu", SAMPLE.t_sensor_ns, -1),
        ]


class TestTick:
    def test_the_pipeline_sees_what_the_ground_said_then_the_vehicle_then_the_tick(self, rig: Rig) -> None:
        acknowledgements = rig.exchange.receive(command(), T0 - 5 * MS)
        assert names(acknowledgements) == ["COMMAND_ACK"]
        assert rig.pipeline.decided == []
        rig.tick()
        assert [type(event) for event in rig.pipeline.decided] == [Authorisation, VehicleState, Tick]
        granted = rig.pipeline.decided[0]
        assert granted == Authorisation(T0 - 5 * MS, True, "ground_station")

    def test_the_log_keeps_control_events_in_the_order_of_handling(self, rig: Rig) -> None:
        rig.exchange.receive(command(), T0)
        rig.exchange.update(an_odometry(T0), T0 + MS)
        rig.tick(t_ns=T0 + 2 * MS)
        kept = rig.recorded(*channels.JOURNAL)
        assert [type(event) for event in kept] == [Odometry, Authorisation, VehicleState, Tick]
        assert [type(event) for event in rig.pipeline.decided] == [type(event) for event in kept]

    def test_a_setpoint_leaves_as_one_message_and_is_kept(self, rig: Rig) -> None:
        sent = rig.tick(a_setpoint(T0))
        assert names(sent).count("SET_POSITION_TARGET_LOCAL_NED") == 1
        (kept,) = rig.recorded(channels.SETPOINT)
        assert isinstance(kept, Setpoint)
        np.testing.assert_array_equal(kept.v_map, [1.0, 2.0, 3.0])

    @pytest.mark.parametrize(
        "setpoint",
        [
            a_setpoint(T0 - 300 * MS),
            a_setpoint(T0, (float("nan"), 0.0, 0.0)),
            a_setpoint(T0, yaw_rate=float("inf")),
            replace(a_setpoint(T0), t_data_ns=T0 - 300 * MS),
        ],
        ids=["decided too long ago", "not a number", "infinite", "moves on old data"],
    )
    def test_a_setpoint_that_must_not_leave_is_neither_sent_nor_kept(
        self, rig: Rig, setpoint: Setpoint
    ) -> None:
        assert "SET_POSITION_TARGET_LOCAL_NED" not in names(rig.tick(setpoint))
        assert rig.recorded(channels.SETPOINT) == []

    def test_without_an_autopilot_nothing_but_the_heartbeat_leaves(self, tmp_path: Path) -> None:
        rig = Rig(tmp_path, session=Px4Session(settings()))
        assert names(rig.tick(a_setpoint(T0), an_odometry(T0))) == ["HEARTBEAT"]
        assert rig.recorded(channels.SETPOINT) == []

    @pytest.mark.parametrize(
        ("mode", "number"), [(VehicleMode.OFFBOARD, DO_SET_MODE), (VehicleMode.LAND, NAV_LAND)]
    )
    def test_a_mode_request_becomes_a_command(self, rig: Rig, mode: VehicleMode, number: int) -> None:
        sent = rig.tick(ModeRequest(T0, mode))
        commands = [message for message in sent if message.fields.get("command") == number]
        assert [message.fields["target_system"] for message in commands] == [SYSTEM]
        assert rig.recorded(channels.MODE_REQUEST) == [ModeRequest(T0, mode)]

    def test_a_text_leaves_once_though_all_repetitions_are_kept(self, rig: Rig) -> None:
        text = StatusText(T0, Severity.INFO, "ready")
        sent = rig.tick(text, text)
        assert [message.fields.get("text") for message in sent].count("CMP: ready") == 1
        assert rig.recorded(channels.LOG).count(text) == 2

    def test_what_happens_to_the_link_is_kept_and_announced(self, rig: Rig) -> None:
        sent = [message.fields["text"] for message in rig.tick() if message.name == "STATUSTEXT"]
        kept = [entry.text for entry in rig.recorded(channels.LOG) if isinstance(entry, StatusText)]
        assert kept == ["autopilot 7 connected"]
        assert sent == ["CMP: autopilot 7 connected"]

    def test_what_the_autopilot_says_is_kept_and_not_repeated_to_the_ground(self, rig: Rig) -> None:
        rig.tick()
        rig.exchange.receive(
            message("STATUSTEXT", severity=4, text="Low battery", id=0, chunk_seq=0), T0 + MS
        )
        assert "STATUSTEXT" not in names(rig.tick(t_ns=T0 + 2 * MS))
        texts = [entry.text for entry in rig.recorded(channels.LOG) if isinstance(entry, StatusText)]
        assert [text for text in texts if "Low battery" in text]

    def test_state_changes_and_plans_are_kept_and_send_nothing(self, rig: Rig) -> None:
        before = names(rig.tick())
        change = StateChange(T0, FlightState.STARTING, FlightState.STANDBY, "ready")
        plan = PlanUpdate(T0, np.zeros((2, 3)), np.array([1.0, 2.0, 3.0]), 0, "planned")
        after = rig.tick(change, plan, t_ns=T0 + MS)
        assert set(names(after)) <= set(before)
        assert rig.recorded(channels.STATE) == [change]
        assert len(rig.recorded(channels.PLAN)) == 1

    def test_what_a_follower_was_given_is_kept_and_sends_nothing(self, rig: Rig) -> None:
        before = names(rig.tick())
        seen = Surroundings(T0, nobody(T0, 6), T0 - MS, 0.5, np.full((72, 12), np.inf))
        assert set(names(rig.tick(seen, t_ns=T0 + MS))) <= set(before)
        assert len(rig.recorded(channels.GIVEN)) == len(rig.recorded(channels.GRID)) == 1


class TestEstimates:
    def test_odometry_is_kept_as_it_was_estimated_and_leaves_as_external_vision(self, rig: Rig) -> None:
        sent = rig.exchange.update(an_odometry(T0, quality=77), T0)
        assert names(sent) == ["ODOMETRY"]
        assert sent[0].fields["quality"] == 77
        (kept,) = rig.recorded(channels.ODOMETRY)
        assert isinstance(kept, Odometry)
        assert kept.quality == 77

    @pytest.mark.parametrize("status", [OdometryStatus.INITIALISING, OdometryStatus.LOST])
    def test_odometry_that_is_not_usable_is_kept_and_does_not_leave(
        self, rig: Rig, status: OdometryStatus
    ) -> None:
        assert rig.exchange.update(an_odometry(T0, status=status), T0) == []
        assert len(rig.recorded(channels.ODOMETRY)) == 1


class TestAuthorisation:
    def test_a_refusal_says_why_and_reaches_the_ground(self, rig: Rig) -> None:
        authorisation = Authorisation(T0, True, "command")
        assert rig.exchange.refusal(authorisation) == "command not permitted"
        (text,) = rig.exchange.authorise(authorisation)
        assert text.name == "STATUSTEXT"
        assert text.fields["text"] == "CMP: engage refused: command not permitted"
        assert rig.recorded(channels.AUTHORISATION) == [authorisation]

    def test_withdrawing_is_never_refused(self, rig: Rig) -> None:
        withdrawal = Authorisation(T0, False, "command")
        assert rig.exchange.refusal(withdrawal) == ""
        assert rig.exchange.authorise(withdrawal) == []
        assert rig.recorded(channels.AUTHORISATION) == [withdrawal]

    def test_a_stranger_is_denied_and_nothing_is_decided(self, rig: Rig) -> None:
        (answer,) = rig.exchange.receive(command(sender=(STATION[0], STATION[1] + 1)), T0)
        assert answer.fields["result"] != 0
        rig.tick()
        assert not any(isinstance(event, Authorisation) for event in rig.pipeline.decided)


class TestTheRest:
    def test_what_arrives_and_what_has_left_is_kept_on_its_own_channel(self, rig: Rig) -> None:
        arrived, left = message("PING", seq=1), MavlinkMessage("HEARTBEAT", SYSTEM, 191, {"type": 18})
        rig.exchange.receive(arrived, T0)
        rig.exchange.record_sent([left, left], T0 + MS)
        assert rig.recorded(channels.MAVLINK_RX) == [arrived]
        assert rig.recorded(channels.MAVLINK_TX) == [left, left]

    def test_deciding_records_nothing_as_sent(self, rig: Rig) -> None:
        assert rig.tick(a_setpoint(T0))
        assert rig.recorded(channels.MAVLINK_TX) == []

    def test_a_datagram_is_kept_byte_by_byte(self, rig: Rig) -> None:
        rig.exchange.record_datagram(DATAGRAM)
        assert rig.recorded(channels.LIDAR_PACKETS) == [(DATAGRAM,)]

    def test_of_a_scan_its_summary_is_kept_and_of_a_sample_everything(self, rig: Rig) -> None:
        sample = SAMPLE
        rig.exchange.record_sensor_event(sample)
        rig.exchange.record_sensor_event(SCAN)
        (kept,) = rig.recorded(channels.IMU)
        assert isinstance(kept, ImuSample)
        np.testing.assert_array_equal(kept.gyro_imu, sample.gyro_imu)
        (summary,) = rig.recorded(channels.LIDAR_FRAMES)
        assert isinstance(summary, FrameSummary)
        assert (summary.sequence, summary.points, summary.packets_expected) == (3, 2, 208)

    def test_of_counters_all_numbers_are_kept_under_their_source(self, rig: Rig) -> None:
        @dataclass(frozen=True, slots=True)
        class Counters:
            packets: int
            share: float
            names: tuple[str, ...]
            first_ns: int | None

        rig.exchange.record_counters("lidar", Counters(5, 0.25, ("a",), None), T0)
        assert rig.recorded(channels.STATISTICS) == [Statistics(T0, "lidar", {"packets": 5, "share": 0.25})]

    def test_a_stop_from_outside_reaches_the_pipeline(self, rig: Rig) -> None:
        rig.exchange.request_stop(T0)
        assert rig.pipeline.stops == [T0]

    def test_the_state_is_the_pipelines(self, rig: Rig) -> None:
        assert rig.exchange.state is rig.pipeline.state is FlightState.STARTING
