"""Flights of the simulated quadrotor with the simulated Mid-360, as sensor events and truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample, LidarScan
from sitl import dynamics
from sitl.kinematics import BodyTrajectory
from sitl.sensors.imu import ImuModel, ImuSettings
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.slots import SLOT_PERIOD_NS, SLOTS_PER_PACKET
from sitl.worlds.primitives import Box, Cylinder, Ground, World

T_BODY_LIDAR = Pose.of([0.06, 0.0, 0.08], rotation.IDENTITY)
T_LIDAR_IMU = Pose.of([0.011, 0.02329, -0.04412], rotation.IDENTITY)
CLOCK_OFFSET_NS = 5_000_000_000
SCAN_NS = 100_000_000
_REST_S = 2.5
_SLOTS_PER_STEP = dynamics.STEP_NS // SLOT_PERIOD_NS


@dataclass(frozen=True)
class Course:
    """An ellipse to be flown around, and the world around it."""

    world: World
    half_axes_m: tuple[float, float]
    height_m: float
    speed: float
    yaw_rate: float


def field(rng: np.random.Generator, pillars: int = 50) -> Course:
    """Return a field of pillars on a plane, free around the course."""
    placed: list[tuple[float, float, float]] = []
    while len(placed) < pillars:
        x, y = rng.uniform(-25.0, 25.0, 2)
        clear = abs(np.hypot(x, y / 0.7) - 12.0) > 2.5
        if clear and all(np.hypot(x - other[0], y - other[1]) > 1.8 for other in placed):
            placed.append((float(x), float(y), float(rng.uniform(0.2, 0.5))))
    cylinders = [
        Cylinder(
            start_world_m=(x, y, 0.0),
            end_world_m=(x, y, 5.0),
            radius_m=radius,
            reflectivity=float(rng.uniform(0.1, 0.8)),
        )
        for x, y, radius in placed
    ]
    return Course(World.of([Ground(), *cylinders]), (12.0, 8.4), 2.0, 2.5, 0.3)


def hall() -> Course:
    """Return a hall of 16 m x 12 m x 4.5 m with boxes in it."""
    surfaces = [
        ((0.0, 6.1, 2.25), (16.4, 0.2, 4.5)),
        ((0.0, -6.1, 2.25), (16.4, 0.2, 4.5)),
        ((8.1, 0.0, 2.25), (0.2, 12.4, 4.5)),
        ((-8.1, 0.0, 2.25), (0.2, 12.4, 4.5)),
        ((0.0, 0.0, 4.6), (16.4, 12.4, 0.2)),
        ((-6.7, -4.7, 1.0), (1.5, 1.5, 2.0)),
        ((6.2, 4.2, 0.6), (1.5, 1.5, 1.2)),
        ((-0.1, 0.1, 0.5), (1.8, 1.7, 1.0)),
        ((6.8, -4.8, 1.5), (2.0, 1.3, 3.0)),
        ((-7.3, 5.0, 2.25), (0.9, 1.6, 4.5)),
    ]
    boxes = [Box(centre_world_m=centre, size_m=size, reflectivity=0.4) for centre, size in surfaces]
    return Course(World.of([Ground(), *boxes]), (5.0, 3.2), 1.8, 2.0, 0.3)


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


def fly(
    course: Course,
    duration_s: float,
    rng: np.random.Generator,
    imu: ImuSettings | None = None,
    lidar: Mid360Settings | None = None,
) -> Flight:
    """Simulate one flight: rest, take-off, then rounds with a slow turn about the vertical."""
    imu_model = ImuModel(rng, T_BODY_LIDAR, imu or ImuSettings())
    lidar_model = Mid360Model(rng, T_BODY_LIDAR, lidar or Mid360Settings())
    settings = dynamics.QuadrotorSettings()
    state = dynamics.at_rest(
        np.array([[course.half_axes_m[0], 0.0, 0.0]]), np.array([0.4]), settings=settings
    )
    events: list[ImuSample | LidarScan] = []
    truth: list[tuple[int, FloatArray, FloatArray, FloatArray]] = []
    pieces: list[tuple[int, FloatArray, NDArray[np.uint8], NDArray[np.uint8]]] = []
    sequence = 0
    for index in range(round(duration_s / dynamics.STEP_S)):
        start_ns, end_ns = index * dynamics.STEP_NS, (index + 1) * dynamics.STEP_NS
        after = dynamics.step(
            state,
            _command(course, state, index * dynamics.STEP_S),
            state.v_world,
            np.zeros((1, 3)),
            settings=settings,
        )
        start, end = state.kinematics(0), after.kinematics(0)
        slot = imu_model.sample(start_ns, start, end_ns, end, float(after.thrust[0]))
        slots = lidar_model.measure(
            index * _SLOTS_PER_STEP,
            _SLOTS_PER_STEP,
            BodyTrajectory.between(start_ns, start, end_ns, end),
            course.world,
        )
        pieces.append((start_ns, slots.points_lidar, slots.reflectivity, slots.tags))
        truth.append((start_ns, start.p_world, start.q_world_body, start.v_world))
        events.append(ImuSample(end_ns + CLOCK_OFFSET_NS, end_ns, slot.gyro_imu, slot.accel_imu))
        if end_ns % SCAN_NS == 0:
            events.append(_cut(pieces, sequence, end_ns))
            pieces, sequence = [], sequence + 1
        state = after
    end = state.kinematics(0)
    truth.append((len(truth) * dynamics.STEP_NS, end.p_world, end.q_world_body, end.v_world))
    times, positions, attitudes, velocities = zip(*truth, strict=True)
    return Flight(
        events,
        np.array(times, dtype=np.int64),
        np.array(positions),
        np.array(attitudes),
        np.array(velocities),
    )


def _command(course: Course, state: dynamics.QuadrotorState, t: float) -> dynamics.QuadrotorCommand:
    """Follow the ellipse with a velocity that leads along it and pulls towards it."""
    a, b = course.half_axes_m
    x, y, z = state.p_world[0]
    v = np.zeros(3)
    if t > _REST_S:
        v[2] = np.clip(1.5 * (course.height_m + 0.3 * np.sin(0.7 * t) - z), -1.0, 1.5)
    if t > _REST_S + 2.0:
        angle = np.arctan2(y / b, x / a)
        tangent = np.array([-a * np.sin(angle), b * np.cos(angle)])
        pull = np.array([a * np.cos(angle), b * np.sin(angle)]) - [x, y]
        v[:2] = course.speed * tangent / np.linalg.norm(tangent) + 0.8 * pull
    yaw_rate = course.yaw_rate + 0.4 * np.sin(0.8 * t) if t > _REST_S + 2.0 else 0.0
    return dynamics.QuadrotorCommand(v[None, :], np.array([yaw_rate]), np.array([t > _REST_S - 0.3]))


def _cut(
    pieces: list[tuple[int, FloatArray, NDArray[np.uint8], NDArray[np.uint8]]], sequence: int, end_ns: int
) -> LidarScan:
    points = np.concatenate([piece[1] for piece in pieces])
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
        reflectivity=np.concatenate([piece[2] for piece in pieces])[hit],
        tags=np.concatenate([piece[3] for piece in pieces])[hit],
        packets=packets,
        packets_expected=packets,
    )
