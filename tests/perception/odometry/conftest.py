"""Short flights, simulated once per session."""

from dataclasses import dataclass

import numpy as np
import pytest

from companion.messages import (
    ExternalOdometry,
    FloatArray,
    ImuSample,
    LidarScan,
    Odometry,
    OdometryStatus,
    RegisteredScan,
)
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from tests.perception.odometry.external_flight import END_NS, Peer, messages
from tests.perception.odometry.simulated_flight import (
    T_BODY_LIDAR,
    T_LIDAR_IMU,
    SimulatedFlight,
    loop_trajectory,
    pillar_field,
    room,
)

SMALL = OdometrySettings(fine_blocks=32_768, coarse_blocks=8_192)


@dataclass(frozen=True)
class Outcome:
    """What the odometry made of a flight."""

    odometry: list[Odometry]
    scans: list[RegisteredScan]
    lio: LidarInertialOdometry

    @property
    def tracked(self) -> list[Odometry]:
        return [entry for entry in self.odometry if entry.status is not OdometryStatus.INITIALISING]


def run(events: list[ImuSample | LidarScan], settings: OdometrySettings = SMALL) -> Outcome:
    """Feed events to a fresh odometry."""
    lio = LidarInertialOdometry(settings, T_BODY_LIDAR, T_LIDAR_IMU)
    odometry: list[Odometry] = []
    scans: list[RegisteredScan] = []
    for event in events:
        for output in lio.handle(event):
            if isinstance(output, RegisteredScan):
                scans.append(output)
            else:
                odometry.append(output)
    return Outcome(odometry, scans, lio)


def errors(
    flight: SimulatedFlight, odometry: list[Odometry]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return estimated p, estimated q, true p, true q at the odometry's times."""
    times = np.array([entry.t_sensor_ns for entry in odometry])
    p_true, q_true, _ = flight.truth(times)
    return (
        np.array([entry.p_map for entry in odometry]),
        np.array([entry.q_map_body for entry in odometry]),
        p_true,
        q_true,
    )


@pytest.fixture(scope="session")
def field_flight() -> SimulatedFlight:
    world = pillar_field(np.random.default_rng(3), 50)
    return SimulatedFlight(world, loop_trajectory(9.0), seed=3)


@pytest.fixture(scope="session")
def field_events(field_flight: SimulatedFlight) -> list[ImuSample | LidarScan]:
    return list(field_flight.events())


@pytest.fixture(scope="session")
def field_outcome(field_events: list[ImuSample | LidarScan]) -> Outcome:
    return run(field_events)


@pytest.fixture(scope="session")
def room_flight() -> SimulatedFlight:
    trajectory = loop_trajectory(8.0, speed=2.0, size_m=(5.0, 3.2), height_m=1.8)
    return SimulatedFlight(room(), trajectory, seed=4)


@pytest.fixture(scope="session")
def room_events(room_flight: SimulatedFlight) -> list[ImuSample | LidarScan]:
    return list(room_flight.events())


@pytest.fixture(scope="session")
def inertial(field_events: list[ImuSample | LidarScan]) -> list[ImuSample | LidarScan]:
    """The flight without its scans: cheaper where they do not matter."""
    return [event for event in field_events if isinstance(event, ImuSample)]


@pytest.fixture(scope="session")
def sent(field_flight: SimulatedFlight) -> list[ExternalOdometry]:
    """What another process sends of it."""
    return messages(field_flight, END_NS, Peer())
