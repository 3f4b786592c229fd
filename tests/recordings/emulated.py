"""Datagrams of the emulated sensor in a hall, and small changes to files."""

from functools import cache
from itertools import pairwise

import numpy as np

from companion.drivers.livox_framing import LivoxReceiver
from companion.drivers.livox_settings import LivoxSettings
from companion.messages import Datagram, ImuSample, LidarScan, SensorEvent
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.slots import SLOT_PERIOD_NS, InertialSlot, PointSlots

LIDAR_IP = "192.168.1.150"
BOOT_NS = 1_700_000_000_123_456_789
SETTINGS = LivoxSettings(lidar_ip=LIDAR_IP)
STEP_NS = 5_000_000
_SLOTS_PER_STEP = STEP_NS // SLOT_PERIOD_NS


@cache
def datagrams(duration_s: float = 1.0, lidar_ip: str = LIDAR_IP) -> tuple[Datagram, ...]:
    """Return what a sensor sends from power-on, in the order of sending: points, samples, states."""
    emulator = LivoxEmulator(
        LivoxEmulatorSettings(
            lidar_ip=lidar_ip, persisted_host_ip="192.168.1.50", persisted_target="sampling"
        ),
        BOOT_NS,
    )
    rng = np.random.default_rng(7)
    sent: list[Datagram] = []
    for index in range(round(duration_s * 1e9) // STEP_NS):
        end_ns = (index + 1) * STEP_NS
        points = rng.uniform(-8.0, 8.0, (_SLOTS_PER_STEP, 3))
        points[rng.random(_SLOTS_PER_STEP) < 0.35] = 0.0
        reflectivity = rng.integers(0, 256, _SLOTS_PER_STEP, dtype=np.uint8)
        tags = rng.choice(np.array([0, 0, 0, 16, 2], dtype=np.uint8), _SLOTS_PER_STEP)
        sent += emulator.points(PointSlots(index * _SLOTS_PER_STEP, points, reflectivity, tags))
        gyro, accel = rng.normal(0.0, 0.1, 3), rng.normal([0.0, 0.0, 9.80665], 0.1)
        sent += emulator.inertial(InertialSlot(end_ns, gyro, accel))
        sent += emulator.poll(BOOT_NS + end_ns)
    return tuple(sorted(sent, key=lambda datagram: datagram.t_ns))


def received(sent: tuple[Datagram, ...], settings: LivoxSettings = SETTINGS) -> list[SensorEvent]:
    """Return the events of the receiver that flies."""
    receiver = LivoxReceiver(settings)
    return [event for datagram in sent for event in receiver.receive(datagram)]


def identical(events: list[SensorEvent], expected: list[SensorEvent]) -> bool:
    """Return whether two runs agree in every bit."""
    return [_bytes_of(event) for event in events] == [_bytes_of(event) for event in expected]


def samples(events: list[SensorEvent]) -> list[ImuSample]:
    """Return the inertial samples."""
    return [event for event in events if isinstance(event, ImuSample)]


def scans(events: list[SensorEvent]) -> list[LidarScan]:
    """Return the scans."""
    return [event for event in events if isinstance(event, LidarScan)]


def ascending(events: list[SensorEvent]) -> bool:
    """Return whether the events are in the order of their times of arrival."""
    return all(before.t_ns <= after.t_ns for before, after in pairwise(events))


def _bytes_of(event: SensorEvent) -> tuple[object, ...]:
    if isinstance(event, ImuSample):
        return event.t_ns, event.t_sensor_ns, event.gyro_imu.tobytes(), event.accel_imu.tobytes()
    assert isinstance(event, LidarScan)
    return (
        event.t_ns,
        event.sequence,
        event.t_sensor_start_ns,
        event.t_sensor_end_ns,
        event.clock_offset_ns,
        event.points_lidar.tobytes(),
        event.offsets_ns.tobytes(),
        event.reflectivity.tobytes(),
        event.tags.tobytes(),
        event.packets,
        event.packets_expected,
    )
