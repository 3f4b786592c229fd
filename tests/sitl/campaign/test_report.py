import json
import re
from pathlib import Path

import numpy as np
import pytest

from companion.errors import LogError
from sitl.campaign.cases import summarise
from sitl.campaign.definition import CampaignDefinition
from sitl.campaign.plots import ends, figure_boxes, success_by_world
from sitl.campaign.plots_trial import outline, plan_view
from sitl.campaign.report import HTML, INDEX, LATEX, MARKDOWN, write_report
from sitl.campaign.tables_labels import Labels
from sitl.swarm.record import TrialRecord
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Sphere, World
from sitl.worlds.raycast_kernels import BOX, CAPSULE, SPHERE
from tests.sitl.campaign.made_up_trials import campaign, trial

DEFINITION = CampaignDefinition(
    title="Two & a half <methods>",
    table="comparison",
    worlds=["none", "pillars_10m", "pillars_5m"],
    methods=["pacnav", "flock"],
)


def log_of(record: TrialRecord) -> str | None:
    return f"trials/{record.world}-{record.method}-{record.trial}.mcap" if record.trial == 1 else None


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    files = write_report(folder, campaign(), DEFINITION, log_of)
    assert [file.name for file in files] == [MARKDOWN, LATEX, HTML, INDEX]
    assert sorted(file.name for file in folder.iterdir()) == sorted(file.name for file in files)
    return folder


def test_every_file_holds_both_sides_of_the_table(reported: Path) -> None:
    for name, plus in ((MARKDOWN, "±"), (LATEX, r"$\pm$"), (HTML, "±"), (INDEX, "±")):
        text = (reported / name).read_text("utf-8")
        assert f"1.80 {plus} 0.14" in text, name
        assert "ours, abstract" in text
        assert "MDO is capped at 4 m" in text


def test_the_pages_need_no_network_and_escape_what_they_are_told(reported: Path) -> None:
    for name in (HTML, INDEX):
        text = (reported / name).read_text("utf-8")
        assert "default-src 'none'" in text
        assert "<title>Two &amp; a half &lt;methods&gt;</title>" in text
        assert not re.search(r'<(script|link|img)[^>]+(src|href)="http', text)
    assert "Plotly.newPlot" in (reported / INDEX).read_text("utf-8")
    assert "Plotly" not in (reported / HTML).read_text("utf-8")


def test_every_plot_has_its_place_and_its_data(reported: Path) -> None:
    text = (reported / INDEX).read_text("utf-8")
    [figures] = re.findall(r"Object\.entries\((\{.*\})\)\) \{$", text, flags=re.MULTILINE)
    names = set(json.loads(figures))
    assert names == set(re.findall(r'id="plot-([a-z-]+)"', text))
    assert {"success", "metric-fr", "metric-mdo", "ends"} <= names


def test_trials_are_listed_with_links_to_their_logs(reported: Path) -> None:
    text = (reported / INDEX).read_text("utf-8")
    assert 'href="trials/pillars_5m-flock-1.mcap"' in text
    failed = sum(record.end != "success" for record in campaign() if record.world == "pillars_5m")
    listed = text[text.index("<h2>Trials</h2>") :]
    assert listed.count("<td>pillars_5m-4-") >= failed > 0


def test_equal_trials_give_equal_files_in_whatever_order_they_come(reported: Path, tmp_path: Path) -> None:
    records = campaign()
    shuffled = [records[index] for index in np.random.default_rng(1).permutation(len(records))]
    write_report(tmp_path, shuffled, DEFINITION, log_of)
    for file in reported.iterdir():
        assert file.read_bytes() == (tmp_path / file.name).read_bytes(), file.name


def test_without_a_trial_there_is_nothing_to_report(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no trial has been flown"):
        write_report(tmp_path, [], DEFINITION)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be written"):
        write_report(tmp_path / "gone", [trial()], DEFINITION)


def test_bars_carry_wilson_intervals_and_the_papers_marks() -> None:
    records = campaign(("pillars_5m",), ("pacnav",), trials=10)
    [case] = summarise(records)
    bar, mark, proposed = success_by_world([case], Labels.of(DEFINITION))["data"]
    assert bar["y"] == [pytest.approx(case.SR)]
    assert bar["y"][0] - bar["error_y"]["arrayminus"][0] == pytest.approx(case.SR_ci95[0], abs=2e-3)
    assert bar["y"][0] + bar["error_y"]["array"][0] == pytest.approx(case.SR_ci95[1], abs=2e-3)
    assert mark["y"] == [82.0]
    assert (proposed["name"], proposed["y"]) == ("paper, Proposed", [97.0])


def test_sizes_and_neighbours_are_drawn_where_they_vary() -> None:
    def names(records: list[TrialRecord]) -> set[str]:
        return {box.name for box in figure_boxes(summarise(records), Labels.of(DEFINITION))}

    assert not {"sizes", "neighbours"} & names(campaign(trials=4))
    assert "sizes" in names(campaign(("none",), ("flock",), (2, 4), trials=4))
    assert "neighbours" in names(campaign(("none",), ("flock_k3", "flock_k6"), (10,), trials=4))
    assert figure_boxes([], Labels()) == []


def test_perceptions_are_drawn_in_the_order_of_the_file() -> None:
    definition = CampaignDefinition.model_validate_json(
        '{"title": "T", "worlds": ["none"], "methods": ["flock"], '
        '"perceptions": [{"name": "late"}, {"name": "early"}]}'
    )
    cases = summarise(campaign(("none",), ("flock@early", "flock@late"), trials=4))
    boxes = {box.name: box.figure for box in figure_boxes(cases, Labels.of(definition))}
    [line] = boxes["perceptions"]["data"]
    assert (line["x"], line["y"]) == (["late", "early"], [100.0, 100.0])
    assert boxes["perceptions"]["layout"]["xaxis"]["categoryarray"] == ["late", "early"]


def test_the_stack_of_ends_adds_up_to_all_trials() -> None:
    cases = summarise(campaign())
    stacks = ends(cases)["data"]
    for index in range(len(cases)):
        assert sum(trace["x"][index] for trace in stacks) == pytest.approx(100.0, abs=0.01)


class TestPlanView:
    def test_a_box_is_turned_by_its_yaw(self) -> None:
        world = World.of([Box(centre_world_m=(5, 1, 1), size_m=(4, 2, 2), yaw_deg=90)])
        corners = outline(BOX, world.rows[0])
        assert corners.min(axis=0) == pytest.approx([4.0, -1.0])
        assert corners.max(axis=0) == pytest.approx([6.0, 3.0])

    def test_a_ball_is_a_circle_and_a_tilted_rod_reaches_from_end_to_end(self) -> None:
        world = World.of(
            [
                Sphere(centre_world_m=(1, 2, 3), radius_m=0.5),
                Capsule(start_world_m=(0, 0, 0), end_world_m=(3, 0, 4), radius_m=0.25),
            ]
        )
        circle = outline(SPHERE, world.rows[0])
        assert np.linalg.norm(circle - [1, 2], axis=1) == pytest.approx(0.5)
        rod = outline(CAPSULE, world.rows[1])
        assert rod.min(axis=0) == pytest.approx([-0.25, -0.25])
        assert rod.max(axis=0) == pytest.approx([3.25, 0.25])

    def test_paths_lie_over_the_obstacles_that_are_near(self) -> None:
        near = Cylinder(start_world_m=(2, 2, 0), end_world_m=(2, 2, 5), radius_m=0.3)
        far = Cylinder(start_world_m=(90, 2, 0), end_world_m=(90, 2, 5), radius_m=0.3)
        p = np.zeros((1500, 3, 3))
        p[:, :, 0] = np.linspace(0, 10, 1500)[:, None] + [0, 1, 2]
        figure = plan_view(p, World.of([Ground(), near, far]), np.array([[10.0, 0, 1]]))
        traces = {trace["name"]: trace for trace in figure["data"]}
        assert {"leader", "follower 1", "follower 2", "obstacles", "waypoints"} <= set(traces)
        drawn = [x for x in traces["obstacles"]["x"] if x is not None]
        assert max(drawn) == pytest.approx(2.3)
        assert len(traces["leader"]["x"]) <= 600
        json.dumps(figure, allow_nan=False)
