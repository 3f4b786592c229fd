"""Slots for an emulated LiDAR in real time, for tests on real sockets."""

import threading
from types import TracebackType

import numpy as np

from companion.clock import SystemClock
from sitl.livox_emulator import LivoxEmulator
from sitl.livox_sockets import LivoxSockets
from sitl.slots import SLOT_PERIOD_NS, InertialSlot, PointSlots

BATCH = 2_000
BATCH_NS = BATCH * SLOT_PERIOD_NS
IMU_PERIOD_NS = 5_000_000


def ring_slots(first_slot: int, count: int) -> PointSlots:
    """Return slots on a cylinder of 5 m radius, every eighth without return."""
    index = np.arange(first_slot, first_slot + count)
    angle = index * 0.01
    points = np.stack([5.0 * np.cos(angle), 5.0 * np.sin(angle), 0.5 + 0.0 * angle], axis=-1)
    points[index % 8 == 7] = 0.0
    reflectivity = (index % 150).astype(np.uint8)
    return PointSlots(first_slot, points, reflectivity, np.zeros(count, dtype=np.uint8))


def still_sample(t_sensor_ns: int) -> InertialSlot:
    """Return what a level sensor at rest measures."""
    return InertialSlot(t_sensor_ns, np.array([0.01, -0.02, 0.03]), np.array([0.0, 0.0, 9.80665]))


class RealTimeFeed:
    """Feeds an emulator on sockets from a thread while the context is open."""

    def __init__(self, sockets: LivoxSockets, emulator: LivoxEmulator, clock: SystemClock) -> None:
        self._sockets = sockets
        self._emulator = emulator
        self._clock = clock
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._feed, daemon=True)

    def __enter__(self) -> "RealTimeFeed":
        self._sockets.start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._thread.join()
        self._sockets.stop()

    def _feed(self) -> None:
        boot_ns, batch = self._emulator.boot_host_ns, 0
        while not self._stopping.wait(0.004):
            if self._emulator.boot_host_ns != boot_ns:
                boot_ns, batch = self._emulator.boot_host_ns, 0
            while boot_ns + batch * BATCH_NS <= self._clock.now_ns():
                self._sockets.points(ring_slots(batch * BATCH, BATCH))
                for t_sensor_ns in range(batch * BATCH_NS, (batch + 1) * BATCH_NS, IMU_PERIOD_NS):
                    self._sockets.inertial(still_sample(t_sensor_ns))
                batch += 1
