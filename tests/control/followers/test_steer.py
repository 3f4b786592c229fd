"""What holds for every law."""

from pathlib import Path

import numpy as np
import pytest

from companion.control.followers import layout_kernels as layout
from companion.control.followers.laws_kernels import steer
from companion.control.followers.settings import METHODS, FollowerSettings, gains_of, with_gains
from companion.perception.occupancy import GridSettings
from tests.control.followers.situations import Follower, drawn, free, others, own

NOT_NUMBERS = [np.nan, np.inf, -np.inf]


@pytest.mark.parametrize("method", METHODS)
def test_commands_keep_the_limits_whatever_happens(method: str) -> None:
    rng = np.random.default_rng(3)
    settings = FollowerSettings()
    follower = Follower(method, settings)
    before = np.zeros(3)
    for _ in range(300):
        ego, neighbours, ranges = drawn(rng)
        ego[6] = 0.0
        command = follower.steer(ego, neighbours, ranges)
        assert np.isfinite(command).all()
        assert np.linalg.norm(command) <= settings.command.max_speed_mps + 1e-9
        assert abs(command[2]) <= settings.command.max_vertical_speed_mps + 1e-9
        assert np.linalg.norm(command - before) <= 4.0 * ego[8] + 1e-9
        before = command


@pytest.mark.parametrize("method", METHODS)
def test_touching_neighbours_and_walls_give_finite_commands(method: str) -> None:
    follower = Follower(method)
    for place in ((0.0, 0.0, 0.0), (1e-12, 0.0, 0.0), (0.0, 0.0, 0.3)):
        for _ in range(5):
            assert np.isfinite(follower.steer(own(), others(place, place), np.zeros((72, 12)))).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("bad", NOT_NUMBERS)
def test_what_is_not_a_number_gives_zero(method: str, bad: float) -> None:
    for index in range(layout.EGO_ALONE):
        ego = own()
        ego[index] = bad
        follower = Follower(method)
        assert follower.steer(ego, others((2.0, 0.0, 0.0))).tolist() == [0.0, 0.0, 0.0]
    for index in range(layout.NEIGHBOUR_SIZE):
        rows = others((2.0, 0.0, 0.0))
        rows[0, index] = bad
        assert Follower(method).steer(own(), rows).tolist() == [0.0, 0.0, 0.0]
    if bad != np.inf:
        ranges = free()
        ranges[17, 3] = bad
        assert Follower(method).steer(own(), others((2.0, 0.0, 0.0)), ranges).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("method", METHODS)
def test_after_a_bad_input_it_starts_again_from_standstill(method: str) -> None:
    follower = Follower(method)
    follower.settle(own(), others((4.0, 1.0, 0.0)))
    follower.steer(own(p=(np.nan, 0.0, 1.5)), others())
    assert np.linalg.norm(follower.steer(own(), others((4.0, 1.0, 0.0)))) <= 4.0 * 0.05 + 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_the_map_and_its_heading_do_not_matter(method: str) -> None:
    """The same flight in a map that is turned and shifted gives the same commands in the heading frame."""
    here, there = Follower(method), Follower(method)
    rng = np.random.default_rng(11)
    shift = np.array([100.0, -40.0])
    angle = 2.0
    c, s = np.cos(angle), np.sin(angle)
    for _ in range(40):
        ego, neighbours, ranges = drawn(rng)
        ego[:2] *= 0.1
        moved = ego.copy()
        moved[:2] = np.array([[c, -s], [s, c]]) @ ego[:2] + shift
        moved[6] += angle
        expected = here.steer(ego, neighbours, ranges)
        assert there.steer(moved, neighbours, ranges) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_equal_inputs_give_equal_bytes(method: str) -> None:
    def flight() -> bytes:
        rng = np.random.default_rng(2)
        follower = Follower(method)
        return b"".join(follower.steer(*drawn(rng)).tobytes() for _ in range(50))

    assert flight() == flight()


def test_an_unknown_law_asks_for_nothing() -> None:
    command = np.ones(3)
    memory = np.zeros(layout.MEMORY_SIZE)
    steer(99, own(), others((2.0, 0.0, 0.0)), free(), memory, FollowerSettings().packed(), command)
    assert command.tolist() == [0.0, 0.0, 0.0]


def test_every_gain_stands_where_its_law_looks_for_it() -> None:
    """The order of a section's fields is the order of its parameters in `layout_kernels`."""
    prefixes = {
        "flock": "FLOCK",
        "pacnav": "PACNAV",
        "vpf": "VPF",
        "vpf_polar": "POLAR",
        "reynolds_apf": "REYNOLDS",
        "lloyd": "LLOYD",
    }
    source = Path(layout.__file__).read_text(encoding="utf-8")
    for method, prefix in prefixes.items():
        count = len(gains_of(method))
        text = source.split(f"# Parameters of `{method}`.")[1].split("\n\n")[0]
        places = [int(line.split(" = ")[1]) for line in text.splitlines() if line.startswith(prefix)]
        assert places == list(range(layout.LAW_PARAMETERS, layout.LAW_PARAMETERS + count)), method
    assert max(len(gains_of(method)) for method in METHODS) + layout.LAW_PARAMETERS <= layout.PARAMETER_COUNT


@pytest.mark.parametrize("method", METHODS)
def test_every_gain_has_bounds_around_its_default(method: str) -> None:
    for gain in gains_of(method):
        assert -np.inf < gain.low <= gain.default <= gain.high < np.inf, gain


def test_changed_gains_are_packed_and_checked() -> None:
    changed = with_gains(FollowerSettings(), "lloyd", {"spacing_m": 1.7})
    assert changed.method == "lloyd"
    assert changed.packed()[layout.LLOYD_SPACING] == 1.7
    assert FollowerSettings().packed("lloyd")[layout.LLOYD_SPACING] == 1.0
    with pytest.raises(ValueError, match="spacing"):
        with_gains(FollowerSettings(), "lloyd", {"spacing_m": 50.0})
    with pytest.raises(ValueError, match="spacin"):
        with_gains(FollowerSettings(), "lloyd", {"spacin_m": 1.0})
    with pytest.raises(KeyError, match="no law 'locust'"):
        FollowerSettings().packed("locust")


def test_the_laws_know_the_grid_that_perception_makes() -> None:
    grid = GridSettings()
    assert (grid.azimuths, grid.elevations) == (layout.AZIMUTHS, layout.ELEVATIONS)
    assert grid.lowest_elevation_deg == layout.LOWEST_ELEVATION_DEG
    assert grid.highest_elevation_deg == layout.HIGHEST_ELEVATION_DEG
    assert len({*layout.METHOD_IDS.values()}) == len(METHODS)
