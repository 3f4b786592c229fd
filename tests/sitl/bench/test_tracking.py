import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.geometry import rotation
from companion.messages import FloatArray, NeighbourTrack, NeighbourTracks
from sitl.bench.swarm_truth import MapFrame, NeighbourSights
from sitl.bench.tracking_page import markdown, page
from sitl.bench.tracking_score import Row, Score
from sitl.cli import app
from sitl.kinematics import Kinematics
from tests.perception.tracking.bodies import odometry

SCAN_NS = 100_000_000
FIVE_METRES = np.array([[5.0, 0.0, 1.0]])


def truth() -> Kinematics:
    """Return the true own motion: at rest, turned by a right angle, at (1, 0, 0)."""
    return Kinematics(
        p_world=np.array([1.0, 0.0, 0.0]),
        q_world_body=rotation.from_yaw(np.pi / 2),
        v_world=np.zeros(3),
        omega_body=np.zeros(3),
    )


FRAME = MapFrame.of(truth())


def sights(number: int, p_world: FloatArray, visible: bool = True) -> NeighbourSights:
    n = len(p_world)
    away = np.linalg.norm(p_world - truth().p_world, axis=1)
    ones = np.ones(n, np.int64)
    return NeighbourSights(
        number * SCAN_NS, number, p_world, np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), away,
        np.full(n, visible), 5 * ones, ones, ones, ones,
    )  # fmt: skip


def track(track_id: int, p_map: FloatArray, seen: int, *, validated: bool = True) -> NeighbourTrack:
    return NeighbourTrack(
        track_id, p_map, np.array([0.3, 0.0, 0.0]), 0.01 * np.eye(6), 0, seen * SCAN_NS, 5, 0.4, validated
    )


def score(
    tracks_of: Callable[[int, FloatArray], list[NeighbourTrack]],
    scans: int = 30,
    p_world: FloatArray = FIVE_METRES,
    visible: Callable[[int], bool] = lambda k: True,
) -> Row:
    """Score scans in which `tracks_of` gives the tracks for the neighbours' true positions in the map."""
    result = Score(0)
    p_true = FRAME.positions(p_world)
    for k in range(1, scans + 1):
        own = odometry(k * SCAN_NS, p_map=np.zeros(3))
        tracks = NeighbourTracks(k * SCAN_NS, k, tuple(tracks_of(k, p_true)))
        result.add(tracks, own, sights(k, p_world, visible(k)), truth(), FRAME, 2.0)
    return result.rows("made up", len(p_world), tape=True, distractors=False)[0]


def test_truth_is_turned_into_the_map_and_errors_are_lengths() -> None:
    row = score(lambda k, p: [track(1, p[0] + [0.0, 0.06, 0.08], k)])
    assert row.detection_rate == row.precision == 1.0
    assert row.position_rmse_m == pytest.approx(0.1)
    assert row.velocity_rmse_mps == pytest.approx(0.3)
    assert row.position_nees == pytest.approx(1.0 / 3.0)
    assert row.velocity_nees == pytest.approx(3.0)
    assert row.range_m == pytest.approx(np.sqrt(17.0))
    assert row.position_rmse_axes_m is not None
    assert np.linalg.norm(row.position_rmse_axes_m) == pytest.approx(0.1)
    assert row.position_nees_bounds == pytest.approx((1.237 / 6.0, 14.449 / 6.0), rel=1e-3)


def test_an_error_of_the_own_pose_is_not_the_trackers() -> None:
    drifted = odometry(SCAN_NS, p_map=np.array([3.0, 0.0, 0.0]), q_map_body=rotation.from_yaw(0.5))
    result = Score(0)
    p_map = drifted.p_map + rotation.rotate(drifted.q_map_body, FRAME.positions(FIVE_METRES)[0])
    for k in range(1, 8):
        own = replace(drifted, t_ns=k * SCAN_NS)
        tracks = NeighbourTracks(own.t_ns, k, (track(1, p_map, k),))
        result.add(tracks, own, sights(k, FIVE_METRES), truth(), FRAME, 1.0)
    assert result.rows("x", 1, tape=True, distractors=False)[0].position_rmse_m == pytest.approx(
        0.0, abs=1e-9
    )


def test_candidates_detect_nothing_and_false_tracks_cost_precision() -> None:
    assert score(lambda k, p: [track(1, p[0], k, validated=False)]).detection_rate == 0.0
    row = score(lambda k, p: [track(1, p[0], k), track(2, p[0] + [0.0, 0.6, 0.0], k)])
    assert row.detection_rate == 1.0
    assert row.precision == 0.5


def test_a_last_seen_slot_counts_neither_way() -> None:
    row = score(lambda k, p: [track(1, p[0] + [0.0, 0.0, 2.0], k - 6)])
    assert row.track_steps == 0
    assert row.precision is None
    assert row.detection_rate == 0.0


def test_nobody_is_missed_in_the_first_half_second_or_out_of_sight() -> None:
    assert score(lambda k, p: [track(1, p[0], k)] if k > 5 else []).detection_rate == 1.0
    assert score(lambda k, p: [track(1, p[0], k)] if k > 8 else []).detection_rate == pytest.approx(22 / 25)
    assert score(lambda k, p: [], visible=lambda k: k % 5 != 0).counted == 0


def test_nobody_is_missed_beyond_the_trackers_range() -> None:
    far = np.array([[14.0, 0.0, 1.0]])
    assert score(lambda k, p: [], p_world=far).counted == 0


def test_a_new_number_is_a_switch_and_another_neighbour_is_not() -> None:
    two = np.array([[5.0, 0.0, 1.0], [5.0, 3.0, 1.0]])
    steady = score(lambda k, p: [track(1, p[0], k), track(2, p[1], k)], p_world=two)
    assert steady.id_switches_per_min == 0.0
    swapped = score(lambda k, p: [track(1 + (k > 9), p[0], k), track(2 - (k > 9), p[1], k)], p_world=two)
    assert swapped.id_switches_per_min == pytest.approx(2 / (2.9 / 60.0))


def test_acquisition_is_measured_from_coming_into_sight() -> None:
    row = score(lambda k, p: [track(1, p[0], k)] if k >= 14 else [], visible=lambda k: k >= 10)
    assert row.acquired_s == pytest.approx(0.4)


def test_the_table_and_the_page_show_every_row() -> None:
    rows = [score(lambda k, p: [track(1, p[0], k)])]
    assert len(markdown(rows).splitlines()) == 3
    text = page(rows, "/* plotly */")
    assert "made up, 1 neighbours" in text
    assert "$" not in text.split("<script>")[0]


def test_the_command_flies_a_scene_and_writes_what_it_found(tmp_path: Path) -> None:
    options = ["--scenes", "hover", "--seconds", "9", "--out", str(tmp_path), "--json"]
    result = CliRunner().invoke(app, ["bench", "tracking", *options])
    assert result.exit_code == 0
    report = json.loads(result.stdout.strip().splitlines()[-1])
    everything = report["rows"][0]
    assert everything["distractors"] is True
    assert everything["neighbours"] == 4
    assert everything["counted"] > 100
    assert everything["detection_rate"] > 0.9
    assert everything["precision"] > 0.9
    assert everything["position_rmse_m"] < 0.1
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "tracking.html",
        "tracking.json",
        "tracking.md",
    ]


def test_a_scene_that_does_not_exist_is_refused_with_those_that_do() -> None:
    result = CliRunner().invoke(app, ["bench", "tracking", "--scenes", "ballet"])
    assert result.exit_code == 2
    assert "weave" in result.output
