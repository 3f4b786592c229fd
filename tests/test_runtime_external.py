"""A run of the companion on another process's odometry: its link starts, feeds perception and stops."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion import runtime
from companion.config import Profile
from companion.drivers.external_odometry import ExternalOdometryReceiver
from companion.drivers.external_odometry_settings import ExternalOdometrySettings
from companion.errors import StartError
from companion.logs import channels
from companion.logs.records import Statistics
from companion.messages import Odometry
from companion.perception.odometry.external import ExternalMotionEstimator
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.yaml_source import loads
from tests.drivers.odometry_sender import Stated
from tests.drivers.px4_peer import MS
from tests.flight_bench import Bench
from tests.profiles import GOOD

EXTERNAL = GOOD + "odometry: {source: external}\n"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr("tests.flight_bench.GOOD", EXTERNAL)
    played = Bench(tmp_path, monkeypatch)

    class PlayedLink:
        def __init__(self, settings: ExternalOdometrySettings, clock: Any, on_event: Any) -> None:
            self._receiver = ExternalOdometryReceiver(settings)
            self._on_event = on_event
            links.append(self)

        async def start(self) -> None:
            if refusal:
                raise StartError(refusal[0])
            played.story.append("external odometry starts")

        async def stop(self) -> None:
            played.story.append("external odometry stops")

        def send(self, t_ns: int) -> None:
            data = Stated(time_usec=t_ns // 1000).bytes()
            for event in self._receiver.receive(t_ns, ("127.0.0.1", 5), data):
                self._on_event(event)

        def statistics(self) -> object:
            return self._receiver.statistics()

    monkeypatch.setattr(runtime, "ExternalOdometryLink", PlayedLink)
    yield played
    played.log.close()


links: list[Any] = []
refusal: list[str] = []


@pytest.fixture(autouse=True)
def fresh() -> None:
    links.clear()
    refusal.clear()


def test_the_link_starts_before_the_lidar_and_stops_after_it(bench: Bench) -> None:
    asyncio.run(bench.run())
    driving = [entry for entry in bench.story if not entry.startswith("status ")]
    assert driving[:6] == [
        "link starts",
        "link runs",
        "external odometry starts",
        "LiDAR starts",
        "LiDAR runs",
        "ready",
    ]
    assert driving[-3:] == ["LiDAR stops", "external odometry stops", "link stops"]


def test_what_arrives_is_perceived_recorded_and_counted(bench: Bench) -> None:
    async def during() -> None:
        for _ in range(60):
            bench.clock.t_ns += 20 * MS  # type: ignore[attr-defined]
            links[0].send(bench.clock.now_ns())
            await bench.clock.sleep(0)
        await bench.until(lambda: bench.estimator.thread == "perception")
        await bench.clock.sleep(1_100 * MS)
        await bench.clock.sleep(MS)

    asyncio.run(bench.run(during()))
    assert len(bench.recorded(channels.EXTERNAL_ODOMETRY)) == 60
    assert any(isinstance(entry, Odometry) for entry in bench.recorded(channels.ODOMETRY))
    counted = [
        entry.values["accepted"]
        for entry in bench.recorded(channels.STATISTICS)
        if isinstance(entry, Statistics) and entry.source == "external_odometry"
    ]
    assert max(counted) > 0


def test_a_taken_port_ends_the_start_with_its_reason(bench: Bench) -> None:
    refusal.append("cannot bind UDP port 14580 for external odometry on 127.0.0.1")
    with pytest.raises(StartError, match="14580"):
        asyncio.run(bench.run())
    assert bench.story[-1] == "link stops"


@pytest.mark.parametrize(
    ("text", "kind"), [(EXTERNAL, ExternalMotionEstimator), (GOOD, LidarInertialOdometry)]
)
def test_the_profile_decides_who_estimates(text: str, kind: type) -> None:
    from companion.assembly import assemble

    assert isinstance(assemble(loads(text, Profile))._estimator, kind)


def test_without_it_no_port_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "ExternalOdometryLink", None)
    bench = Bench(tmp_path, monkeypatch)
    asyncio.run(bench.run())
    bench.log.close()
