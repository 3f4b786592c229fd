"""A PX4 that runs elsewhere, here its stand-in as a process of its own: our sensors follow its motion."""

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from companion.clock import seconds_to_ns
from companion.config import load_profile
from companion.errors import StartError
from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.messages import FlightState, StateChange
from sitl import px4_flight, px4_parameters
from sitl.outcome import Ending, evaluate
from sitl.px4_flight import fly_px4
from sitl.scenario import load_scenario
from tests.sitl.short_flight import write_scenario

URL = "udpin://127.0.0.1:14540"
TRUTH = ("127.0.0.1", 19410)


@dataclass
class StandIn:
    """What the process said once it has ended."""

    status: int | None = None
    output: str = ""


@contextmanager
def stand_in(*options: str) -> Iterator[StandIn]:
    """Run `sitl px4 --json` until the end of the context, then interrupt it as a person would."""
    command = [sys.executable, "-c", "import sys; from sitl.cli import main; sys.exit(main())"]
    said = StandIn()
    with subprocess.Popen(
        [*command, "px4", "--json", *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            yield said
        finally:
            process.send_signal(signal.SIGINT)
            try:
                said.output, _ = process.communicate(timeout=20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
            said.status = process.returncode


def fly(folder: Path, *, apply: bool = True, lines: list[str] | None = None) -> Ending:
    reported: list[str] = [] if lines is None else lines
    scenario = load_scenario(write_scenario(folder))
    return fly_px4(
        scenario,
        folder,
        None,
        folder / "flight.mcap",
        url=URL,
        truth_address=TRUTH,
        apply=apply,
        on_parameter=reported.append,
    )


def test_a_px4_with_its_default_parameters_is_set_up_and_flown_to_the_goal(tmp_path: Path) -> None:
    lines: list[str] = []
    with stand_in("--seed", "4") as said:
        ending = fly(tmp_path, lines=lines)
    assert said.status == 130, said.output
    assert json.loads(said.output.splitlines()[-1]) == {"error": "interrupted", "exit": 130}

    assert any(line.startswith("EKF2_GPS_CTRL is 7, wanted 0") for line in lines)
    assert all(line.endswith((": written", ": left as it is")) for line in lines[:-1])
    assert all(line.endswith(": left as it is") == ("is missing" in line) for line in lines[:-1])
    assert "take effect only after PX4 is restarted" in lines[-1]

    outcome = evaluate(ending, tmp_path / "flight.mcap")
    assert outcome.success, outcome.reason
    assert outcome.collisions == 0
    assert outcome.goal_distance_m < 1.0
    assert outcome.odometry.ape_rmse_m is not None
    assert outcome.odometry.ape_rmse_m < 0.1
    assert outcome.livox.packets > 10_000

    recording = FlightRecording(tmp_path / "flight.mcap")
    assert recording.integrity().messages[channels.TRUTH.topic] > 500
    changes = [entry.message for entry in recording.messages(channels.STATE)]
    states = [change.current for change in changes if isinstance(change, StateChange)]
    assert states.index(FlightState.ACTIVE) < states.index(FlightState.LANDING)
    assert FlightState.LOST not in states
    assert load_profile(tmp_path / "px4_profile.yaml").autopilot.url == URL
    assert not list(tmp_path.glob("logs-*"))


def test_without_a_px4_one_sentence_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(px4_flight, "_TRUTH_TIMEOUT_NS", seconds_to_ns(0.2))
    with pytest.raises(StartError) as caught:
        fly(tmp_path)
    assert str(caught.value) == (
        "simulator's motion: 0 HIL_STATE_QUATERNION messages in 0 s; "
        "is PX4 running with its internal simulator?"
    )


def test_a_px4_that_speaks_to_somebody_else_is_named_by_what_is_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(px4_parameters, "_START_TIMEOUT_S", 0.5)
    with (
        stand_in("--companion-port", "14541") as said,
        pytest.raises(StartError, match=r"^autopilot: system id 1 is silent on udpin://127\.0\.0\.1:14540$"),
    ):
        fly(tmp_path)
    assert said.status == 130, said.output
    assert not (tmp_path / "flight.mcap").exists()


def test_an_address_in_use_is_named(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(TRUTH)
        with pytest.raises(StartError, match=r"cannot listen on 127\.0\.0\.1:19410: Address already in use"):
            fly(tmp_path)
