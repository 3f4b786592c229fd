"""Another process sends MAVLink ODOMETRY over UDP with pymavlink; what comes out is checked."""

import asyncio
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from companion.clock import SystemClock
from companion.config import Profile
from companion.drivers.external_odometry import MAX_DATAGRAM_SIZE
from companion.drivers.external_odometry_link import ExternalOdometryLink
from companion.drivers.external_odometry_settings import ExternalOdometrySettings
from companion.errors import StartError
from companion.geometry import rotation
from companion.messages import (
    ExternalOdometry,
    ImuSample,
    Odometry,
    OdometryStatus,
    SensorEvent,
)
from companion.perception.odometry.external import ExternalMotionEstimator
from companion.preflight.external_odometry import check_external_odometry
from companion.yaml_source import loads
from tests.profiles import GOOD

SECOND_NS = 1_000_000_000
# A process of its own: a body at (1, 2, 3) in the map, heading 30 degrees to the left, at rest.
SENDER = """
import os, sys, time
os.environ["MAVLINK20"] = "1"
os.environ["MAVLINK_DIALECT"] = "common"
from pymavlink import mavutil
port, hz, quality, epoch = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=9, source_component=197)
clocks = {"unix": time.time, "monotonic": time.monotonic, "own": lambda: time.monotonic() - start + 5.0}
start = time.monotonic()
covariance = [1e-4, 0, 0, 0, 0, 0, 1e-4, 0, 0, 0, 0, 1e-4, 0, 0, 0, 1e-5, 0, 0, 1e-5, 0, 1e-5]
unknown = [float("nan")] + [0] * 20
while True:
    link.mav.odometry_send(
        int(1e6 * clocks[epoch]()), 20, 12, 1.0, -2.0, -3.0, [0.9659258, 0.0, 0.0, -0.258819],
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0, covariance, unknown, 0, 3, quality,
    )
    time.sleep(1.0 / hz)
"""


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def a_sender(port: int, hz: float = 50.0, quality: int = 80, epoch: str = "unix") -> Iterator[None]:
    command = [sys.executable, "-c", SENDER, str(port), str(hz), str(quality), epoch]
    process = subprocess.Popen(command)
    try:
        yield
    finally:
        process.kill()
        process.wait()


async def until(clock: SystemClock, condition: Callable[[], bool]) -> None:
    end_ns = clock.now_ns() + 20 * SECOND_NS
    while not condition():
        assert clock.now_ns() < end_ns
        await clock.sleep(5_000_000)


@pytest.mark.parametrize("epoch", ["unix", "monotonic", "own"])
def test_another_process_is_followed_on_whatever_clock_it_stamps(epoch: str) -> None:
    """The body rests, and so says the IMU; after a second of agreement the pose is ours."""
    clock, port = SystemClock(), free_port()
    profile = loads(GOOD + "odometry: {source: external}\n", Profile)
    estimator = ExternalMotionEstimator(
        profile.odometry, profile.vehicle.T_body_lidar, profile.vehicle.T_lidar_imu
    )
    events: list[SensorEvent] = []
    settings = ExternalOdometrySettings(
        port=port, system_ids=(9,), clock="host_monotonic" if epoch == "monotonic" else "estimated"
    )
    found: list[Odometry] = []

    async def listen() -> None:
        link = ExternalOdometryLink(settings, clock, events.append)
        await link.start()
        boot_ns = clock.now_ns()
        sample_ns = boot_ns
        try:
            with a_sender(port, epoch=epoch):
                end_ns = boot_ns + 20 * SECOND_NS
                while not any(entry.status is OdometryStatus.TRACKING for entry in found):
                    assert clock.now_ns() < end_ns, [entry.reason for entry in found[-3:]]
                    await clock.sleep(5_000_000)
                    while sample_ns <= clock.now_ns():
                        upright = np.array([0.0, 0.0, 9.80665])
                        events.append(ImuSample(sample_ns, sample_ns - boot_ns, np.zeros(3), upright))
                        sample_ns += 5_000_000
                    taken, events[:] = events[:], []
                    for event in taken:
                        found.extend(o for o in estimator.handle(event) if isinstance(o, Odometry))
        finally:
            await link.stop()
        assert link.statistics().refused == 0
        assert link.consumer_errors == 0

    asyncio.run(listen())
    last = found[-1]
    np.testing.assert_allclose(last.p_map, [1.0, 2.0, 3.0], atol=0.02)
    assert float(rotation.yaw_of(last.q_map_body)) == pytest.approx(np.radians(30.0), abs=0.01)
    assert last.quality >= 75


def test_a_taken_port_is_one_sentence_that_names_it() -> None:
    clock, port = SystemClock(), free_port()

    async def start() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", port))
            await ExternalOdometryLink(ExternalOdometrySettings(port=port), clock, print).start()

    with pytest.raises(StartError, match=f"cannot bind UDP port {port} for external odometry on 127.0.0.1"):
        asyncio.run(start())


def test_it_starts_without_a_sender_and_says_what_does_not_arrive() -> None:
    clock, port = SystemClock(), free_port()

    async def listen() -> list[str]:
        link = ExternalOdometryLink(ExternalOdometrySettings(port=port), clock, print)
        await link.start()
        said = [link.diagnosis()]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for payload in (b"hello", bytes(MAX_DATAGRAM_SIZE + 500)):
                sender.sendto(payload, ("127.0.0.1", port))
        await until(clock, lambda: link.statistics().datagrams == 2)
        said.append(link.diagnosis())
        await link.stop()
        await link.stop()
        return said

    first, second = asyncio.run(listen())
    where = f"UDP 127.0.0.1:{port}"
    assert first == f"nothing arrives at {where}: does the other process run, and send there?"
    assert second == (
        f"of 2 datagrams at {where} none was accepted: datagram too large (1), no MAVLink message (1)"
    )


def test_a_consumers_mistake_does_not_end_reception() -> None:
    clock, port = SystemClock(), free_port()

    def break_down(event: SensorEvent) -> None:
        raise RuntimeError(event)

    async def listen() -> None:
        link = ExternalOdometryLink(ExternalOdometrySettings(port=port), clock, break_down)
        await link.start()
        with a_sender(port):
            await until(clock, lambda: link.consumer_errors >= 3)
        await link.stop()

    asyncio.run(listen())


class TestPreflight:
    @staticmethod
    def check(port: int, wait_ns: int = 15 * SECOND_NS) -> tuple[str, str]:
        profile = loads(
            GOOD + f"odometry: {{source: external}}\nexternal_odometry: {{port: {port}}}\n", Profile
        )
        found = asyncio.run(check_external_odometry(profile, SystemClock(), wait_ns))
        assert found.name == "external odometry"
        return found.verdict, found.reason

    def test_a_good_sender_is_a_go(self) -> None:
        port = free_port()
        with a_sender(port):
            verdict, reason = self.check(port)
        assert verdict == "ok"
        assert reason.endswith("Hz, quality 80")

    def test_nobody_is_a_no_go_that_says_where_to_look(self) -> None:
        port = free_port()
        verdict, reason = self.check(port, wait_ns=SECOND_NS // 10)
        assert verdict == "fail"
        assert reason.startswith(f"nothing arrives at UDP 127.0.0.1:{port}")

    @pytest.mark.parametrize(
        ("hz", "quality", "expected"),
        [
            (3.0, 80, "Hz, at least 8 Hz are needed"),
            (50.0, 10, "it states the quality 10, at least 30 is needed"),
            (50.0, -1, "the other process reports its failure"),
        ],
    )
    def test_a_poor_sender_is_a_no_go(self, hz: float, quality: int, expected: str) -> None:
        port = free_port()
        with a_sender(port, hz, quality):
            verdict, reason = self.check(port)
        assert verdict == "fail"
        assert expected in reason


def test_messages_carry_both_clocks(tmp_path: Path) -> None:
    clock, port = SystemClock(), free_port()
    events: list[SensorEvent] = []

    async def listen() -> None:
        link = ExternalOdometryLink(ExternalOdometrySettings(port=port), clock, events.append)
        await link.start()
        with a_sender(port, epoch="unix"):
            await until(clock, lambda: len(events) >= 20)
        await link.stop()

    asyncio.run(listen())
    for event in events:
        assert isinstance(event, ExternalOdometry)
        assert abs(event.t_source_ns - clock.calendar_ns()) < 60 * SECOND_NS
        assert -SECOND_NS // 20 < event.t_ns - event.t_valid_ns < SECOND_NS // 2
