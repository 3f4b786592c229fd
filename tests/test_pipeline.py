"""The pipeline decides from events alone: who may command, what is sent, when nothing is."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import (
    Authorisation,
    FlightState,
    ImuSample,
    LandedState,
    LidarScan,
    ModeRequest,
    Odometry,
    OdometryStatus,
    Output,
    PlanUpdate,
    RegisteredScan,
    Setpoint,
    StateChange,
    StatusText,
    Tick,
    VehicleMode,
    VehicleState,
    VelocityCommand,
)
from companion.pipeline import Pipeline
from companion.safety.settings import SafetySettings

PERIOD_NS = 20_000_000
WISH = np.array([1.0, 0.0, 0.0])


@dataclass
class Decision:
    command: VelocityCommand
    plan: PlanUpdate | None = None
    finished: bool = False


@dataclass
class ForwardRole:
    """Always wants one velocity; can be told that it has finished."""

    wish: np.ndarray = field(default_factory=lambda: WISH.copy())
    finished: bool = False
    resets: int = 0

    def observe(self, scan: RegisteredScan) -> None: ...

    def decide(self, odometry: Odometry, t_ns: int) -> Decision:
        return Decision(VelocityCommand(odometry.t_ns, self.wish, 0.0), None, self.finished)

    def reset(self, odometry: Odometry) -> None:
        self.resets += 1


class NoEstimator:
    def handle(self, event: ImuSample | LidarScan) -> list[Odometry | RegisteredScan]:
        return []


class Rig:
    """A pipeline, the odometry and the vehicle it hears of, and the time."""

    def __init__(self, sources: tuple[str, ...] = ("command",)) -> None:
        self.role = ForwardRole()
        self.pipeline = Pipeline(
            estimator=NoEstimator(),
            role=self.role,
            safety=SafetySettings(),
            authorisation_sources=sources,
        )
        self.t_ns = 1_000_000_000
        self.odometry = Odometry(
            t_ns=0,
            t_sensor_ns=0,
            p_map=np.array([0.0, 0.0, 1.5]),
            q_map_body=rotation.IDENTITY,
            v_map=np.zeros(3),
            omega_body=np.zeros(3),
            covariance_pose=np.eye(6),
            covariance_velocity=np.eye(3),
            quality=90,
            reset_counter=0,
            status=OdometryStatus.TRACKING,
        )
        self.vehicle = VehicleState(
            t_ns=0,
            connected=True,
            armed=False,
            mode=VehicleMode.HOLD,
            landed=LandedState.ON_GROUND,
            failsafe=False,
            t_local_ns=0,
            p_map=np.zeros(3),
            v_map=np.zeros(3),
            q_map_body=rotation.IDENTITY,
            estimator_reset_counter=0,
            mode_changes=0,
        )
        self.odometry_runs = True

    def tick(self, count: int = 1) -> list[Output]:
        outputs: list[Output] = []
        for _ in range(count):
            self.t_ns += PERIOD_NS
            if self.odometry_runs:
                self.odometry = replace(self.odometry, t_ns=self.t_ns)
                self.pipeline.decide(self.odometry)
            self.vehicle = replace(self.vehicle, t_ns=self.t_ns, t_local_ns=self.t_ns)
            outputs.extend(self.pipeline.decide(self.vehicle))
            outputs.extend(self.pipeline.decide(Tick(self.t_ns)))
        return outputs

    def set(self, mode: VehicleMode, *, airborne: bool = True) -> None:
        landed = LandedState.IN_AIR if airborne else LandedState.ON_GROUND
        self.vehicle = replace(self.vehicle, mode=mode, armed=airborne, landed=landed)

    def authorise(self, source: str = "command", *, granted: bool = True) -> list[Output]:
        return self.pipeline.decide(Authorisation(self.t_ns, granted, source))

    def airborne(self) -> None:
        self.tick()
        self.set(VehicleMode.TAKEOFF)
        self.tick()

    def active(self) -> None:
        self.airborne()
        self.authorise()
        self.tick(30)
        self.set(VehicleMode.OFFBOARD)
        self.tick()


def setpoints(outputs: list[Output]) -> list[Setpoint]:
    return [output for output in outputs if isinstance(output, Setpoint)]


def texts(outputs: list[Output]) -> list[str]:
    return [output.text for output in outputs if isinstance(output, StatusText)]


def test_nothing_is_sent_before_an_authorisation() -> None:
    rig = Rig()
    rig.airborne()
    outputs = rig.tick(100)
    assert rig.pipeline.state is FlightState.READY
    assert not setpoints(outputs)
    assert not [output for output in outputs if isinstance(output, ModeRequest)]


def test_engaging_streams_zero_for_half_a_second_before_asking_for_offboard() -> None:
    rig = Rig()
    rig.airborne()
    rig.authorise()
    outputs = rig.tick(30)
    request = next(output for output in outputs if isinstance(output, ModeRequest))
    before = outputs[: outputs.index(request)]
    assert request.mode is VehicleMode.OFFBOARD
    assert len(setpoints(before)) >= 25
    assert all(not output.v_map.any() for output in setpoints(outputs))
    assert rig.role.resets == 1


def test_the_role_commands_once_the_autopilot_is_in_offboard() -> None:
    rig = Rig()
    rig.active()
    sent = setpoints(rig.tick(50))
    assert rig.pipeline.state is FlightState.ACTIVE
    np.testing.assert_allclose(sent[-1].v_map, WISH)
    assert np.linalg.norm(sent[0].v_map) <= 4.0 * 0.02 * 2 + 1e-9


def test_an_authorisation_on_the_ground_is_refused_with_its_reason() -> None:
    rig = Rig()
    rig.tick(3)
    assert texts(rig.authorise()) == ["engage refused: vehicle is not flying"]
    rig.set(VehicleMode.TAKEOFF)
    rig.tick(100)
    assert rig.pipeline.state is FlightState.READY


def test_a_source_that_the_profile_does_not_name_is_refused() -> None:
    rig = Rig()
    rig.airborne()
    assert texts(rig.authorise("ground_station")) == ["engage refused: ground_station not permitted"]
    rig.tick(5)
    assert rig.pipeline.state is FlightState.READY


def test_a_mode_switch_authorises_only_where_the_profile_permits_it() -> None:
    permitted, forbidden = Rig(("mode_switch",)), Rig(("command",))
    for rig in (permitted, forbidden):
        rig.airborne()
        rig.tick(5)
        rig.set(VehicleMode.OFFBOARD)
        rig.tick(5)
    assert permitted.pipeline.state is FlightState.ACTIVE
    assert forbidden.pipeline.state is FlightState.READY


def test_a_takeover_ends_the_stream_and_flicking_back_does_not_resume_it() -> None:
    rig = Rig(("command", "mode_switch"))
    rig.active()
    rig.set(VehicleMode.POSITION)
    assert not setpoints(rig.tick(10))
    assert rig.pipeline.state is FlightState.PILOT
    rig.set(VehicleMode.OFFBOARD)
    assert not setpoints(rig.tick(100))
    assert rig.pipeline.state is FlightState.PILOT


def test_after_a_takeover_a_new_authorisation_starts_from_zero_again() -> None:
    rig = Rig()
    rig.active()
    rig.set(VehicleMode.POSITION)
    rig.tick(10)
    rig.authorise()
    sent = setpoints(rig.tick(10))
    assert rig.pipeline.state is FlightState.ENGAGING
    assert all(not output.v_map.any() for output in sent)
    assert rig.role.resets == 2


def test_a_failsafe_of_the_autopilot_is_never_fought() -> None:
    rig = Rig()
    rig.active()
    rig.vehicle = replace(rig.vehicle, mode=VehicleMode.LAND, failsafe=True)
    outputs = rig.tick(100)
    assert not setpoints(outputs)
    assert not [output for output in outputs if isinstance(output, ModeRequest)]
    assert "pilot: autopilot failsafe" in texts(outputs)


def test_stale_odometry_brakes_then_falls_silent() -> None:
    rig = Rig()
    rig.active()
    rig.tick(50)
    rig.odometry_runs = False
    holding = setpoints(rig.tick(40))
    states = [rig.pipeline.state]
    assert not holding[-1].v_map.any()
    rig.tick(40)
    states.append(rig.pipeline.state)
    assert states == [FlightState.HOLDING, FlightState.LOST]
    assert not setpoints(rig.tick(20))


def test_a_short_gap_of_the_odometry_ends_in_flying_on() -> None:
    rig = Rig()
    rig.active()
    rig.odometry_runs = False
    rig.tick(20)
    states = [rig.pipeline.state]
    rig.odometry_runs = True
    rig.tick(2)
    states.append(rig.pipeline.state)
    assert states == [FlightState.HOLDING, FlightState.ACTIVE]


def test_no_moving_setpoint_rests_on_data_older_than_200_ms() -> None:
    rig = Rig()
    rig.active()
    rig.odometry_runs = False
    for setpoint in setpoints(rig.tick(60)):
        if setpoint.reason == "role":
            assert setpoint.t_ns - setpoint.t_data_ns <= 200_000_000


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_a_role_that_goes_mad_moves_nothing_beyond_the_limits(bad: float) -> None:
    rig = Rig()
    rig.active()
    rig.role.wish = np.array([bad, 0.0, bad])
    for setpoint in setpoints(rig.tick(100)):
        assert np.isfinite(setpoint.v_map).all()
        assert np.linalg.norm(setpoint.v_map[:2]) <= 2.0 + 1e-9


def test_a_moved_map_ends_the_flight_by_landing() -> None:
    rig = Rig()
    rig.active()
    rig.odometry = replace(rig.odometry, reset_counter=1)
    outputs = rig.tick(2)
    requests = [output for output in outputs if isinstance(output, ModeRequest)]
    assert rig.pipeline.state is FlightState.LANDING
    assert [request.mode for request in requests] == [VehicleMode.LAND]


def test_a_finished_role_lands_and_the_flight_is_done_on_the_ground() -> None:
    rig = Rig()
    rig.active()
    rig.role.finished = True
    outputs = rig.tick(3)
    assert [output.mode for output in outputs if isinstance(output, ModeRequest)] == [VehicleMode.LAND]
    rig.set(VehicleMode.LAND)
    assert not setpoints(rig.tick(5))
    rig.set(VehicleMode.HOLD, airborne=False)
    rig.tick(2)
    assert rig.pipeline.state is FlightState.DONE


def test_a_process_that_wakes_up_in_the_air_only_listens() -> None:
    rig = Rig(("command", "mode_switch"))
    rig.set(VehicleMode.OFFBOARD)
    outputs = rig.tick(100)
    assert rig.pipeline.state is FlightState.LISTENING
    assert not setpoints(outputs)


def test_being_told_to_stop_brakes_for_a_second_and_ends_in_silence() -> None:
    rig = Rig()
    rig.active()
    rig.tick(50)
    rig.pipeline.request_stop(rig.t_ns)
    braking = setpoints(rig.tick(45))
    assert not braking[-1].v_map.any()
    assert not setpoints(rig.tick(20)[5:])
    assert rig.pipeline.state is FlightState.LOST


def test_after_a_stall_nothing_is_sent_without_a_new_authorisation() -> None:
    rig = Rig()
    rig.active()
    rig.t_ns += 600_000_000
    assert not setpoints(rig.tick(50))
    assert rig.pipeline.state is FlightState.LOST


def test_a_withdrawn_authorisation_ends_the_stream() -> None:
    rig = Rig()
    rig.active()
    rig.authorise(granted=False)
    assert not setpoints(rig.tick(5))
    assert rig.pipeline.state is FlightState.PILOT


def test_every_change_of_state_is_announced() -> None:
    rig = Rig()
    rig.tick()
    rig.set(VehicleMode.TAKEOFF)
    outputs = rig.tick()
    change = next(output for output in outputs if isinstance(output, StateChange))
    assert (change.previous, change.current) == (FlightState.STANDBY, FlightState.READY)
    assert texts(outputs) == [f"ready: {change.reason}"]
