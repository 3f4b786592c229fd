"""Emulated sensor, network that loses and mixes up, handshake and receiver: the same bytes, no sockets."""

import hashlib
from dataclasses import dataclass, field

import numpy as np
import pytest

from companion.drivers.livox_framing import LivoxReceiver
from companion.drivers.livox_handshake import LivoxHandshake
from companion.drivers.livox_settings import LivoxSettings
from companion.drivers.livox_stage import Stage
from companion.messages import Datagram, ImuSample, LidarScan
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from tests.sitl.livox_feed import ring_slots, still_sample

LIDAR, HOST = "127.0.0.2", "127.0.0.1"
BOOT_NS = 3_000_000_000
STEP_NS = 5_000_000
S = 1_000_000_000


@dataclass
class Flight:
    """One sensor and one host in simulated time."""

    loss: float = 0.0
    duplication: float = 0.0
    disorder: int = 0
    seed: int = 0
    settings: LivoxSettings = field(default_factory=lambda: LivoxSettings(lidar_ip=LIDAR, host_ip=HOST))

    def __post_init__(self) -> None:
        self.emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
        self.handshake = LivoxHandshake(self.settings, HOST)
        self.receiver = LivoxReceiver(self.settings)
        self.rng = np.random.default_rng(self.seed)
        self.scans: list[LidarScan] = []
        self.samples: list[ImuSample] = []
        self.t_ns = BOOT_NS

    def run(self, duration_ns: int) -> "Flight":
        end_ns = self.t_ns + duration_ns
        while self.t_ns < end_ns:
            self.handshake.observe_data(self.receiver.t_points_ns, self.receiver.t_imu_ns)
            waiting = self.handshake.poll(self.t_ns)
            while waiting:
                answers = [answer for datagram in waiting for answer in self.emulator.receive(datagram)]
                waiting = [request for answer in answers for request in self.handshake.receive(answer)]
            for push in self.emulator.poll(self.t_ns):
                self.handshake.receive(push)
            self._measure()
            self.t_ns += STEP_NS
        return self

    def _measure(self) -> None:
        t_sensor_ns = self.t_ns - self.emulator.boot_host_ns
        if t_sensor_ns < 0:
            return
        sent = self.emulator.inertial(still_sample(t_sensor_ns))
        sent += self.emulator.points(ring_slots(t_sensor_ns // 5_000, STEP_NS // 5_000))
        for datagram in self._network(sent):
            for event in self.receiver.receive(datagram):
                if isinstance(event, LidarScan):
                    self.scans.append(event)
                elif isinstance(event, ImuSample):
                    self.samples.append(event)

    def _network(self, datagrams: list[Datagram]) -> list[Datagram]:
        kept = [d for d in datagrams if self.rng.random() >= self.loss]
        doubled = [d for d in kept for _ in range(1 + (self.rng.random() < self.duplication))]
        places = np.arange(len(doubled)) + self.rng.uniform(0.0, self.disorder + 1e-9, len(doubled))
        return [doubled[i] for i in np.argsort(places, kind="stable")]


def test_a_perfect_cable_delivers_every_scan_complete() -> None:
    flight = Flight().run(3 * S)
    assert flight.handshake.stage is Stage.STREAMING
    complete = [scan for scan in flight.scans if scan.packets == scan.packets_expected]
    assert len(complete) == len(flight.scans) >= 29
    assert {len(scan.points_lidar) for scan in flight.scans} == {17_500}
    assert len(flight.samples) >= 590
    statistics = flight.receiver.statistics()
    assert statistics.lost == statistics.imu_lost == statistics.jumps == statistics.malformed == 0
    assert abs(statistics.clock_offset_ns - BOOT_NS) < 1_000


@pytest.mark.parametrize("loss", [0.05, 0.2, 0.5])
def test_a_bad_cable_is_measured_as_bad_as_it_is(loss: float) -> None:
    flight = Flight(loss=loss, duplication=0.05, disorder=3, seed=1).run(4 * S)
    statistics = flight.receiver.statistics()
    found = statistics.lost / (statistics.lost + statistics.packets)
    assert found == pytest.approx(loss, abs=0.02)
    assert statistics.duplicates > 100
    assert statistics.reordered > 100
    assert statistics.clock_restarts == 0
    share = np.mean([scan.packets / scan.packets_expected for scan in flight.scans])
    assert share == pytest.approx(1.0 - loss, abs=0.02)
    for scan in flight.scans:
        assert np.all(np.diff(scan.offsets_ns) > 0)
        assert scan.t_sensor_end_ns - scan.t_sensor_start_ns == 100_000_000


def test_points_arrive_where_they_were_measured() -> None:
    flight = Flight(loss=0.1, seed=2).run(1 * S)
    for scan in flight.scans:
        slot = (scan.t_sensor_start_ns + scan.offsets_ns) // 5_000
        expected = np.stack([5.0 * np.cos(slot * 0.01), 5.0 * np.sin(slot * 0.01), 0.5 + 0.0 * slot], axis=1)
        np.testing.assert_allclose(scan.points_lidar, expected, atol=0.0006)
        assert np.array_equal(scan.reflectivity, slot % 150)


def test_a_power_cycle_in_flight_is_survived_and_reported() -> None:
    flight = Flight().run(2 * S)
    scans_before = len(flight.scans)
    flight.emulator.power_cycle(flight.t_ns + 2 * S)
    flight.run(4 * S)
    assert flight.handshake.stage is Stage.STREAMING
    assert flight.handshake.reruns >= 1
    after = flight.scans[scans_before + 1 :]
    assert len(after) >= 17
    assert after[-1].t_sensor_start_ns < 2 * S
    statistics = flight.receiver.statistics()
    assert statistics.clock_restarts == 1
    assert abs(statistics.clock_offset_ns - flight.emulator.boot_host_ns) < 10_000


@pytest.mark.parametrize("step_ns", [-S, S])
def test_a_clock_jump_of_the_sensor_is_survived_and_reported(step_ns: int) -> None:
    flight = Flight().run(3 * S)
    flight.emulator.step_clock(step_ns)
    flight.run(2 * S)
    statistics = flight.receiver.statistics()
    assert (statistics.clock_restarts, statistics.lost) == (1, 0)
    assert abs(statistics.clock_offset_ns - BOOT_NS + step_ns) < 10_000
    assert flight.handshake.reruns == 0


def test_equal_seeds_give_equal_bytes() -> None:
    def digest() -> str:
        flight = Flight(loss=0.1, duplication=0.1, disorder=2, seed=9).run(1 * S)
        content = b"".join(s.points_lidar.tobytes() + s.offsets_ns.tobytes() for s in flight.scans)
        return hashlib.sha256(content + repr(flight.receiver.statistics()).encode()).hexdigest()

    assert digest() == digest()
