import math
from pathlib import Path

import numpy as np
import pytest

from companion.errors import LogError
from companion.logs.swarm_log import SwarmFlight, read_swarm
from companion.logs.swarm_obstacles import obstacle_distances
from companion.logs.swarm_starts import parse_start, parse_waypoint
from companion.messages import FloatArray
from tests.logs import swarm_flight as made_up
from tests.logs.swarm_flight import STARTS, Clocks, write_logs

OTHER_CLOCKS = Clocks((5_000_000_000, 900_000_000_000, 77_000_000_000), dated=True)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_logs(tmp_path_factory.mktemp("flight"), truth=True)


def true_positions(flight: SwarmFlight, zero_ns: int = 0) -> FloatArray:
    times = (flight.t_ns - zero_ns) * 1e-9
    return np.array([[made_up.position(t, vehicle) for vehicle in range(3)] for t in times])


def assert_true(flight: SwarmFlight, zero_ns: int = 0, tolerance_m: float = 0.015) -> None:
    truth = true_positions(flight, zero_ns)
    assert np.abs(flight.p - truth).max() < tolerance_m
    moving = (flight.t_ns - zero_ns) * 1e-9 > 2.1
    expected = np.array(
        [[made_up.velocity(t, n) for n in range(3)] for t in (flight.t_ns[moving] - zero_ns) * 1e-9]
    )
    assert np.abs(flight.v[moving] - expected).max() < 0.02


def test_start_poses_lay_the_maps_together(logs: list[Path]) -> None:
    flight = read_swarm(logs, STARTS)
    assert flight.source == "odometry"
    assert flight.names == made_up.NAMES
    assert flight.leader == 0
    assert np.all(np.diff(flight.t_ns) == 50_000_000)
    assert flight.t[-1] == pytest.approx(made_up.DURATION_S, abs=0.21)
    assert_true(flight)


def test_the_truth_needs_no_start_poses(logs: list[Path]) -> None:
    flight = read_swarm(logs)
    assert flight.source == "truth"
    assert_true(flight)


def test_clocks_of_several_computers_are_brought_together_by_the_time_of_day(tmp_path: Path) -> None:
    flight = read_swarm(write_logs(tmp_path, clocks=OTHER_CLOCKS, clouds=False), STARTS)
    assert_true(flight, zero_ns=1_700_000_003_000_000_000)
    assert flight.notes == ()


def test_a_clock_that_was_wrong_is_put_right_by_its_offset(tmp_path: Path) -> None:
    wrong = Clocks(OTHER_CLOCKS.host_ns, dated=True, wrong_s=(0.0, 2.5, 0.0))
    paths = write_logs(tmp_path, clocks=wrong, clouds=False)
    starts = STARTS | {"uav2": STARTS["uav2"].model_copy(update={"clock_offset_s": -2.5})}
    assert_true(read_swarm(paths, starts), zero_ns=1_700_000_003_000_000_000)
    left_alone = read_swarm(paths, STARTS)
    assert np.abs(left_alone.p - true_positions(left_alone, 1_700_000_003_000_000_000)).max() > 1.0


def test_without_the_host_time_of_the_date_the_clocks_are_said_to_be_doubtful(tmp_path: Path) -> None:
    paths = write_logs(tmp_path, clocks=Clocks(OTHER_CLOCKS.host_ns, dated=True, paired=False), clouds=False)
    assert "may be wrong by seconds" in read_swarm(paths, STARTS).notes[0]


def test_what_only_some_of_them_covered_is_left_out(logs: list[Path]) -> None:
    whole = read_swarm(logs, STARTS)
    flown = read_swarm(logs, STARTS, airborne=True)
    assert flown.p[:, :, 2].min() > 0.3
    assert flown.t[-1] == pytest.approx(made_up.LANDED_AFTER_S - 1.2 - 0.2, abs=0.11)
    part = read_swarm(logs, STARTS, from_s=3.0, to_s=5.0)
    assert part.t[-1] == pytest.approx(2.0)
    assert part.t_ns[0] - whole.t_ns[0] == 3_000_000_000


def test_times_at_which_a_pose_is_not_known_are_left_out(tmp_path: Path) -> None:
    flight = read_swarm(write_logs(tmp_path, gap=(5.0, 6.5), clouds=False), STARTS)
    times = flight.t_ns * 1e-9
    assert not np.any((times > 5.02) & (times < 6.48))
    assert_true(flight)
    [note] = flight.notes
    seconds, _, rest = note.partition(" ")
    assert float(seconds) == pytest.approx(1.5, abs=0.11)
    assert rest == "s left out, in which the pose of at least one UAV was not known"


def test_only_the_longest_stretch_in_one_map_counts(tmp_path: Path) -> None:
    flight = read_swarm(write_logs(tmp_path, resets_at=9.0, clouds=False), STARTS)
    assert flight.t_ns[-1] * 1e-9 < 9.0
    assert_true(flight)
    assert "uav1: its map jumped; only the longest stretch in one map counts" in flight.notes


class TestObstacles:
    @pytest.mark.parametrize("truth", [False, True])
    def test_distances_are_to_what_stands_there_not_to_ground_or_uavs(
        self, logs: list[Path], truth: bool
    ) -> None:
        flight = read_swarm(logs, None if truth else STARTS, from_s=2.5, to_s=11.0)
        distances, notes = obstacle_distances(flight)
        assert distances is not None
        assert notes == []
        expected = made_up.nearest_pillar(true_positions(flight))
        assert np.abs(distances - expected).max() < 0.03

    def test_without_clouds_nothing_is_known(self, tmp_path: Path) -> None:
        flight = read_swarm(write_logs(tmp_path, clouds=False), STARTS)
        distances, notes = obstacle_distances(flight)
        assert distances is None
        assert notes == ["MDO: not known, for no log holds clouds at these times"]

    def test_who_has_no_clouds_is_said(self, tmp_path: Path) -> None:
        seeing, blind = tmp_path / "seeing", tmp_path / "blind"
        seeing.mkdir()
        blind.mkdir()
        paths = [*write_logs(seeing)[:2], write_logs(blind, clouds=False)[2]]
        distances, notes = obstacle_distances(read_swarm(paths, STARTS))
        assert distances is not None
        assert np.all(np.isinf(distances[:, 2]))
        assert notes == ["MDO: rests on the clouds of uav1, uav2 only"]


class TestRefusals:
    def refused(self, *given: object, **more: object) -> str:
        with pytest.raises(LogError) as caught:
            read_swarm(*given, **more)  # type: ignore[arg-type]
        assert "\n" not in str(caught.value)
        return str(caught.value)

    def test_one_log_is_no_swarm(self, logs: list[Path]) -> None:
        assert "a swarm needs 2" in self.refused(logs[:1], STARTS)

    def test_a_vehicle_twice(self, logs: list[Path]) -> None:
        assert "a second log of uav1" in self.refused([logs[0], logs[1], logs[0]], STARTS)

    def test_start_poses_must_be_of_these_vehicles(self, logs: list[Path]) -> None:
        assert "no start pose of uav2, uav3" in self.refused(logs, {"uav1": STARTS["uav1"]})
        strange = STARTS | {"uav9": STARTS["uav1"]}
        assert "a start pose of uav9, of which there is no log" in self.refused(logs, strange)

    def test_a_real_flight_needs_start_poses(self, tmp_path: Path) -> None:
        assert "holds no truth" in self.refused(write_logs(tmp_path, clouds=False))

    def test_logs_of_different_times(self, tmp_path: Path) -> None:
        paths = write_logs(tmp_path, clocks=Clocks((0, 0, 50_000_000_000)), clouds=False)
        assert "no time in common: uav3 begins after uav2 has ended" in self.refused(paths, STARTS)

    def test_dated_and_undated_logs(self, tmp_path: Path) -> None:
        here, there = tmp_path / "here", tmp_path / "there"
        here.mkdir()
        there.mkdir()
        paths = [write_logs(here, clouds=False)[0], *write_logs(there, clocks=OTHER_CLOCKS, clouds=False)[1:]]
        assert "cannot be brought together" in self.refused(paths, STARTS)

    @pytest.mark.parametrize("text", ["uav1", "uav1=1,2,3", "=1,2,3,4", "uav1=1,2,3,x", "uav1=1,2,nan,4"])
    def test_a_start_that_is_none(self, text: str) -> None:
        with pytest.raises(LogError, match="allowed is NAME=x,y,z,yaw_deg"):
            parse_start(text)

    @pytest.mark.parametrize("text", ["1,2", "a,b,c", "1,2,inf"])
    def test_a_waypoint_that_is_none(self, text: str) -> None:
        with pytest.raises(LogError, match="allowed is x,y,z in metres"):
            parse_waypoint(text)


def test_a_start_is_read_as_it_is_written() -> None:
    name, start = parse_start("uav2=1.5,-2,0.1,90")
    assert (name, start.position_m, start.yaw_deg) == ("uav2", (1.5, -2.0, 0.1), 90.0)
    assert parse_waypoint("1,2,-3.5") == (1.0, 2.0, -3.5)
    assert math.isclose(start.clock_offset_s, 0.0)
