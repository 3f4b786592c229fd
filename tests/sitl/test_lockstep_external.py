"""Flights step by step on somebody else's odometry, which hears the LiDAR's bytes and sends its own."""

from pathlib import Path

import numpy as np
import pytest

from companion.clock import seconds_to_ns
from companion.logs import channels
from companion.logs.metadata import FlightMetadata
from companion.logs.reader import FlightRecording
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import ExternalOdometry, FlightState, Odometry, OdometryStatus
from sitl.lockstep import BOOT_NS, Lockstep, fly_lockstep
from sitl.odometry_peer import BOOT_LEAD_NS
from sitl.outcome import evaluate
from sitl.scenario import load_scenario, set_stage
from tests.sitl.external_scenario import write_external_scenario


def test_the_vehicle_flies_to_its_goal_on_another_process_odometry(tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    stage = set_stage(load_scenario(write_external_scenario(tmp_path)), tmp_path, None)
    outcome = evaluate(fly_lockstep(stage, log), log)
    assert outcome.success, outcome.reason
    assert outcome.collisions == 0
    assert outcome.odometry.ape_rmse_m is not None
    assert outcome.odometry.ape_rmse_m < 0.05
    recording = FlightRecording(log)
    heard = [entry.message for entry in recording.messages(channels.EXTERNAL_ODOMETRY)]
    assert len(heard) > 500
    offsets = []
    for message in heard:
        assert isinstance(message, ExternalOdometry)
        offsets.append(message.clock_offset_ns)
    # Its clock is its own; what is left of the difference is the time that its messages take.
    assert np.median(offsets) == pytest.approx(BOOT_NS - BOOT_LEAD_NS, abs=10_000_000)
    statuses = [
        entry.message.status
        for entry in recording.messages(channels.ODOMETRY)
        if isinstance(entry.message, Odometry)
    ]
    assert statuses[-1] is OdometryStatus.TRACKING
    assert OdometryStatus.LOST not in statuses


def test_when_the_other_process_dies_in_flight_the_stream_ends(tmp_path: Path) -> None:
    stage = set_stage(load_scenario(write_external_scenario(tmp_path)), tmp_path, None)
    metadata = FlightMetadata(vehicle="a", role="leader", mode="lockstep", configuration="")
    log = FlightLog(tmp_path / "flight.mcap", LogSettings(), metadata, threaded=False)
    flight = Lockstep(stage, log)
    while flight.state is not FlightState.ACTIVE:
        flight.step()
        assert not flight.referee.over
    flight.end_peer()
    end_ns = flight.referee.t_ns + seconds_to_ns(3.0)
    seen: list[FlightState] = []
    while flight.referee.t_ns < end_ns:
        flight.step()
        seen.append(flight.state)
    log.close()
    assert FlightState.HOLDING in seen
    assert seen[-1] is FlightState.LOST
