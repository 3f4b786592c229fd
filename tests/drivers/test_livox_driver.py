"""The driver against the emulated sensor on real sockets of the loopback interface."""

import asyncio
import errno
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import pytest

from companion.clock import SystemClock
from companion.drivers.livox import LivoxDriver, LivoxSettings, Stage
from companion.drivers.livox_endpoints import kernel_drops, local_addresses, resolve_host_ip
from companion.errors import StartError
from companion.messages import Datagram, ImuSample, LidarScan, SensorEvent
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.livox_sockets import LivoxSockets
from tests.sitl.livox_feed import RealTimeFeed

# Addresses of the loopback network that nothing else uses, so that standard ports are free.
LIDAR, HOST = "127.78.0.2", "127.78.0.1"
SETTINGS = LivoxSettings(lidar_ip=LIDAR, host_ip=HOST, broadcast_search=False)
S = 1_000_000_000


@contextmanager
def emulated_sensor(clock: SystemClock) -> Iterator[LivoxSockets]:
    emulator = LivoxEmulator(LivoxEmulatorSettings(lidar_ip=LIDAR), clock.now_ns())
    sockets = LivoxSockets(emulator, clock, hears_broadcast=False)
    with RealTimeFeed(sockets, emulator, clock):
        yield sockets


async def until(condition: Callable[[], bool], clock: SystemClock, timeout_s: float = 15.0) -> bool:
    deadline_ns = clock.now_ns() + round(timeout_s * S)
    while not condition() and clock.now_ns() < deadline_ns:
        await clock.sleep(20_000_000)
    return condition()


def start_sentence(settings: LivoxSettings, timeout_s: float = 0.3) -> str:
    async def start() -> str:
        driver = LivoxDriver(settings, SystemClock(), lambda event: None)
        with pytest.raises(StartError) as refused:
            await driver.start(timeout_s)
        assert driver.statistics().packets == 0
        return str(refused.value)

    return asyncio.run(start())


def test_the_driver_starts_receives_and_recovers_from_a_power_cycle_of_the_sensor() -> None:
    clock, events, raw = SystemClock(), list[SensorEvent](), list[Datagram]()

    async def fly() -> None:
        driver = LivoxDriver(SETTINGS, clock, events.append, raw.append)
        with emulated_sensor(clock) as sensor:
            await driver.start(10.0)
            assert driver.stage is Stage.STREAMING
            assert driver.info.serial == "AREMULATED0001"
            assert driver.receive_buffer_bytes > 0
            assert await until(lambda: sum(isinstance(e, LidarScan) for e in events) >= 5, clock)
            sensor.power_cycle(clock.now_ns() + S // 2)
            assert await until(lambda: driver.reruns > 0, clock)
            assert await until(lambda: driver.stage is Stage.STREAMING, clock)
            scans = sum(isinstance(e, LidarScan) for e in events)
            assert await until(lambda: sum(isinstance(e, LidarScan) for e in events) > scans + 3, clock)
        statistics = driver.statistics()
        await driver.stop()
        await driver.stop()
        assert statistics.clock_restarts == 1
        assert statistics.malformed == statistics.crc_errors == statistics.wrong_source == 0
        assert driver.consumer_errors == 0

    asyncio.run(fly())
    assert sum(isinstance(event, ImuSample) for event in events) > 50
    assert {datagram.source for datagram in raw} == {(LIDAR, 56_300), (LIDAR, 56_400)}
    assert {datagram.destination for datagram in raw} == {(HOST, 56_301), (HOST, 56_401)}
    scans = [event for event in events if isinstance(event, LidarScan)]
    assert [scan.sequence for scan in scans] == list(range(len(scans)))


def test_a_consumer_that_raises_does_not_end_reception() -> None:
    clock, seen = SystemClock(), list[SensorEvent]()

    def consume(event: SensorEvent) -> None:
        seen.append(event)
        raise RuntimeError("a mistake of the consumer")

    async def fly() -> int:
        driver = LivoxDriver(SETTINGS, clock, consume)
        with emulated_sensor(clock):
            await driver.start(10.0)
            assert await until(lambda: len(seen) > 20, clock)
            await driver.stop()
        return driver.consumer_errors

    assert asyncio.run(fly()) >= len(seen) - 1


def test_no_sensor_is_named_as_such() -> None:
    assert start_sentence(SETTINGS).startswith(f"no answer to discovery from {LIDAR}: check power, cable")


@pytest.mark.parametrize(
    ("port", "name"), [(56_301, "points"), (56_401, "IMU"), (56_101, "commands"), (56_201, "state")]
)
def test_a_taken_port_is_named_with_errno_and_local_addresses(port: int, name: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind((HOST, port))
        sentence = start_sentence(SETTINGS)
    assert sentence.startswith(f"cannot bind UDP port {port} for {name} on {HOST}: ")
    assert f"(errno {errno.EADDRINUSE} EADDRINUSE)" in sentence
    assert sentence.endswith(f"local addresses are {local_addresses()}")
    assert "127.0.0.1 (lo)" in sentence


def test_a_host_address_that_this_computer_lacks_is_named() -> None:
    settings = LivoxSettings(lidar_ip="203.0.113.9", host_ip="203.0.113.1")
    sentence = start_sentence(settings)
    assert sentence.startswith("cannot bind UDP port 56301 for points on 203.0.113.1: ")
    assert "EADDRNOTAVAIL" in sentence


def test_the_sensors_address_must_not_be_our_own() -> None:
    sentence = start_sentence(LivoxSettings(lidar_ip="127.0.0.1"))
    assert sentence == "the LiDAR's address 127.0.0.1 is an address of this computer itself"


def test_the_own_address_is_the_one_that_routes_to_the_sensor() -> None:
    assert resolve_host_ip(LivoxSettings(lidar_ip="127.0.0.2")) == "127.0.0.1"
    assert resolve_host_ip(SETTINGS) == HOST


def test_a_taken_discovery_port_does_not_keep_the_driver_from_starting() -> None:
    clock = SystemClock()

    async def fly() -> Stage:
        driver = LivoxDriver(SETTINGS, clock, lambda event: None)
        with emulated_sensor(clock), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
            holder.bind((HOST, 56_000))
            await driver.start(10.0)
            stage = driver.stage
            await driver.stop()
        return stage

    assert asyncio.run(fly()) is Stage.STREAMING


def test_datagrams_that_the_kernel_drops_are_counted() -> None:
    with ExitStack() as stack:
        full, sender = (
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)
        )
        full.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
        full.bind((HOST, 0))
        for _ in range(50):
            sender.sendto(bytes(1_380), full.getsockname())
        drops = kernel_drops([full])
    assert 30 < drops < 50


def test_garbage_on_the_data_ports_is_counted_and_survived() -> None:
    clock = SystemClock()

    async def fly() -> tuple[int, int]:
        driver = LivoxDriver(SETTINGS, clock, lambda event: None)
        with emulated_sensor(clock) as sensor:
            await driver.start(10.0)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                for size in (0, 1, 36, 1_380, 4_000):
                    stranger.sendto(bytes(size), (HOST, 56_301))
            bad = [
                Datagram(0, (LIDAR, 56_300), (HOST, 56_301), bytes(size)) for size in (0, 35, 1_380, 9_000)
            ]
            sensor.send(bad)
            await until(lambda: driver.statistics().malformed >= 4, clock)
            statistics = driver.statistics()
            await driver.stop()
        return statistics.wrong_source, statistics.malformed

    assert asyncio.run(fly()) == (5, 4)
