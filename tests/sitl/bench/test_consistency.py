import json

import numpy as np
import pytest

from companion.exit_codes import ExitCode
from companion.geometry import rotation
from companion.messages import FloatArray, Odometry, OdometryStatus
from companion.perception.odometry.settings import OdometrySettings
from sitl.bench.consistency import INSTANTS, Sample, bounds, fly, judge
from sitl.cli import main

SIGMAS = np.array([0.01, 0.02, 0.03, 1e-3, 2e-3, 1e-3])


def _sample(rng: np.random.Generator, factor: float = 1.0) -> Sample:
    """Errors that are `factor` times as large as what is claimed of them."""
    turn: FloatArray = factor * rng.normal(0.0, SIGMAS[3:])
    return Sample(
        p_error=factor * rng.normal(0.0, SIGMAS[:3]),
        turn_error=turn,
        v_error=factor * rng.normal(0.0, 0.01, 3),
        odometry=Odometry(
            t_ns=0, t_sensor_ns=0, p_map=np.zeros(3), q_map_body=rotation.IDENTITY, v_map=np.zeros(3),
            omega_body=np.zeros(3), covariance_pose=np.diag(SIGMAS**2), covariance_velocity=np.eye(3) * 1e-4,
            quality=100, reset_counter=0, status=OdometryStatus.TRACKING,
        ),
    )  # fmt: skip


def _flights(factor: float, runs: int = 200) -> list[list[Sample | None]]:
    rng = np.random.default_rng(1)
    return [[_sample(rng, factor) for _ in INSTANTS] for _ in range(runs)]


def test_true_covariances_are_found_consistent() -> None:
    row = judge("made up", _flights(1.0))
    assert row.consistent
    assert row.position_nees == pytest.approx(1.0, abs=0.1)
    assert row.position_inside_percent == pytest.approx(95.0, abs=2.0)
    assert row.position_error_cm == pytest.approx(row.position_sigma_cm, rel=0.05)


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_claims_of_too_much_and_of_too_little_are_found_out(factor: float) -> None:
    row = judge("made up", _flights(factor))
    assert not row.consistent
    assert row.attitude_nees == pytest.approx(factor**2, rel=0.1)


def test_a_lost_instant_is_not_consistent() -> None:
    flights = _flights(1.0)
    flights[3][1] = None
    row = judge("made up", flights)
    assert row.lost == 1
    assert not row.consistent


def test_bounds_close_around_one_as_runs_grow() -> None:
    assert bounds(1)[0] == pytest.approx(0.0719, abs=1e-3)
    assert bounds(1)[1] == pytest.approx(3.116, abs=1e-3)
    lower, upper = bounds(100)
    assert lower == pytest.approx(0.846, abs=2e-3)
    assert upper == pytest.approx(1.166, abs=2e-3)


def test_a_short_flight_is_covered_by_what_the_odometry_claims() -> None:
    settings = OdometrySettings(output_hz=50.0)
    samples = [sample for seed in (1, 2) for sample in fly("indoor", 10.0, seed, settings)]
    assert len(samples) == 2 * len(INSTANTS)
    nees = np.array([sample.nees for sample in samples if sample is not None])
    assert len(nees) == len(samples)
    # Errors a third or three times as large as claimed would leave these.
    assert np.all(nees.mean(axis=0)[:2] > 0.1)
    assert np.all(nees.mean(axis=0)[:2] < 3.0)


def test_the_command_ends_with_its_rows_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["bench", "consistency", "--worlds", "indoor", "--runs", "1", "--seconds", "5", "--json"])
    captured = capsys.readouterr()
    rows = json.loads(captured.out.splitlines()[-1])["rows"]
    assert [row["world"] for row in rows] == ["indoor"]
    assert rows[0]["runs"] == 1
    assert code == (ExitCode.OK if rows[0]["consistent"] else ExitCode.NO_GO)


def test_an_unknown_world_gets_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "consistency", "--worlds", "moon"]) == ExitCode.USAGE
    assert "there is no world 'moon'" in " ".join(capsys.readouterr().err.split())
