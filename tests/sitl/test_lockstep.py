"""Flights step by step: from LiDAR bytes to setpoint bytes, the same each time."""

from pathlib import Path

import pytest

from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.messages import FlightState, StateChange
from sitl.lockstep import fly_lockstep
from sitl.outcome import Outcome, evaluate
from sitl.scenario import load_scenario, set_stage
from tests.sitl.short_flight import write_scenario


def fly(folder: Path, log_name: str, seed: int | None = None, **changes: object) -> Outcome:
    path = write_scenario(folder, **changes)
    log = folder / log_name
    ending = fly_lockstep(set_stage(load_scenario(path), folder, seed), log)
    return evaluate(ending, log)


def states_of(log: str) -> list[FlightState]:
    changes = FlightRecording(Path(log)).messages(channels.STATE)
    return [entry.message.current for entry in changes if isinstance(entry.message, StateChange)]


def test_a_flight_reaches_its_goal_and_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    first, second = fly(tmp_path, "first.mcap"), fly(tmp_path, "second.mcap")
    assert first.success, first.reason
    assert first.goal_distance_m < 0.5
    assert first.collisions == 0
    assert first.odometry.ape_rmse_m is not None
    assert first.odometry.ape_rmse_m < 0.05
    assert first.odometry.drift_percent is not None
    assert first.odometry.drift_percent < 1.0
    assert first.setpoints.max_gap_ms is not None
    assert first.setpoints.max_gap_ms <= 40.0
    assert first.livox.lost == 0
    assert first.log_sha256 == second.log_sha256
    assert states_of(first.log) == [
        FlightState.STANDBY,
        FlightState.READY,
        FlightState.ENGAGING,
        FlightState.ACTIVE,
        FlightState.LANDING,
        FlightState.DONE,
    ]


def test_another_seed_is_another_flight_and_packet_loss_is_seen(tmp_path: Path) -> None:
    clean = write_scenario(tmp_path)
    lossy = fly(tmp_path, "lossy.mcap", seed=11, network={"loss": 0.05, "duplication": 0.01})
    assert clean.exists()
    assert lossy.success, lossy.reason
    share = lossy.livox.lost / (lossy.livox.lost + lossy.livox.packets)
    assert share == pytest.approx(0.05, abs=0.01)


def test_a_silent_lidar_in_flight_ends_in_the_autopilots_failsafe(tmp_path: Path) -> None:
    outcome = fly(tmp_path, "outage.mcap", network={"outage_at_s": 12.0, "outage_s": 30.0})
    assert not outcome.success
    states = states_of(outcome.log)
    assert FlightState.HOLDING in states
    assert states.index(FlightState.LOST) > states.index(FlightState.HOLDING)
    assert FlightState.ACTIVE not in states[states.index(FlightState.LOST) :]


def test_a_pilots_takeover_ends_the_companions_flight(tmp_path: Path) -> None:
    operator = {"takeoff_height_m": 1.2, "authorise_after_s": 0.2, "takeover_after_s": 1.5}
    outcome = fly(tmp_path, "takeover.mcap", operator=operator)
    states = states_of(outcome.log)
    assert FlightState.PILOT in states
    assert FlightState.ACTIVE not in states[states.index(FlightState.PILOT) :]
    assert outcome.collisions == 0
