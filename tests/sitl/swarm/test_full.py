"""Swarms in full fidelity: complete companions that see each other by light alone."""

import hashlib
import os
import signal
from pathlib import Path

import pytest

from companion.clock import seconds_to_ns
from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.messages import FlightState, NeighbourTracks, StateChange
from sitl.lockstep import BOOT_NS
from sitl.swarm.full import FullFlight, fly_full
from sitl.swarm.lockstep import FlightPlan
from sitl.swarm.process import Swarm, WorkerLostError
from sitl.swarm.referee import TrialNames
from sitl.swarm.table import Table
from sitl.swarm.vehicles import member_name, member_stage, shares
from tests.sitl.swarm.small_swarm import crew, plan, scene, setting


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> FullFlight:
    folder = tmp_path_factory.mktemp("swarm")
    return fly_full(scene(), crew(), setting(), folder, TrialNames("small", "flock"), workers=1)


def states_of(log: Path) -> list[FlightState]:
    changes = FlightRecording(log).messages(channels.STATE)
    return [entry.message.current for entry in changes if isinstance(entry.message, StateChange)]


def test_a_follower_sees_its_leader_and_goes_with_it_to_the_goal(flight: FullFlight) -> None:
    record = flight.record
    assert record.end == "success"
    assert record.mission_progress_percent == 100.0
    assert 0.4 < record.minimum_separation_m < 3.0
    assert record.steps == pytest.approx(record.t_end_s / 0.05, abs=1.0)
    for log in flight.logs:
        assert states_of(log)[:4] == [
            FlightState.STANDBY,
            FlightState.READY,
            FlightState.ENGAGING,
            FlightState.ACTIVE,
        ]
    assert flight.start_s is not None
    start_ns = BOOT_NS + seconds_to_ns(flight.start_s)
    tracks = [
        entry.message
        for entry in FlightRecording(flight.logs[1]).messages(channels.NEIGHBOURS)
        if isinstance(entry.message, NeighbourTracks) and entry.t_ns >= start_ns
    ]
    assert sum(any(track.validated for track in scan.tracks) for scan in tracks) > 0.8 * len(tracks)


def test_light_logs_leave_out_packets_and_messages_of_the_autopilot(flight: FullFlight) -> None:
    recording = FlightRecording(flight.logs[1])
    bulky = (channels.LIDAR_PACKETS, channels.MAVLINK_RX, channels.MAVLINK_TX, channels.CLOUD)
    assert not list(recording.messages(*bulky))
    rate_hz = len(list(recording.messages(channels.ODOMETRY))) / flight.sim_time_s
    assert rate_hz == pytest.approx(20.0, abs=5.0)


def test_map_frames_differ_and_the_leaders_way_is_told_in_its_own() -> None:
    stages = [member_stage(setting(), crew(), scene(), number) for number in (0, 1)]
    leader = stages[0].profile.leader
    assert leader is not None
    assert stages[0].T_world_start.transform(leader.mission.waypoints_m[0]) == pytest.approx([3.0, 0.0, 1.5])
    assert [stage.profile.autopilot.system_id for stage in stages] == [1, 2]
    assert abs(stages[0].T_world_start.q @ stages[1].T_world_start.q) < 0.99
    draws = [stage.generator("imu").random() for stage in stages]
    assert draws[0] != draws[1]


def go_on(swarm: Swarm, before: Table, steps: int) -> Table:
    """Fly without a referee; return where everybody is then."""
    for _ in range(steps):
        now = swarm.move()
        swarm.live(before, now, start_given=False)
        before = now
    return before


def advance(flown: FlightPlan, workers: int, steps: int) -> list[str]:
    """Fly without a referee; return the hashes of the logs."""
    swarm = Swarm(flown, shares(flown.vehicles, workers))
    try:
        go_on(swarm, swarm.first_table(), steps)
        swarm.end(swarm.move())
    finally:
        swarm.close()
    logs = [flown.log_path(number) for number in range(flown.vehicles)]
    return [hashlib.sha256(log.read_bytes()).hexdigest() for log in logs]


def test_the_number_of_processes_cannot_be_seen_in_any_log(tmp_path: Path) -> None:
    flown = plan(tmp_path / "one", vehicles=3)
    alone = advance(flown, 1, 450)
    assert advance(plan(tmp_path / "two", vehicles=3), 2, 450) == alone
    assert len(set(alone)) == 3
    # By then everybody has a pose and sees the others.
    for number in range(3):
        *_, last = FlightRecording(flown.log_path(number)).messages(channels.NEIGHBOURS)
        assert isinstance(last.message, NeighbourTracks)
        assert last.message.tracks


def test_a_process_that_dies_ends_the_run_with_one_sentence_and_readable_logs(tmp_path: Path) -> None:
    flown = plan(tmp_path)
    swarm = Swarm(flown, shares(2, 2))
    try:
        before = go_on(swarm, swarm.first_table(), 250)
        (worker,) = swarm.workers
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)
        with pytest.raises(WorkerLostError, match=r"the process of vehicles \d was ended by SIGKILL"):
            go_on(swarm, before, 10)
    finally:
        swarm.close()
    own = 1 - worker.numbers[0]
    assert list(FlightRecording(flown.log_path(own)).messages(channels.TRUTH))
    unfinished = flown.log_path(worker.numbers[0])
    assert list(FlightRecording(unfinished.with_name(f"{unfinished.name}.open")).messages(channels.TRUTH))


def test_an_error_in_a_process_is_told_by_the_one_that_gathers(tmp_path: Path) -> None:
    flown = plan(tmp_path)
    taken = flown.log_path(0)
    taken.parent.mkdir(parents=True)
    taken.write_bytes(b"an older log")
    swarm = Swarm(flown, [(1,), (0,)])
    try:
        with pytest.raises(WorkerLostError, match=r"vehicles 0 failed: .*flight\.mcap"):
            swarm.first_table()
    finally:
        swarm.close()
    assert taken.read_bytes() == b"an older log"


def test_shares_are_even_and_the_one_who_judges_has_no_larger_one() -> None:
    assert shares(5, 2) == [(1, 3), (0, 2, 4)]
    assert shares(2, 8) == [(1,), (0,)]
    assert sorted(sum(shares(13, 4), ())) == list(range(13))
    assert member_name(0) == "vehicle_00_leader"
