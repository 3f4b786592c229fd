import pytest

from sitl.campaign import paper_numbers as paper
from sitl.campaign.paper_numbers import Published


def test_the_tables_of_simulations_are_complete() -> None:
    assert set(paper.COMPARISON) == {
        (metric, method, world)
        for metric in paper.METRICS
        for method in paper.METHODS
        for world in paper.WORLDS
    }
    assert set(paper.SCALABILITY) == {
        (metric, world, size) for metric in paper.METRICS for world in paper.GAPS for size in paper.FOLLOWERS
    }
    assert set(paper.REWARD_ABLATION) == {
        (metric, world, configuration)
        for metric in paper.METRICS
        for world in paper.GAPS
        for configuration in paper.CONFIGURATIONS
    }


def test_the_table_of_real_flights_is_complete() -> None:
    flown = {(metric, site) for metric in ("FR", "MS", "AL", "MDO") for site in paper.SITES}
    assert set(paper.REAL_FLIGHTS) == flown
    assert None not in paper.REAL_FLIGHTS.values()


def test_only_what_cannot_be_measured_has_no_number() -> None:
    for (metric, _, world), value in paper.COMPARISON.items():
        assert (value is None) == (metric == "MDO" and world == "none")
    for (metric, world, _), value in paper.SCALABILITY.items():
        assert (value is None) == (metric == "MDO" and world == "none")
    for (metric, world, configuration), value in paper.REWARD_ABLATION.items():
        never_flocked = configuration == "without_flocking" and metric != "SR"
        assert (value is None) == (never_flocked or (metric == "MDO" and world == "none"))


def test_the_proposed_method_has_the_same_numbers_in_all_tables() -> None:
    for metric in paper.METRICS:
        for world in paper.GAPS:
            expected = paper.COMPARISON[metric, paper.PROPOSED, world]
            assert paper.SCALABILITY[metric, world, 4] == expected
            assert paper.REWARD_ABLATION[metric, world, paper.PROPOSED] == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (paper.COMPARISON["SR", "vpf", "pillars_5m"], Published(27.0, 0.0, 1)),
        (paper.COMPARISON["MP", "reynolds_apf", "forest"], Published(69.1, 24.0, 1)),
        (paper.COMPARISON["FR", "pacnav", "none"], Published(1.80, 0.14, 2)),
        (paper.COMPARISON["MDO", "proposed", "simplified_forest"], Published(1.56, 0.09, 2)),
        (paper.SCALABILITY["SR", "pillars_5m", 8], Published(56.0, 0.0, 1)),
        (paper.SCALABILITY["MDO", "pillars_10m", 10], Published(1.68, 0.29, 2)),
        (paper.REWARD_ABLATION["MP", "pillars_5m", "without_stable"], Published(35.7, 29.3, 1)),
        (paper.REAL_FLIGHTS["MDO", "display_tower"], Published(5.82, 4.69, 2)),
        (paper.REAL_FLIGHTS["AL", "short_forest"], Published(0.74, 0.30, 2)),
        (paper.NEIGHBOURS["pillars_5m", 6], Published(46.0, None, 0)),
    ],
)
def test_numbers_stand_where_the_paper_has_them(value: Published | None, expected: Published) -> None:
    assert value == expected


def test_numbers_are_written_as_the_paper_prints_them() -> None:
    assert Published(1.8, 0.1, 2).text == "1.80 ± 0.10"
    assert Published(69.1, 24.0, 1).text == "69.1 ± 24.0"
    assert Published(100.0, 0.0, 1).text == "100.0"
    assert Published(46.0, None, 0).text == "46"


def test_success_by_neighbours_agrees_with_the_table_of_sizes() -> None:
    success = paper.SCALABILITY["SR", "pillars_5m", 10]
    assert success is not None
    assert paper.NEIGHBOURS["pillars_5m", 6].mean == success.mean
