"""A pipeline with everything it hears played to it."""

from dataclasses import dataclass, field, replace

import numpy as np

from companion.geometry import rotation
from companion.messages import (
    Authorisation,
    LandedState,
    NeighbourTracks,
    Odometry,
    OdometryStatus,
    Output,
    PlanUpdate,
    RegisteredScan,
    SensorEvent,
    Setpoint,
    StatusText,
    Tick,
    VehicleMode,
    VehicleState,
    VelocityCommand,
)
from companion.pipeline import Pipeline
from companion.safety.settings import SafetySettings

PERIOD_NS = 20_000_000
NO_BYTES = np.zeros(0, np.uint8)
NO_AGES = np.zeros(0, np.int32)
WISH = np.array([1.0, 0.0, 0.0])


@dataclass
class Decision:
    command: VelocityCommand
    plan: PlanUpdate | None = None
    finished: bool = False
    remarks: tuple[StatusText, ...] = ()


@dataclass
class ForwardRole:
    """Always wants one velocity; can be told that it has finished."""

    wish: np.ndarray = field(default_factory=lambda: WISH.copy())
    finished: bool = False
    resets: int = 0
    broken: bool = False
    counters: object | None = None
    remarks: tuple[StatusText, ...] = ()

    def meet(self, tracks: NeighbourTracks) -> None: ...

    def observe(self, scan: RegisteredScan) -> None: ...

    def decide(self, odometry: Odometry, t_ns: int) -> Decision:
        if self.broken:
            raise ZeroDivisionError
        return Decision(VelocityCommand(odometry.t_ns, self.wish, 0.0), None, self.finished, self.remarks)

    def reset(self, odometry: Odometry) -> None:
        self.resets += 1


class NoEstimator:
    def handle(self, event: SensorEvent) -> list[Odometry | RegisteredScan]:
        return []


class NoTracker:
    def observe(self, scan: RegisteredScan) -> NeighbourTracks:
        return NeighbourTracks(scan.odometry.t_ns, scan.sequence, ())


class Rig:
    """A pipeline, the odometry and the vehicle it hears of, and the time."""

    def __init__(self, sources: tuple[str, ...] = ("command",)) -> None:
        self.role = ForwardRole()
        self.pipeline = Pipeline(
            estimator=NoEstimator(),
            tracker=NoTracker(),
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
        self.scans_run = True

    def tick(self, count: int = 1) -> list[Output]:
        outputs: list[Output] = []
        for _ in range(count):
            self.t_ns += PERIOD_NS
            if self.odometry_runs:
                self.odometry = replace(self.odometry, t_ns=self.t_ns)
                self.pipeline.decide(self.odometry)
            if self.scans_run:
                self.pipeline.decide(
                    RegisteredScan(
                        self.t_ns, 0, np.zeros((0, 3), np.float32), NO_BYTES, self.odometry, NO_AGES
                    )
                )
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
