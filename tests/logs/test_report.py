import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.errors import LogError
from companion.logs import channels
from companion.logs.channels import CHANNELS
from companion.logs.container import MAGIC
from companion.logs.records import CloudView, ScanMark, StampedPose
from companion.logs.report import write_report
from companion.logs.report_data import Table, phases
from companion.logs.report_plots import _thinned
from companion.logs.views import LEVEL_BAND_M, mark_of
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import (
    FlightState,
    PlanUpdate,
    RegisteredScan,
    Setpoint,
    Severity,
    StateChange,
    StatusText,
)
from tests.logs import synthetic_flight as made_up
from tests.logs.samples import METADATA, odometry, one_of_each, vehicle_state


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    made_up.write_flight(path, raw=True)
    return path


@pytest.fixture(scope="module")
def reported(flight: Path) -> tuple[dict[str, Any], str]:
    page = flight.with_suffix(".html")
    return write_report(flight, page), page.read_text(encoding="utf-8")


class Elements(HTMLParser):
    """Collects elements, their attributes and the text of scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1][0] == "script":
            self.scripts[-1] += data
        else:
            self.words.append(data)


def figures_in(page: str) -> dict[str, Any]:
    found = re.search(r"^const figures = (.*);$", page, re.MULTILINE)
    assert found is not None
    figures: dict[str, Any] = json.loads(found[1])
    return figures


def test_the_numbers_are_those_of_the_flight(reported: tuple[dict[str, Any], str]) -> None:
    numbers, _ = reported
    t = np.linspace(0.0, made_up.DURATION_S, 20_000)
    p = np.array([made_up.true_state(moment)[0] for moment in t])
    v = np.array([made_up.true_state(moment)[1] for moment in t])
    flown = np.linalg.norm(np.diff(p, axis=0), axis=1).sum()
    assert numbers["flight"]["duration_s"] == pytest.approx(31.0)
    assert numbers["flight"]["airborne_s"] == pytest.approx(27.8, abs=0.03)
    assert numbers["motion"]["distance_m"] == pytest.approx(flown, rel=0.02)
    assert numbers["motion"]["max_speed_mps"] == pytest.approx(np.linalg.norm(v, axis=1).max(), rel=0.01)
    assert numbers["motion"]["max_height_m"] == pytest.approx(1.5)
    assert numbers["goal"]["reached"]
    assert numbers["goal"]["reached_s"] == pytest.approx(26.4)
    assert numbers["goal"]["nearest_m"] == pytest.approx(0.17, abs=0.04)
    assert numbers["latency_ms"]["p50"] == pytest.approx(made_up.LATENCY_MS)
    assert numbers["latency_ms"]["p99"] == pytest.approx(made_up.LATENCY_MS)
    assert numbers["setpoints"]["gap_ms"]["p50"] == pytest.approx(20.0)
    assert numbers["setpoints"]["gap_ms"]["max"] == pytest.approx(made_up.GAP_MS, abs=20.1)
    assert numbers["setpoints"]["rate_hz"] == pytest.approx(49.7, abs=0.2)
    assert numbers["setpoints"]["age_ms"]["max"] == pytest.approx(10.0)
    assert numbers["lidar"]["lost"] == made_up.LOST_PACKETS
    assert numbers["lidar"]["packets"] == 2083 * 31
    assert numbers["lidar"]["loss_percent"] == pytest.approx(100.0 * 120 / (2083 * 31 + 120))


def test_control_and_failsafes_are_those_of_the_flight(reported: tuple[dict[str, Any], str]) -> None:
    numbers, _ = reported
    control = numbers["control"]
    assert control["companion_percent"] == pytest.approx(100.0 * (27.2 - 5.6) / 27.8, abs=0.2)
    assert control["pilot_percent"] == pytest.approx(100.0 * (5.6 - 2.2) / 27.8, abs=0.2)
    assert control["autopilot_percent"] == pytest.approx(100.0 * (30.0 - 27.2) / 27.8, abs=0.2)
    assert [(one["t_s"], one["what"], one["severe"]) for one in numbers["failsafes"]] == [
        (15.0, "holding", False)
    ]
    assert numbers["odometry"]["degraded_percent"] == pytest.approx(2.0, abs=0.1)
    assert numbers["odometry"]["quality_min"] == 20
    assert numbers["odometry"]["rate_hz"] == pytest.approx(10.0)


def test_the_error_is_the_drift_that_was_put_in(reported: tuple[dict[str, Any], str]) -> None:
    accuracy = reported[0]["accuracy"]
    assert accuracy["end_error_m"] == pytest.approx(made_up.DRIFT * made_up.LENGTH_M, abs=1e-3)
    assert accuracy["drift_percent"] == pytest.approx(100.0 * 0.2 / accuracy["true_path_m"], abs=0.01)
    assert 0.0 < accuracy["ape_rmse_m"] < 0.1


def test_the_closest_obstacle_is_the_pillar_beside_the_path(reported: tuple[dict[str, Any], str]) -> None:
    numbers, page = reported
    t = np.linspace(4.0, 28.0, 5000)
    p = np.array([made_up.estimate(moment, 0).p_map for moment in t])
    distances = [np.linalg.norm(p[:, :2] - pillar, axis=1) for pillar in made_up.PILLARS]
    expected = np.min(distances) - made_up.PILLAR_RADIUS_M
    assert numbers["obstacles"]["closest_m"] == pytest.approx(expected, abs=0.08)
    obstacles = next(trace for trace in figures_in(page)["top"]["data"] if trace["name"] == "obstacles")
    drawn = np.column_stack([obstacles["x"], obstacles["y"]])
    to_pillars = np.min([np.linalg.norm(drawn - pillar, axis=1) for pillar in made_up.PILLARS], axis=0)
    assert to_pillars.max() < made_up.PILLAR_RADIUS_M + 0.15, "the ground is no obstacle"


def test_the_verdict_has_ten_lines_and_names_what_to_look_at(reported: tuple[dict[str, Any], str]) -> None:
    numbers, page = reported
    lines = numbers["verdict"]["lines"]
    assert len(lines) == 10
    assert numbers["verdict"]["lamp"] == "amber"
    assert {line["title"] for line in lines if line["lamp"] != "green"} == {"Failsafes", "Odometry"}
    words = " ".join(Elements(page).words)
    for line in lines:
        assert line["text"] in words


def test_the_page_holds_all_plots_and_loads_nothing(reported: tuple[dict[str, Any], str]) -> None:
    numbers, page = reported
    elements = Elements(page)
    figures = figures_in(page)
    assert list(figures) == [
        "top", "height", "velocity_x", "velocity_y", "velocity_z",
        "error", "health", "latency", "gaps", "loss", "clock",
    ]  # fmt: skip
    identifiers = [attributes.get("id") for _, attributes in elements.tags]
    assert all(f"plot-{name}" in identifiers for name in figures)
    for tag, attributes in elements.tags:
        assert tag not in {"link", "iframe", "img", "object", "embed", "base", "form"}
        assert not {"src", "href", "srcset", "action", "background"} & attributes.keys(), (tag, attributes)
    policy = [a["content"] for tag, a in elements.tags if tag == "meta" and "http-equiv" in a]
    assert policy == [
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
    ]
    own = [text for text in elements.scripts if len(text) < 2_000_000]
    assert len(own) == len(elements.scripts) - 1 == 2
    assert not any("http" in text for text in own)
    style = page[page.index("<style>") : page.index("</style>")]
    assert "http" not in style
    assert "url(" not in style
    assert "@import" not in style
    stored = next(text for text in own if text.startswith("{"))
    assert json.loads(stored) == numbers


def test_the_same_log_gives_the_same_page(flight: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.html", tmp_path / "b.html"
    write_report(flight, first)
    write_report(flight, second)
    assert first.read_bytes() == second.read_bytes()


def test_nothing_from_the_log_becomes_markup(tmp_path: Path) -> None:
    attack = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    path = tmp_path / "<b>bold & co.mcap"
    metadata = METADATA.__class__(
        vehicle=attack,
        role="leader",
        mode="wire",
        configuration=attack,
        git_commit=attack,
        versions={attack: attack},
    )
    log = FlightLog(path, LogSettings(), metadata, threaded=False)
    log.record(vehicle_state(0), 0)
    log.record(StateChange(1, FlightState.READY, FlightState.LOST, attack), 1)
    log.record(StatusText(2, Severity.ERROR, attack), 2)
    log.record(PlanUpdate(3, np.zeros((2, 3)), np.zeros(3), 0, attack), 3)
    log.record(Setpoint(4, 4, 0, np.zeros(3), 0.0, attack), 4)
    log.close()
    numbers = write_report(path, tmp_path / "page.html")
    elements = Elements((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert len(elements.scripts) == 3
    assert not any(tag in {"img", "b"} and attributes for tag, attributes in elements.tags)
    assert all("onerror" not in attributes for _, attributes in elements.tags)
    assert numbers["failsafes"][0]["reason"] == attack
    assert attack in " ".join(elements.words)


@pytest.mark.parametrize("left_out", CHANNELS, ids=lambda channel: channel.topic)
def test_any_channel_may_be_missing(left_out: channels.Channel, tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "a.mcap", LogSettings(imu=True), METADATA, threaded=False)
    for channel, message in one_of_each().items():
        if channel is not left_out:
            log.write(channel, message, 123_456_789_012)
    log.close()
    numbers = write_report(tmp_path / "a.mcap", tmp_path / "a.html")
    assert len(numbers["verdict"]["lines"]) == 10
    json.dumps(numbers, allow_nan=False)


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.topic)
def test_a_log_may_hold_a_single_message(channel: channels.Channel, tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "a.mcap", LogSettings(imu=True), METADATA, threaded=False)
    log.write(channel, one_of_each()[channel], 123_456_789_012)
    log.close()
    numbers = write_report(tmp_path / "a.mcap", tmp_path / "a.html")
    json.dumps(numbers, allow_nan=False)


@pytest.mark.parametrize("size", [0, 3, len(MAGIC), 60, 600, 5000, 50_000, 200_000])
def test_half_a_log_gives_a_report_that_says_so(size: int, flight: Path, tmp_path: Path) -> None:
    part = tmp_path / "part.mcap.open"
    part.write_bytes(flight.read_bytes()[:size])
    numbers = write_report(part, tmp_path / "part.html")
    assert not numbers["log"]["complete"]
    assert numbers["log"]["bytes_total"] == size
    log_line = numbers["verdict"]["lines"][-1]
    assert log_line["lamp"] == "amber"
    assert "not closed properly" in log_line["text"]


def test_a_file_that_is_no_log_is_refused_and_no_page_is_left(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"%PDF-1.7 something")
    with pytest.raises(LogError, match="no MCAP file"):
        write_report(tmp_path / "a.mcap", tmp_path / "a.html")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_page_that_cannot_be_written_is_one_clear_error(flight: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be written"):
        write_report(flight, tmp_path / "missing" / "a.html")


def test_nonsense_numbers_in_a_log_give_a_report_all_the_same(tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "a.mcap", LogSettings(), METADATA, threaded=False)
    nan, huge = np.full(3, np.nan), np.full(3, 1e300)
    rng = np.random.default_rng(1)
    for index, vector in enumerate((nan, huge, -huge, nan)):
        state = odometry(index, rng)
        object.__setattr__(state, "p_map", vector)
        object.__setattr__(state, "covariance_pose", np.full((6, 6), -1.0))
        log.record(state, index)
        log.write(channels.TRUTH, StampedPose(index, "world", -vector, np.zeros(4)), index)
        log.record(Setpoint(-(2**62), 2**62, 1, vector, 1e308, ""), index)
        log.record(PlanUpdate(index, np.array([vector, vector]), vector, -5, ""), index)
        log.write(
            channels.CLOUD, CloudView(index, np.full((9, 3), np.inf, np.float32), np.zeros(9, np.uint8)), 0
        )
        log.write(channels.SCAN, ScanMark(index, 0, 0, 0, float("inf")), index)
    log.close()
    numbers = write_report(tmp_path / "a.mcap", tmp_path / "a.html")
    json.dumps(numbers, allow_nan=False)


def test_the_mark_of_a_scan_knows_the_nearest_point_at_flight_level() -> None:
    rng = np.random.default_rng(6)
    state = odometry(0, rng)
    inside, outside = LEVEL_BAND_M - 0.01, LEVEL_BAND_M + 0.01
    offsets = np.array([[3.0, 4.0, inside], [0.0, -6.0, 0.0], [0.1, 0.0, -outside], [0.0, 0.2, outside]])
    points = (state.p_map + offsets).astype(np.float32)
    scan = RegisteredScan(0, 1, points, np.zeros(4, np.uint8), state, np.zeros(4, np.int32))
    assert mark_of(scan).nearest_m == pytest.approx(5.0, abs=1e-5)
    empty = RegisteredScan(0, 1, points[2:], np.zeros(2, np.uint8), state, np.zeros(2, np.int32))
    assert np.isnan(mark_of(empty).nearest_m)


def test_thinning_keeps_every_spike() -> None:
    y = np.zeros(100_000)
    y[[7, 54_321, 99_999]] = [5.0, -7.0, 9.0]
    kept = _thinned(y)
    assert len(kept) <= 2400
    assert {7, 54_321, 99_999} <= set(kept.tolist())
    assert np.all(np.diff(kept) >= 0)


def test_phases_join_repeats_and_end_with_the_flight() -> None:
    found = phases([(0.0, "a"), (1.0, "a"), (2.0, "b"), (5.0, "a")], 9.0)
    assert [(one.start_s, one.end_s, one.label) for one in found] == [
        (0.0, 2.0, "a"),
        (2.0, 5.0, "b"),
        (5.0, 9.0, "a"),
    ]
    assert phases([], 1.0) == []


def test_a_table_returns_what_was_added() -> None:
    table = Table("t x y")
    table.add(1.0, 2.0, 3.0)
    table.add(4.0, 5.0, 6.0)
    assert table["x"].tolist() == [2.0, 5.0]
    assert table["x y"].tolist() == [[2.0, 3.0], [5.0, 6.0]]
    assert (table.first("y"), table.last("x"), len(table)) == (3.0, 5.0, 2)
    with pytest.raises(ValueError, match="2 values"):
        table.add(1.0, 2.0)
