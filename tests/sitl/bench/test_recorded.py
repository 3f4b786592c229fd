from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.config import Profile
from companion.errors import LogError
from companion.geometry.trajectory import Trajectory
from companion.logs.tum import write_tum
from companion.messages import Datagram
from sitl.bench.courses import course
from sitl.bench.recorded import measure_recording
from sitl.bench.synthetic_flights import T_BODY_LIDAR, FlightStep, stream
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.recording_writers.captures import write_pcap

BOOT_NS = 1_700_000_000_000_000_000
DURATION_S = 8.0


@pytest.fixture(scope="module")
def steps() -> list[FlightStep]:
    return list(stream(course("indoor", 4), DURATION_S, np.random.default_rng(4)))


@pytest.fixture(scope="module")
def recording(steps: list[FlightStep], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network capture of the flight, as the emulated sensor sent it."""
    path = tmp_path_factory.mktemp("recording") / "flight.pcap"
    write_pcap(path, sorted(_datagrams(steps), key=lambda datagram: datagram.t_ns))
    return path


def _datagrams(steps: list[FlightStep]) -> Iterator[Datagram]:
    emulator = LivoxEmulator(
        LivoxEmulatorSettings(persisted_host_ip="192.168.1.50", persisted_target="sampling"), BOOT_NS
    )
    for step in steps:
        if step.slots is not None and step.sample is not None:
            yield from emulator.points(step.slots)
            yield from emulator.inertial(step.sample)
            yield from emulator.poll(BOOT_NS + step.t_sensor_ns)


def _write_truth(path: Path, steps: list[FlightStep], offset_ns: int) -> Path:
    thinned = steps[::4]
    write_tum(
        path,
        Trajectory(
            np.array([step.t_sensor_ns + offset_ns for step in thinned], dtype=np.int64),
            np.array([step.truth.p_world for step in thinned]),
            np.array([step.truth.q_world_body for step in thinned]),
        ),
    )
    return path


def _profile() -> Profile:
    return Profile.model_validate(
        {"vehicle": {"name": "uav", "lidar_position_m": T_BODY_LIDAR.p.tolist()}, "role": "follower"}
    )


@pytest.mark.parametrize("offset_ns", [0, BOOT_NS])
def test_truth_is_found_by_the_sensors_clock_and_by_the_hosts(
    tmp_path: Path, recording: Path, steps: list[FlightStep], offset_ns: int
) -> None:
    truth = _write_truth(tmp_path / "truth.tum", steps, offset_ns)
    row = measure_recording(recording, truth, ["companion"], _profile())[0].row
    assert row.world == "flight.pcap"
    assert row.ape_rmse_m is not None
    assert row.ape_rmse_m < 0.01
    assert row.attitude_rmse_deg is not None
    assert row.attitude_rmse_deg < 0.2
    assert row.coverage_percent == pytest.approx(100.0, abs=3.0)
    assert row.path_m == pytest.approx(7.5, abs=1.5)


def test_the_others_read_the_same_recording(tmp_path: Path, recording: Path, steps: list[FlightStep]) -> None:
    pytest.importorskip("rko_lio")
    truth = _write_truth(tmp_path / "truth.tum", steps, 0)
    row = measure_recording(recording, truth, ["rko_lio"], _profile())[0].row
    assert row.ape_rmse_m is not None
    assert row.ape_rmse_m < 0.15
    assert row.failures == 0


def test_without_truth_the_times_are_told(recording: Path) -> None:
    row = measure_recording(recording, None, ["companion"])[0].row
    assert row.ape_rmse_m is None
    assert row.note == "no true path was given"
    assert row.ms_median is not None
    assert row.scans > 50


def test_truth_of_another_time_is_refused_in_one_sentence(
    tmp_path: Path, recording: Path, steps: list[FlightStep]
) -> None:
    truth = _write_truth(tmp_path / "truth.tum", steps, 77_000_000_000)
    with pytest.raises(
        LogError, match=r"truth\.tum: the truth lasts from 77\.000 to 85\.000 s, but the scans"
    ):
        measure_recording(recording, truth, ["companion"])


def test_a_truth_with_a_hole_is_not_interpolated_across_it(
    tmp_path: Path, recording: Path, steps: list[FlightStep]
) -> None:
    holed = [step for step in steps if not 4.0e9 < step.t_sensor_ns < 6.0e9]
    truth = _write_truth(tmp_path / "truth.tum", holed, 0)
    found = measure_recording(recording, truth, ["companion"], _profile())[0]
    assert found.judgement is not None
    compared_s = 1e-9 * found.judgement.t_ns
    assert not np.any((compared_s > 4.1) & (compared_s < 5.9))
    assert found.row.ape_rmse_m is not None
    assert found.row.ape_rmse_m < 0.01


def test_results_from_a_recording_that_ends_early_say_so(tmp_path: Path, recording: Path) -> None:
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(recording.read_bytes()[:-1000])
    (result,) = measure_recording(cut, None, ["companion"], _profile())
    assert "ends early" in result.row.note
