"""Flights of the simulated quadrotor with the simulated Mid-360, as sensor events and truth."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample, LidarScan
from sitl import dynamics
from sitl.bench.courses import Course as Course
from sitl.bench.courses import field as field
from sitl.bench.courses import hall as hall
from sitl.kinematics import BodyTrajectory, Kinematics
from sitl.sensors.imu import ImuModel, ImuSettings
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.slots import SLOT_PERIOD_NS, SLOTS_PER_PACKET, InertialSlot, PointSlots

T_BODY_LIDAR = Pose.of([0.06, 0.0, 0.08], rotation.IDENTITY)
T_LIDAR_IMU = Pose.of([0.011, 0.02329, -0.04412], rotation.IDENTITY)
CLOCK_OFFSET_NS = 5_000_000_000
SCAN_NS = 100_000_000
_REST_S = 2.5
_SLOTS_PER_STEP = dynamics.STEP_NS // SLOT_PERIOD_NS


@dataclass(frozen=True, slots=True, eq=False)
class FlightStep:
    """One step of a flight.

    Attributes:
        t_sensor_ns: its end.
        truth: the body's motion then.
        events: what the sensors reported during the step, in order of arrival; none in the first step,
            which only tells where the flight begins.
        slots, sample: the same as the sensor's protocol carries it; none in the first step.
    """

    t_sensor_ns: int
    truth: Kinematics
    events: tuple[ImuSample | LidarScan, ...]
    slots: PointSlots | None = None
    sample: InertialSlot | None = None


@dataclass(frozen=True, eq=False)
class Flight:
    """What the sensors reported and what was true.

    Attributes:
        events: in order of arrival.
        t_sensor_ns: (n,) times of the truth.
        p_world: (n, 3) body positions.
        q_world_body: (n, 4) body attitudes.
        v_world: (n, 3) body velocities.
    """

    events: list[ImuSample | LidarScan]
    t_sensor_ns: NDArray[np.int64]
    p_world: FloatArray
    q_world_body: FloatArray
    v_world: FloatArray

    def truth(self, t_sensor_ns: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return p (n, 3), q (n, 4), v (n, 3) of the body in the map at sensor times of the truth's grid."""
        index = np.searchsorted(self.t_sensor_ns, t_sensor_ns)
        back = rotation.from_yaw(-rotation.yaw_of(self.q_world_body[0]))
        return (
            rotation.rotate(back, self.p_world[index] - self.p_world[0]),
            rotation.multiply(back, self.q_world_body[index]),
            rotation.rotate(back, self.v_world[index]),
        )


def stream(
    course: Course,
    duration_s: float,
    rng: np.random.Generator,
    imu: ImuSettings | None = None,
    lidar: Mid360Settings | None = None,
) -> Iterator[FlightStep]:
    """Simulate one flight step by step: rest, take-off, then rounds with a slow turn about the vertical.

    Args:
        course: world and rounds.
        duration_s: from power-on.
        rng: of sensor noise.
        imu: the inertial chip, the course's own by default.
        lidar: the scanner.
    """
    imu_model = ImuModel(rng, T_BODY_LIDAR, imu or course.imu)
    lidar_model = Mid360Model(rng, T_BODY_LIDAR, lidar or Mid360Settings())
    state = dynamics.at_rest(
        np.array([[course.half_axes_m[0], 0.0, 0.0]]), np.array([0.4]), settings=course.vehicle
    )
    yield FlightStep(0, state.kinematics(0), ())
    pieces: list[PointSlots] = []
    sequence = 0
    for index in range(round(duration_s / dynamics.STEP_S)):
        start_ns, end_ns = index * dynamics.STEP_NS, (index + 1) * dynamics.STEP_NS
        after = dynamics.step(
            state,
            _command(course, state, index * dynamics.STEP_S),
            state.v_world,
            np.zeros((1, 3)),
            settings=course.vehicle,
        )
        start, end = state.kinematics(0), after.kinematics(0)
        inertial = imu_model.sample(start_ns, start, end_ns, end, float(after.thrust[0]))
        slots = lidar_model.measure(
            index * _SLOTS_PER_STEP,
            _SLOTS_PER_STEP,
            BodyTrajectory.between(start_ns, start, end_ns, end),
            course.world,
        )
        pieces.append(slots)
        sample = ImuSample(end_ns + CLOCK_OFFSET_NS, end_ns, inertial.gyro_imu, inertial.accel_imu)
        events: tuple[ImuSample | LidarScan, ...] = (sample,)
        if end_ns % SCAN_NS == 0:
            events = (sample, cut_scan(pieces, sequence, end_ns))
            pieces, sequence = [], sequence + 1
        yield FlightStep(end_ns, end, events, slots, inertial)
        state = after


def fly(
    course: Course,
    duration_s: float,
    rng: np.random.Generator,
    imu: ImuSettings | None = None,
    lidar: Mid360Settings | None = None,
) -> Flight:
    """Return a whole flight at once; see `stream`."""
    steps = list(stream(course, duration_s, rng, imu, lidar))
    return Flight(
        [event for step in steps for event in step.events],
        np.array([step.t_sensor_ns for step in steps], dtype=np.int64),
        np.array([step.truth.p_world for step in steps]),
        np.array([step.truth.q_world_body for step in steps]),
        np.array([step.truth.v_world for step in steps]),
    )


def _command(course: Course, state: dynamics.QuadrotorState, t: float) -> dynamics.QuadrotorCommand:
    """Follow the ellipse with a velocity that leads along it and pulls towards it."""
    a, b = course.half_axes_m
    x, y, z = state.p_world[0]
    v = np.zeros(3)
    if t > _REST_S:
        wanted = course.height_m + course.height_sway_m * np.sin(course.height_sway_rate * t)
        v[2] = np.clip(1.5 * (wanted - z), -course.descent_max, course.climb_max)
    if t > _REST_S + 2.0:
        angle = np.arctan2(y / b, x / a)
        tangent = np.array([-a * np.sin(angle), b * np.cos(angle)])
        pull = np.array([a * np.cos(angle), b * np.sin(angle)]) - [x, y]
        v[:2] = course.speed * tangent / np.linalg.norm(tangent) + 0.8 * pull
    yaw_rate = course.yaw_rate + course.yaw_sway * np.sin(0.8 * t) if t > _REST_S + 2.0 else 0.0
    return dynamics.QuadrotorCommand(v[None, :], np.array([yaw_rate]), np.array([t > _REST_S - 0.3]))


def cut_scan(pieces: list[PointSlots], sequence: int, end_ns: int) -> LidarScan:
    """Return the scan that ends at this sensor time, made of the slots of its steps."""
    points = np.concatenate([piece.points_lidar for piece in pieces])
    hit = np.any(points != 0.0, axis=1)
    packets = -(-len(points) // SLOTS_PER_PACKET)
    return LidarScan(
        t_ns=end_ns + CLOCK_OFFSET_NS,
        sequence=sequence,
        t_sensor_start_ns=end_ns - SCAN_NS,
        t_sensor_end_ns=end_ns,
        clock_offset_ns=CLOCK_OFFSET_NS,
        points_lidar=points[hit].astype(np.float32),
        offsets_ns=(np.arange(len(points), dtype=np.int64) * SLOT_PERIOD_NS)[hit].astype(np.int32),
        reflectivity=np.concatenate([piece.reflectivity for piece in pieces])[hit],
        tags=np.concatenate([piece.tags for piece in pieces])[hit],
        packets=packets,
        packets_expected=packets,
    )
