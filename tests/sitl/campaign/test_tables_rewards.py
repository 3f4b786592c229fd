from sitl.campaign.cases import summarise
from sitl.campaign.definition import CampaignDefinition
from sitl.campaign.report import tables_of
from sitl.campaign.tables_labels import Labels
from sitl.campaign.tables_rewards import rewards_table
from tests.sitl.campaign.made_up_trials import campaign

NAMES = ("without_flocking", "uniform", "proposed")
DEFINITION = CampaignDefinition.model_validate(
    {
        "title": "Rewards",
        "table": "rewards",
        "worlds": ["none", "pillars_5m"],
        "methods": [{"name": name, "method": "policy"} for name in NAMES],
    }
)


def test_policies_stand_beside_the_paper_s_of_the_same_reward() -> None:
    cases = summarise(campaign(("none", "pillars_5m"), NAMES, trials=5))
    table = rewards_table(cases, Labels.of(DEFINITION), 4.0)
    assert table is not None
    assert table.values == ("Without flocking", "Uniform", "All")
    rates = [row for row in table.rows if row.cells[0] == "SR (%)"]
    assert [row.cells[1:3] for row in rates] == [
        ("No obstacles", "paper"),
        ("No obstacles", "ours, abstract"),
        ("Pillars, 5 m gap", "paper"),
        ("Pillars, 5 m gap", "ours, abstract"),
    ]
    assert rates[0].cells[3] == "0.0"
    assert rates[0].published
    assert rates[1].cells[5].startswith("100.0 [")


def test_without_such_policies_there_is_no_such_table() -> None:
    cases = summarise(campaign(("none",), ("flock", "proposed"), trials=3))
    assert rewards_table(cases, Labels.of(DEFINITION), 4.0) is None


def test_a_report_on_rewards_begins_with_it() -> None:
    assert tables_of(campaign(("none",), NAMES, trials=3), DEFINITION)[0].name == "rewards"
