"""What a follower's law was given, in the log and out of it."""

import json
from pathlib import Path

import numpy as np
import pytest

from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.logs.records import GivenNeighbours, GridView
from companion.logs.report import write_report
from companion.logs.views import EMPTY_CELL, FARTHEST_CELL, GRID_STEP_M, ranges_of, views_of
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import FloatArray, Neighbours, Surroundings
from tests.logs.samples import METADATA

T_NS = 7_000_000_000


def seen(t_ns: int = T_NS, *, others: int = 2, ranges: FloatArray | None = None) -> Surroundings:
    states = np.zeros((6, 7))
    ids, ages = np.full(6, -1), np.zeros(6)
    for row in range(others):
        states[row] = [1.5 + row, 0.0, 0.1, 0.2, -0.3, 0.0, 1.0]
        ids[row], ages[row] = 40 + row, 0.05 * (row + 1)
    if ranges is None:
        ranges = np.full((72, 12), np.inf)
        ranges[3, 4] = 2.34
    given = Neighbours(t_ns - 5, ids, states, np.zeros((6, 6, 6)), ages)
    return Surroundings(t_ns, given, t_ns - 50_000_000, 0.3, ranges)


def written(path: Path, *messages: Surroundings, on: bool = True) -> Path:
    log = FlightLog(path, LogSettings(surroundings=on), METADATA, threaded=False)
    for message in messages:
        log.record(message, message.t_ns)
    log.close()
    return path


def test_only_those_who_were_there_are_written() -> None:
    [(channel, view), _] = views_of(seen())
    assert channel is channels.GIVEN
    assert isinstance(view, GivenNeighbours)
    assert (view.t_ns, view.t_valid_ns) == (T_NS, T_NS - 5)
    assert [(other.track_id, other.age_s) for other in view.neighbours] == [(40, 0.05), (41, 0.1)]
    assert view.neighbours[1].p_heading.tolist() == [2.5, 0.0, 0.1]
    assert view.neighbours[1].v_heading.tolist() == [0.2, -0.3, 0.0]


@pytest.mark.parametrize("farthest_m", [9.99, FARTHEST_CELL * GRID_STEP_M, 60.0])
def test_a_grid_comes_back_to_within_its_resolution_and_never_too_far(farthest_m: float) -> None:
    ranges = np.random.default_rng(1).uniform(0.25, farthest_m, size=(72, 12))
    ranges[::3] = np.inf
    ranges[1, 1] = farthest_m
    [_, (channel, view)] = views_of(seen(ranges=ranges))
    assert channel is channels.GRID
    assert isinstance(view, GridView)
    back = ranges_of(view)
    assert np.array_equal(np.isinf(back), np.isinf(ranges))
    known = np.isfinite(ranges)
    short = ranges[known] - back[known]
    assert short.min() > -1e-9
    assert short.max() <= view.resolution_m + 1e-9
    assert view.resolution_m == max(GRID_STEP_M, farthest_m / FARTHEST_CELL)
    assert EMPTY_CELL > FARTHEST_CELL


def test_an_empty_grid_stays_empty() -> None:
    [_, (_, view)] = views_of(seen(ranges=np.full((72, 12), np.inf)))
    assert isinstance(view, GridView)
    assert np.isinf(ranges_of(view)).all()


def test_a_grid_with_other_cells_than_it_says_is_refused() -> None:
    with pytest.raises(ValueError, match="3 cells in a grid of 2 x 2"):
        ranges_of(GridView(0, 0, 0.0, 2, 2, 0.05, "AAAA"))


def test_both_channels_can_be_switched_off(tmp_path: Path) -> None:
    def topics(path: Path) -> list[str]:
        return [entry.channel.topic for entry in FlightRecording(path).messages()]

    assert topics(written(tmp_path / "on.mcap", seen())) == ["/follower/neighbours", "/follower/grid"]
    assert topics(written(tmp_path / "off.mcap", seen(), on=False)) == []


def test_ten_a_second_take_little_room(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    messages = [
        seen(T_NS + 100_000_000 * index, ranges=rng.uniform(0.3, 10.0, size=(72, 12))) for index in range(100)
    ]
    assert written(tmp_path / "a.mcap", *messages).stat().st_size < 10 * 20_000


def test_equal_flights_give_equal_bytes(tmp_path: Path) -> None:
    first, second = (written(tmp_path / name, seen()) for name in ("a.mcap", "b.mcap"))
    assert first.read_bytes() == second.read_bytes()


def test_a_followers_report_shows_them_over_time(tmp_path: Path) -> None:
    messages = [seen(T_NS + 100_000_000 * index, others=index % 3) for index in range(9)]
    page = tmp_path / "page.html"
    numbers = write_report(written(tmp_path / "a.mcap", *messages), page)
    found = numbers["surroundings"]
    assert found["neighbours_mean"] == pytest.approx(1.0)
    assert found["neighbours_least"] == 0
    assert found["alone_share"] == pytest.approx(1.0 / 3.0)
    assert found["nearest_neighbour_m"] == pytest.approx(np.hypot(1.5, 0.1))
    assert found["nearest_obstacle_m"] == pytest.approx(2.3, abs=1e-9)
    text = page.read_text("utf-8")
    assert "Neighbours and obstacles" in text
    json.dumps(numbers, allow_nan=False)


def test_the_report_of_a_leader_has_no_such_plot(tmp_path: Path) -> None:
    numbers = write_report(written(tmp_path / "a.mcap"), tmp_path / "page.html")
    assert numbers["surroundings"] is None
    assert "Neighbours and obstacles" not in (tmp_path / "page.html").read_text("utf-8")
