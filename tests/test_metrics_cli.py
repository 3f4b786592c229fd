"""`companion metrics`: several logs in, one table row, one page, one JSON object out."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.cli import main
from companion.exit_codes import ExitCode
from companion.logs import metrics
from sitl.campaign.definition import CampaignDefinition
from tests.logs import swarm_flight as made_up
from tests.logs.swarm_flight import NAMES, STARTS, write_logs

Output = pytest.CaptureFixture[str]
TIMES = ["--from", "2.5", "--to", "11.4"]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return [str(path) for path in write_logs(tmp_path_factory.mktemp("flight"), truth=True)]


@pytest.fixture
def starts(tmp_path: Path) -> str:
    path = tmp_path / "starts.yaml"
    lines = ["starts:"]
    for name, start in STARTS.items():
        lines += [f"  {name}:", f"    position_m: {list(start.position_m)}", f"    yaw_deg: {start.yaw_deg}"]
    lines += ["waypoints_m:", "  - [5.0, 0.0, 1.5]", f"  - {list(made_up.GOAL)}"]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def expected() -> dict[str, float]:
    """The metrics of the true motion over the same times."""
    t = np.arange(2.5 + 0.006, 11.4 + 0.006, 0.05)
    p = np.array([[made_up.position(now, n) for n in range(3)] for now in t])
    v = np.array([[made_up.velocity(now, n) for n in range(3)] for now in t])
    found = metrics.measure(t, p, v, made_up.nearest_pillar(p), cap_m=3.0)
    return {name: getattr(found, name).mean for name in ("FR", "MS", "AL", "MDO")}


def last_json(capsys: Output) -> Any:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


@pytest.mark.parametrize("source", ["odometry", "truth"])
def test_both_ways_of_laying_logs_together_give_the_true_metrics(
    source: str, logs: list[str], starts: str, tmp_path: Path, capsys: Output
) -> None:
    given = ["--starts", starts] if source == "odometry" else ["--waypoint", "10,0,1.5"]
    page = tmp_path / "page.html"
    assert main(["metrics", *logs, *given, *TIMES, "--cap", "3", "-o", str(page), "--json"]) == ExitCode.OK
    found = last_json(capsys)
    assert found["source"] == source
    assert found["vehicles"] == list(NAMES)
    for name, value in expected().items():
        assert found[name] == pytest.approx(value, abs=0.015), name
    assert found["MDO_cap_m"] == 3.0
    assert found["MP"] > 90.0
    assert found["success"] is True
    assert found["notes"] == []
    assert found["page"] == str(page)


def test_the_page_shows_the_series_and_needs_no_network(
    logs: list[str], starts: str, tmp_path: Path, capsys: Output
) -> None:
    page = tmp_path / "page.html"
    assert main(["metrics", *logs, "--starts", starts, *TIMES, "-o", str(page)]) == ExitCode.OK
    text = page.read_text("utf-8")
    [figures] = re.findall(r"Object\.entries\((\{.*\})\)\) \{$", text, flags=re.MULTILINE)
    plots = json.loads(figures)
    assert list(plots) == ["paths", "fr", "ms", "al", "mdo"]
    separation = plots["ms"]["data"][0]
    assert len(separation["x"]) == len(separation["y"]) > 150
    assert separation["y"][0] == pytest.approx(1.6, abs=0.2)
    assert {"uav1 (leader)", "uav2", "uav3", "flock radius"} <= {t["name"] for t in plots["paths"]["data"]}
    assert "default-src 'none'" in text
    out = capsys.readouterr().out.splitlines()
    assert out[0].split() == ["UAVs", "FR", "(m)", "MS", "(m)", "AL", "MDO", "(m)"]
    assert re.fullmatch(r" +3( +\d\.\d\d ± \d\.\d\d){4}", out[1])
    assert out[-1] == str(page)


def test_mdo_has_the_cap_of_campaigns_unless_told_otherwise(
    logs: list[str], tmp_path: Path, capsys: Output
) -> None:
    given = ["metrics", *logs, *TIMES, "-o", str(tmp_path / "page.html")]
    for more, cap, said in (
        ([], metrics.DEFAULT_CAP_M, "MDO over moments with an obstacle within 4 m"),
        (["--cap", "2.5"], 2.5, "MDO over moments with an obstacle within 2.5 m"),
        (["--cap", "inf"], None, "MDO over all moments, without a cap"),
    ):
        assert main([*given, *more, "--json"]) == ExitCode.OK
        assert last_json(capsys)["MDO_cap_m"] == cap
        assert main([*given, *more]) == ExitCode.OK
        assert said in capsys.readouterr().out
        assert said in (tmp_path / "page.html").read_text("utf-8")
    assert CampaignDefinition.model_fields["obstacle_distance_cap_m"].default == metrics.DEFAULT_CAP_M


def test_help_says_the_cap(capsys: Output) -> None:
    main(["metrics", "--help"])
    told = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "[default: 4.0; x>=0.01]" in told
    assert "MDO_cap_m" in told


def test_a_start_on_the_command_line_goes_over_the_file(
    logs: list[str], starts: str, tmp_path: Path, capsys: Output
) -> None:
    more = ["--start", "uav2=0,3.6,0.15,100", "-o", str(tmp_path / "page.html"), "--json"]
    assert main(["metrics", *logs, "--starts", starts, *TIMES, *more]) == ExitCode.OK
    found = last_json(capsys)
    assert found["MS"] > 1.75
    assert found["success"] is True


def test_without_clouds_mdo_is_null_and_said(tmp_path: Path, capsys: Output) -> None:
    paths = [str(path) for path in write_logs(tmp_path, truth=True, clouds=False)]
    assert main(["metrics", *paths, "--json"]) == ExitCode.OK
    found = last_json(capsys)
    assert found["MDO"] is None
    assert found["notes"] == ["MDO: not known, for no log holds clouds at these times"]
    assert found["MP"] is None
    assert found["success"] is None
    assert Path(found["page"]) == tmp_path / "swarm.html"
    assert main(["metrics", *paths]) == ExitCode.OK
    assert "note: MDO: not known" in capsys.readouterr().out


def test_a_leader_far_from_its_goal_has_not_succeeded(
    logs: list[str], tmp_path: Path, capsys: Output
) -> None:
    more = ["--waypoint", "20,0,1.5", "-o", str(tmp_path / "page.html"), "--json"]
    assert main(["metrics", *logs, *TIMES, *more]) == ExitCode.OK
    found = last_json(capsys)
    assert found["success"] is False
    assert 40.0 < found["MP"] < 60.0


def test_mistakes_are_one_sentence_each(logs: list[str], starts: str, tmp_path: Path, capsys: Output) -> None:
    def refused(*arguments: str) -> tuple[int, str]:
        code = main(["metrics", *arguments])
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        return code, err

    assert refused(logs[0]) == (65, "1 log: a swarm needs 2 to 64, one of each UAV\n")
    assert refused(*logs, str(tmp_path / "gone.mcap"))[0] == ExitCode.NO_INPUT
    assert refused(*logs, "--start", "uav1=0,0,0,0")[1].startswith("no start pose of uav2, uav3")
    assert refused(*logs, "--waypoint", "1,2")[0] == ExitCode.DATA
    assert refused(*logs, "--from", "100")[1].startswith("the logs have no time in common")
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("starts:\n  uav1: {position: [0, 0, 0]}\n")
    code, text = refused(*logs, "--starts", str(wrong))
    assert code == ExitCode.CONFIG
    assert text.startswith(f"{wrong}:2:")
