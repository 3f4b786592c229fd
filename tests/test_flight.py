"""One flight from outside: the order of things, the log's name and what it says of the flight."""

from pathlib import Path
from typing import Any

import pytest

from companion import flight
from companion.config import Profile
from companion.directories import BusyError
from companion.errors import StartError
from companion.flight import log_path, run_flight
from companion.logs.reader import FlightRecording
from companion.messages import FlightState
from companion.runtime import FlightOutcome
from companion.yaml_source import loads
from tests.profiles import GOOD


@pytest.fixture
def environ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    monkeypatch.setattr(flight, "load_kernels", lambda: 1)
    return {"XDG_RUNTIME_DIR": str(tmp_path), "XDG_STATE_HOME": str(tmp_path / "state")}


def test_a_log_is_named_after_vehicle_and_time_of_day() -> None:
    assert log_path(Path("/l"), "uav1", 1_795_000_000_123_000_000) == Path("/l/uav1-20261118T110640123Z.mcap")


def test_a_flight_runs_alone_with_an_open_log_that_holds_its_configuration(
    environ: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = loads(GOOD, Profile)
    seen: list[Any] = []

    async def fly(profile: Profile, *, clock: Any, service: Any, log: Any) -> FlightOutcome:
        with pytest.raises(BusyError):
            run_flight(profile, environ, None)
        seen.append(log.path)
        assert list(service.directories.logs.glob("*.mcap.open"))
        return FlightOutcome(FlightState.STANDBY, "SIGTERM", log.path)

    monkeypatch.setattr("companion.runtime.fly", fly)
    outcome = run_flight(profile, environ, None)
    assert outcome.reason == "SIGTERM"
    assert outcome.log == seen[0]
    recording = FlightRecording(outcome.log)
    assert loads(recording.configuration, Profile) == profile
    assert recording.flight["vehicle"] == "uav1"


def test_the_log_is_closed_when_a_driver_cannot_start(
    environ: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fly(*given: Any, **named: Any) -> FlightOutcome:
        raise StartError("LiDAR: no answer")

    monkeypatch.setattr("companion.runtime.fly", fly)
    with pytest.raises(StartError):
        run_flight(loads(GOOD, Profile), environ, tmp_path)
    assert len(list(tmp_path.glob("uav1-*.mcap"))) == 1
    assert not list(tmp_path.glob("*.open"))
