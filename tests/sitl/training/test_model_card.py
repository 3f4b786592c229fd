from pathlib import Path

import pytest

from companion.control.policy import Policy, read_policy
from companion.errors import LogError
from sitl.campaign.definition import CampaignDefinition
from sitl.swarm.record import End
from sitl.training.model_card import Results, card, evaluation_rows
from tests.control.models import save, with_entry
from tests.sitl.campaign.made_up_trials import campaign, trial

DEFINITION = CampaignDefinition.model_validate(
    {
        "title": "Comparison of methods",
        "table": "comparison",
        "worlds": ["none", "pillars_5m"],
        "methods": ["policy", "flock"],
    }
)
ROW = {
    "world": "pillars_5m_8", "method": "policy", "followers": 8, "trials": 40, "SR": 97.5,
    "SR_ci95": [87.1, 99.6], "MP": 99.0, "FR": 1.7512, "MS": 1.5, "AL": 0.93, "MDO": None,
}  # fmt: skip


def model(tmp_path: Path) -> Policy:
    return read_policy(save(tmp_path / "m.onnx", entries=with_entry("evaluation", [ROW])))


def section(page: str, title: str) -> str:
    """Return the text between a heading and the next."""
    _, _, after = page.partition(f"# {title}\n")
    assert after, f"no section {title}"
    return after.partition("\n#")[0]


def test_a_card_says_which_file_it_is_about_and_how_it_was_judged(tmp_path: Path) -> None:
    known = model(tmp_path)
    page = card(known, [])
    said = section(page, "Model")
    assert f"sha256 {known.sha256}" in said
    assert "| Contract | best-2 |" in said
    assert "max_speed_mps 2" in said
    assert "| pillars_5m_8 | policy | 8 | 40 | 97.5 | 1.75 | 1.5 | 0.93 |" in section(page, "At export")
    assert "No campaign has been flown" in page


def test_a_card_says_where_the_model_fails_worst_first(tmp_path: Path) -> None:
    ends: list[End] = ["success", "leader_lost", "obstacle", "success"]
    records = [trial(k, end, method="policy") for k, end in enumerate(ends)]
    records += [trial(k, "timeout" if k == 0 else "success", method="policy", world="none") for k in range(4)]
    failing = section(card(model(tmp_path), [Results(DEFINITION, records)]), "Where it fails")
    rows = [line for line in failing.splitlines() if line.startswith("| ")][1:]
    assert "| leader_lost |" in failing.splitlines()[1] or "leader_lost" in failing
    assert rows[1].startswith("| Pillars, 5 m gap | Learned policy | 4 | 4 | 50.0 |")
    assert rows[2].startswith("| No obstacles | Learned policy | 4 | 4 | 75.0 |")


def test_a_card_compares_with_flock_on_the_same_scenes(tmp_path: Path) -> None:
    records = [trial(k, method="policy", FR=1.5 + 0.01 * (k % 3), AL=0.95) for k in range(12)]
    records += [trial(k, FR=1.8, AL=0.9) for k in range(12)]
    versus = section(card(model(tmp_path), [Results(DEFINITION, records)]), "Against flock")
    assert (
        "| Pillars, 5 m gap | Learned policy / flock | 4 | 12 | 100.0 | 100.0 | 1.000 | -0.290 | < 0.001 |"
        in versus
    )


def test_a_card_holds_every_table_of_every_campaign(tmp_path: Path) -> None:
    records = campaign(("none", "pillars_5m"), ("policy", "flock"), trials=6)
    page = card(model(tmp_path), [Results(DEFINITION, records)])
    assert "# Comparison of methods\n" in page
    assert "paper" in page
    assert page.count("\n## ") >= 6


def test_a_card_tells_configuration_and_curve_of_the_training(tmp_path: Path) -> None:
    training = tmp_path / "training"
    training.mkdir()
    (training / "configuration.yaml").write_text("title: T\nseed: 3\n", encoding="utf-8")
    lines = [f"{k},{100 * k},{k}.5,0.{k},{80 + k if k % 2 else ''}" for k in range(1, 41)]
    (training / "curve.csv").write_text(
        "\n".join(["update,samples,wall_s,reward,evaluation_score", *lines]) + "\n", encoding="utf-8"
    )
    page = card(model(tmp_path), [], training)
    assert "seed: 3" in section(page, "Trained on")
    rows = [line for line in section(page, "How it learned").splitlines() if line.startswith("| ")][2:]
    assert len(rows) == 12
    assert rows[0] == "| 1 | 100 | 1.5 | 0.1 | 81 |"
    assert rows[-1].startswith("| 39 | 3900 |")
    with pytest.raises(LogError, match=r"configuration\.yaml: cannot be read"):
        card(model(tmp_path), [], tmp_path)


def test_results_that_are_not_there_are_missed(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="nothing of the campaign 'Comparison of methods' has been flown"):
        Results.stored(DEFINITION, tmp_path)


def test_a_model_carries_the_numbers_of_its_table_alone() -> None:
    assert evaluation_rows([{**ROW, "failures": {"timeout": 1}, "FR_sd": 0.2}]) == [ROW]
