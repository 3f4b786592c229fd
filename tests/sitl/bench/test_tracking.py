import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from companion.geometry import rotation
from companion.messages import FloatArray, NeighbourTrack, NeighbourTracks
from sitl.bench.swarm_scenes import SCENES
from sitl.bench.swarm_truth import MapFrame, NeighbourSights
from sitl.bench.tracking import CASES, HARD_WIND, Case, measure
from sitl.bench.tracking_page import markdown, page
from sitl.bench.tracking_rows import Row, rate_interval, rows, together, wilson
from sitl.bench.tracking_score import SIGHT, FlightScore, Score
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


def scored(
    tracks_of: Callable[[int, FloatArray], list[NeighbourTrack]],
    scans: int = 30,
    p_world: FloatArray = FIVE_METRES,
    visible: Callable[[int], bool] = lambda k: True,
) -> FlightScore:
    """Score scans in which `tracks_of` gives the tracks for the neighbours' true positions in the map."""
    result = Score(0)
    p_true = FRAME.positions(p_world)
    for k in range(1, scans + 1):
        own = odometry(k * SCAN_NS, p_map=np.zeros(3))
        tracks = NeighbourTracks(k * SCAN_NS, k, tuple(tracks_of(k, p_true)))
        result.add(tracks, own, sights(k, p_world, visible(k)), truth(), FRAME, (2.0, 5.0))
    return result.result()


def score(
    tracks_of: Callable[[int, FloatArray], list[NeighbourTrack]],
    scans: int = 30,
    p_world: FloatArray = FIVE_METRES,
    visible: Callable[[int], bool] = lambda k: True,
) -> Row:
    """Return the figures of such scans, all ranges together."""
    return rows(scored(tracks_of, scans, p_world, visible), "made up", len(p_world))[0]


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
    # The error is always the same: all thirty steps tell no more than one would.
    assert row.position_nees_samples == 0
    assert row.position_nees_bounds is None


def test_an_error_of_the_own_pose_is_not_the_trackers() -> None:
    drifted = odometry(SCAN_NS, p_map=np.array([3.0, 0.0, 0.0]), q_map_body=rotation.from_yaw(0.5))
    result = Score(0)
    p_map = drifted.p_map + rotation.rotate(drifted.q_map_body, FRAME.positions(FIVE_METRES)[0])
    for k in range(1, 8):
        own = replace(drifted, t_ns=k * SCAN_NS)
        tracks = NeighbourTracks(own.t_ns, k, (track(1, p_map, k),))
        result.add(tracks, own, sights(k, FIVE_METRES), truth(), FRAME, (1.0, 1.0))
    assert rows(result.result(), "x", 1)[0].position_rmse_m == pytest.approx(0.0, abs=1e-9)


def test_candidates_detect_nothing_and_false_tracks_cost_precision() -> None:
    assert score(lambda k, p: [track(1, p[0], k, validated=False)]).detection_rate == 0.0
    row = score(lambda k, p: [track(1, p[0], k), track(2, p[0] + [0.0, 0.6, 0.0], k)])
    assert row.detection_rate == 1.0
    assert row.precision == 0.5


def test_a_second_track_of_one_neighbour_is_false() -> None:
    row = score(lambda k, p: [track(1, p[0], k), track(2, p[0] + [0.0, 0.3, 0.0], k)])
    assert row.precision == 0.5
    assert row.false_tracks == 1
    assert row.false_steps == 30
    assert row.missed == 0


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


def test_switches_are_counted_by_minute_of_the_swarm_and_by_neighbour() -> None:
    two = np.array([[5.0, 0.0, 1.0], [5.0, 3.0, 1.0]])
    row = score(lambda k, p: [track(1 + 10 * (k > 9), p[0], k), track(2, p[1], k)], p_world=two)
    assert row.id_switches == 1
    assert row.minutes == pytest.approx(2.9 / 60.0)
    assert row.id_switches_per_min == pytest.approx(60.0 / 2.9)
    assert row.id_switches_per_uav_min == pytest.approx(60.0 / 2.9 / 2.0)


def test_the_velocity_as_seen_from_the_own_vehicle_has_its_error_too() -> None:
    result = Score(0)
    for k in range(1, 8):
        own = odometry(k * SCAN_NS, p_map=np.zeros(3), v_map=np.array([0.0, 0.4, 0.0]))
        tracks = NeighbourTracks(own.t_ns, k, (track(1, FRAME.positions(FIVE_METRES)[0], k),))
        result.add(tracks, own, sights(k, FIVE_METRES), truth(), FRAME, (1.0, 1.0))
    row = rows(result.result(), "x", 1)[0]
    assert row.velocity_rmse_mps == pytest.approx(0.3)
    assert row.relative_velocity_rmse_mps == pytest.approx(0.5)


def test_the_first_half_second_counts_in_the_rate_at_once() -> None:
    row = score(lambda k, p: [track(1, p[0], k)] if k > 3 else [])
    assert row.detection_rate == 1.0
    assert row.detection_rate_at_once == pytest.approx(27 / 30)


def test_flights_are_told_apart_when_they_are_joined() -> None:
    found = [scored(lambda k, p: [track(1, p[0], k)] if k < 20 else []) for _ in range(3)]
    row = rows(FlightScore.joined(found), "x", 1)[0]
    assert row.flights == 3
    assert row.missed == 33
    assert row.minutes == pytest.approx(3 * 2.9 / 60.0)
    # Three failures of eleven steps each, of 75 steps.
    lower, upper = wilson(42 / 75, 75 / 11.0)
    assert row.detection_ci95 == pytest.approx((lower, upper))


def test_cases_that_look_alike_are_taken_together() -> None:
    good = scored(lambda k, p: [track(1, p[0], k)])
    lost = scored(lambda k, p: [])
    found = together([(good, True, True), (lost, True, True), (good, True, False), (lost, False, False)])
    assert {(row.scene, row.neighbours, row.tape, row.distractors) for row in found} == {
        ("together", None, True, True)
    }
    assert found[0].flights == 2
    assert found[0].detection_rate == 0.5
    assert found[0].id_switches == 0


def test_the_interval_of_a_rate_is_wilsons_by_the_second() -> None:
    assert wilson(0.5, 10.0) == pytest.approx((0.2366, 0.7634), abs=1e-4)
    steps = np.zeros(1000, SIGHT)
    steps["matched"] = True
    assert rate_interval(steps, "neighbour", "matched") == pytest.approx(wilson(1.0, 100.0))
    assert rate_interval(steps[:0], "neighbour", "matched") is None


def test_correlated_errors_are_fewer_samples() -> None:
    rng = np.random.default_rng(1)
    independent = rng.normal(0.0, 0.1, (400, 3))
    lasting = np.repeat(rng.normal(0.0, 0.1, (80, 3)), 5, axis=0)
    found = [
        score(lambda k, p, e=errors: [track(1, p[0] + e[k - 1], k)], scans=400)  # type: ignore[misc]
        for errors in (independent, lasting)
    ]
    samples = [row.position_nees_samples for row in found]
    assert 350 < samples[0] <= 396
    # The squared correlation of errors that last five steps adds up to 1 + 2 (0.64 + 0.36 + 0.16 + 0.04).
    assert samples[1] == pytest.approx(396 / 3.4, rel=0.2)
    bounds = found[1].position_nees_bounds
    assert bounds is not None
    assert bounds[0] == pytest.approx(1.0 - 1.96 * np.sqrt(2.0 / (3.0 * samples[1])), abs=0.02)


def test_acquisition_is_measured_from_coming_into_sight() -> None:
    row = score(lambda k, p: [track(1, p[0], k)] if k >= 14 else [], visible=lambda k: k >= 10)
    assert row.acquired_s == pytest.approx(0.4)


def test_the_table_and_the_page_show_every_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plotly.offline.get_plotlyjs", lambda: "/* plotly */")
    found = rows(scored(lambda k, p: [track(1, p[0], k)]), "made <up>", 1, windy=True)
    assert len(markdown(found).splitlines()) == 2 + len(found)
    text = page(found)
    assert "made &lt;up&gt;, 1 neighbour, wind" in text
    assert "$" not in text.split("<script>")[0]


NAMED = {
    "range_m", "neighbours", "distractors", "detection_rate", "precision", "position_rmse_m",
    "velocity_rmse_mps", "id_switches_per_min", "latency_ms",
}  # fmt: skip


def test_the_default_cases_cover_what_is_promised() -> None:
    bands = {int(case.range_m // 2) for case in CASES if case.scene in ("ring", "pass", "hover")}
    assert bands >= {0, 1, 2, 3, 4, 5}
    assert {case.neighbours for case in CASES} >= {1, 2, 4, 6, 10}
    for field in ("tape", "distractors", "windy"):
        assert {getattr(case, field) for case in CASES} == {True, False}
    assert {case.scene for case in CASES} == set(SCENES)


def test_wind_blows_in_windy_cases_only() -> None:
    for case in (*(case for case in CASES if case.windy), Case("ring", 4), Case("aggressive", 1)):
        assert (case.build(1).wind == HARD_WIND) == case.windy


def test_equal_flights_give_equal_scores_in_whichever_process() -> None:
    cases = [Case("hover", 1, 3.0), Case("hover", 2, 2.0)]
    runs: list[list[FlightScore]] = []
    for processes in (1, 2):
        found: list[FlightScore] = []
        measure(cases, [4], 2.0, lambda case, flown, to=found: to.append(flown), processes=processes)  # type: ignore[misc]
        runs.append(found)
    for alone, shared in zip(*runs, strict=True):
        assert len(alone.steps) > 0
        assert alone.sights.tobytes() == shared.sights.tobytes()
        assert alone.steps.tobytes() == shared.steps.tobytes()
        assert alone.switches == shared.switches


def test_the_command_flies_a_scene_and_writes_what_it_found(tmp_path: Path) -> None:
    fit = tmp_path / "fit" / "perception.yaml"
    options = ["--scenes", "hover", "--seconds", "9", "--processes", "1", "--json"]
    options += ["--out", str(tmp_path / "out"), "--fit", str(fit)]
    result = CliRunner().invoke(app, ["bench", "tracking", *options])
    assert result.exit_code == 0
    report = json.loads(result.stdout.strip().splitlines()[-1])
    assert all(set(row) >= NAMED for row in report["rows"])
    everything = report["rows"][0]
    assert everything["distractors"] is True
    assert everything["neighbours"] == 4
    assert everything["counted"] > 100
    assert everything["detection_rate"] > 0.9
    assert everything["precision"] > 0.9
    assert everything["position_rmse_m"] < 0.1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "tracking.html",
        "tracking.json",
        "tracking.md",
    ]
    model = yaml.safe_load(fit.read_text("utf-8"))
    assert model == report["perception"]
    assert 0.0 < model["position_sigma_m"] < 0.05
    assert 0.0 < model["velocity_sigma_mps"] < 0.3
    assert 0.0 < model["latency_s"] < 1.0


def test_a_scene_that_does_not_exist_is_refused_with_those_that_do() -> None:
    result = CliRunner().invoke(app, ["bench", "tracking", "--scenes", "ballet"])
    assert result.exit_code == 2
    assert "weave" in result.output
