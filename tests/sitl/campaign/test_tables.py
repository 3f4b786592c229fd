import pytest

from sitl.campaign.cases import compare_all, summarise
from sitl.campaign.definition import CampaignDefinition
from sitl.campaign.report import tables_of
from sitl.campaign.tables import (
    cases_table,
    comparison_table,
    failures_table,
    neighbours_table,
    paired_table,
    perceptions_table,
    real_scenes_table,
    scalability_table,
)
from sitl.campaign.tables_labels import Labels, split_neighbours, split_perception
from sitl.campaign.tables_rendering import Row, Table, html_table, latex, markdown
from sitl.swarm.record import TrialRecord
from tests.sitl.campaign.made_up_trials import campaign, trial

WORLDS = ("none", "pillars_10m", "pillars_5m", "simplified_forest", "forest")
METHODS = ("pacnav", "vpf", "reynolds_apf", "flock")


def labels_of(records: list[TrialRecord]) -> Labels:
    return Labels.of(
        CampaignDefinition(
            title="T",
            worlds=list(dict.fromkeys(record.world for record in records)),
            methods=list(dict.fromkeys(split_neighbours(record.method)[0] for record in records)),
        )
    )


def found(table: Table | None) -> Table:
    assert table is not None
    return table


def row_of(table: Table, *names: str) -> list[str]:
    [row] = [row for row in table.rows if row.cells[: len(names)] == names]
    return list(row.cells[len(table.names) :])


def test_the_comparison_holds_the_papers_rows_beside_ours() -> None:
    records = campaign(WORLDS, METHODS, trials=10)
    table = found(comparison_table(summarise(records), labels_of(records), 4.0))
    assert table.values == (
        "No obstacles",
        "Pillars, 10 m gap",
        "Pillars, 5 m gap",
        "Simplified forest",
        "Forest",
    )
    assert row_of(table, "SR (%)", "VPF", "paper") == ["100.0", "80.0", "27.0", "6.0", "5.0"]
    assert row_of(table, "FR (m)", "PACNav", "paper")[0] == "1.80 ± 0.14"
    assert row_of(table, "MDO (m)", "Proposed", "paper")[:2] == ["–", "2.27 ± 0.15"]
    assert row_of(table, "SR (%)", "flock", "ours, abstract")[0] == "100.0 [72.2, 100.0]"
    assert len(table.rows) == 6 * (4 + 4)
    assert any("MDO is capped at 4 m" in note for note in table.notes)


def test_the_cap_is_stated_as_it_was() -> None:
    table = cases_table(summarise(campaign()), 6.5)
    assert any("MDO is capped at 6.5 m" in note for note in table.notes)


def test_a_method_under_another_name_stands_beside_its_own_row_of_the_paper() -> None:
    records = campaign(("none",), ("tuned",), trials=4)
    definition = CampaignDefinition.model_validate_json(
        '{"title": "T", "worlds": ["none"], "methods": [{"name": "tuned", "method": "pacnav"}]}'
    )
    table = found(comparison_table(summarise(records), Labels.of(definition), 4.0))
    assert [row.cells[1:3] for row in table.rows[:3]] == [
        ("PACNav", "paper"),
        ("tuned", "ours, abstract"),
        ("Proposed", "paper"),
    ]


@pytest.mark.parametrize(
    "unusual",
    [
        '"worlds": [{"name": "w", "site": "forest", "behaviour": "hover"}]',
        '"worlds": [{"name": "w", "site": "forest"}], "swarm": {"leader": {"behaviour": "mixed"}}',
        '"worlds": [{"name": "w", "site": "forest"}], "swarm": {"waypoints_m": [[9, 0], [9, 9]]}',
    ],
)
def test_a_world_with_an_unusual_leader_has_no_published_numbers(unusual: str) -> None:
    text = f'{{"title": "T", "methods": ["flock"], {unusual}}}'
    labels = Labels.of(CampaignDefinition.model_validate_json(text))
    assert comparison_table(summarise(campaign(("w",), ("flock",), trials=4)), labels, 4.0) is None
    plain = Labels.of(CampaignDefinition(title="T", methods=["flock"], worlds=["forest"]))
    table = found(comparison_table(summarise(campaign(("forest",), ("flock",), trials=4)), plain, 4.0))
    assert row_of(table, "SR (%)", "Proposed", "paper") == ["72.0"]


def test_both_fidelities_have_rows_of_their_own() -> None:
    records = campaign(("none",), ("flock",), trials=4) + campaign(
        ("none",), ("flock",), trials=3, fidelity="full"
    )
    table = found(comparison_table(summarise(records), labels_of(records), 4.0))
    assert {row.cells[2] for row in table.rows} == {"paper", "ours, abstract", "ours, full"}


def test_scalability_shows_only_what_flew_in_several_sizes() -> None:
    records = campaign(("pillars_5m",), ("flock",), (2, 4, 8), trials=5) + campaign(("none",), trials=5)
    table = found(scalability_table(summarise(records), labels_of(records), 4.0))
    assert table.values == ("2", "4", "8")
    assert row_of(table, "SR (%)", "Pillars, 5 m gap", "Proposed", "paper") == ["93.0", "97.0", "56.0"]
    assert {row.cells[1] for row in table.rows} == {"Pillars, 5 m gap"}
    assert scalability_table(summarise(campaign()), labels_of(records), 4.0) is None


def test_neighbours_show_the_numbers_of_the_papers_text() -> None:
    methods = tuple(f"flock_k{count}" for count in (4, 5, 6, 10))
    records = campaign(("none", "pillars_5m"), methods, (10,), trials=5)
    table = found(neighbours_table(summarise(records), labels_of(records), 4.0))
    assert table.values == ("4", "5", "6", "10")
    head = "Pillars, 5 m gap, 10 followers"
    assert row_of(table, head, "Proposed", "paper") == ["–", "26", "46", "50"]
    assert len(row_of(table, head, "flock", "ours, abstract")) == 4
    assert neighbours_table(summarise(campaign()), labels_of(records), 4.0) is None


def test_real_scenes_stand_beside_the_real_flights() -> None:
    records = campaign(("display_tower", "indoor_blocks"), ("flock",), trials=5)
    table = found(real_scenes_table(summarise(records), labels_of(records), 4.0))
    assert table.values == ("Indoor blocks", "Display tower")
    assert row_of(table, "MDO (m)", "Proposed", "paper, real flight") == ["1.88 ± 0.92", "5.82 ± 4.69"]
    assert real_scenes_table(summarise(campaign()), labels_of(campaign()), 4.0) is None


def test_failures_are_counted_by_kind() -> None:
    records = [trial(0), trial(1, "obstacle"), trial(2, "obstacle"), trial(3, "leader_lost")]
    table = failures_table(summarise(records))
    assert table.values == ("Followers", "Fidelity", "Trials", "Success", "obstacle", "leader lost")
    assert row_of(table, "Pillars, 5 m gap", "flock") == ["4", "abstract", "4", "1", "2", "1"]


def test_pairs_show_who_won_alone() -> None:
    records = [trial(n) for n in range(8)] + [trial(n, "timeout", method="vpf") for n in range(8)]
    table = paired_table(compare_all(records))
    row = row_of(table, "Pillars, 5 m gap", "flock", "VPF")
    assert row == ["4", "abstract", "8", "8", "0", "+100.0", "0.008"]


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("flock_k6", ("flock", 6)),
        ("flock", ("flock", None)),
        ("a_k3_k10", ("a_k3", 10)),
        ("_k3", ("_k3", None)),
    ],
)
def test_the_number_of_neighbours_is_read_from_a_label(label: str, expected: tuple[str, int | None]) -> None:
    assert split_neighbours(label) == expected


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("flock_k3@late", ("flock_k3", "late")),
        ("flock@x_k3", ("flock", "x_k3")),
        ("flock_k3", ("flock_k3", None)),
    ],
)
def test_the_perception_is_read_from_a_label(label: str, expected: tuple[str, str | None]) -> None:
    assert split_perception(label) == expected


class TestPerceptions:
    definition = CampaignDefinition.model_validate_json(
        '{"title": "T", "worlds": ["pillars_5m"], "methods": ["pacnav", "flock"], '
        '"perceptions": [{"name": "late_k3"}, {"name": "early"}]}'
    )
    labels = Labels.of(definition)
    records = campaign(
        ("pillars_5m",), ("flock@early", "flock@late_k3", "pacnav@early", "pacnav@late_k3"), trials=4
    )

    def test_they_are_the_columns_of_a_table_in_the_order_of_the_file(self) -> None:
        table = found(perceptions_table(summarise(self.records), self.labels, 4.0))
        assert table.values == ("late_k3", "early")
        late, early = row_of(table, "SR (%)", "Pillars, 5 m gap", "flock", "4", "ours, abstract")
        assert late == "100.0 [51.0, 100.0]" or early != late
        assert len(table.rows) == 6 * 2
        assert perceptions_table(summarise(campaign()), self.labels, 4.0) is None

    def test_they_are_a_column_of_every_other_table(self) -> None:
        tables = {table.name: table for table in tables_of(self.records, self.definition)}
        assert [*tables] == ["comparison", "perceptions", "cases", "failures", "paired"]
        for name in ("comparison", "cases", "failures"):
            assert "Perception" in tables[name].names
        heads = {row.cells[1:4] for row in tables["comparison"].rows}
        assert heads >= {("PACNav", "–", "paper"), ("PACNav", "late_k3", "ours, abstract")}
        assert row_of(tables["cases"], "Pillars, 5 m gap", "flock", "early")[:3] == ["4", "abstract", "4"]

    def test_without_any_there_is_no_such_column(self) -> None:
        tables = tables_of(campaign(), CampaignDefinition(title="T", worlds=["none"], methods=["flock"]))
        assert not any("Perception" in table.names for table in tables)

    def test_a_row_for_machines_names_them(self) -> None:
        rows = [case.as_dict() for case in summarise(self.records)]
        assert {row["perception"] for row in rows} == {"early", "late_k3"}
        assert "perception" not in summarise(campaign())[0].as_dict()


def test_a_learned_law_stands_beside_the_papers_own() -> None:
    definition = CampaignDefinition.model_validate_json(
        '{"title": "T", "worlds": ["none"], "followers": [4], '
        '"methods": [{"name": "mine", "method": "policy", "parameters": "mine.yaml"}]}'
    )
    records = campaign(("none",), ("mine",), trials=4)
    table = found(comparison_table(summarise(records), Labels.of(definition), 4.0))
    assert [row.cells[1:3] for row in table.rows[:2]] == [("Proposed", "paper"), ("mine", "ours, abstract")]


class TestRendering:
    table = Table(
        name="t",
        title="50 % of <all> & more",
        names=("A",),
        values=("B_1", "C"),
        rows=(
            Row(("x|y", "1.0 ± 0.1", "<b>"), published=True),
            Row(("x|y", "2", "–")),
            Row(("z", "3", "#")),
        ),
        notes=("A note: 5 %.",),
    )

    def test_markdown_keeps_its_columns(self) -> None:
        lines = markdown(self.table).splitlines()
        assert lines[2:7] == [
            "| A | B_1 | C |",
            "| --- | ---: | ---: |",
            "| x\\|y | 1.0 ± 0.1 | <b> |",
            "| x\\|y | 2 | – |",
            "| z | 3 | # |",
        ]
        assert "A note: 5 %." in lines

    def test_latex_escapes_and_groups(self) -> None:
        text = latex(self.table)
        assert r"\caption{50 \% of <all> \& more}" in text
        assert r"\textbf{B\_1}" in text
        assert r"x|y & \textit{1.0 $\pm$ 0.1} & \textit{<b>} \\" in text
        assert "\n     & 2 & -- \\\\\n    \\midrule\n    z & 3 & \\# \\\\" in text
        assert text.count(r"\begin{") == text.count(r"\end{") == 2

    def test_html_escapes_and_marks_the_papers_rows(self) -> None:
        text = html_table(self.table)
        assert "50 % of &lt;all&gt; &amp; more" in text
        assert '<tr class="first paper"><td class="name">x|y</td>' in text
        assert "&lt;b&gt;" in text
        assert '<tr class=""><td class="name"></td><td>2</td>' in text

    def test_a_row_that_is_too_short_is_refused(self) -> None:
        with pytest.raises(ValueError, match="a row of 1 cells in a table of 2 columns"):
            Table("t", "T", ("A",), ("B",), (Row(("only",)),))
