from pathlib import Path

import pytest

from companion.errors import ProfileError
from sitl.campaign.conditions import conditions_of
from sitl.campaign.definition import load_definition
from sitl.campaign.tasks import selection_of

FIELD_CONFIGS = Path(__file__).parents[3] / "field_configs"
SMALL = "title: Small\nworlds: [none]\nmethods: [flock]\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "campaign.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("path", sorted(FIELD_CONFIGS.glob("campaign_*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_campaign_means_something(path: Path) -> None:
    definition = load_definition(path)
    conditions = conditions_of(definition, path)
    selection = selection_of(definition)
    assert len(selection) == len(list(selection)) > 0
    assert set(selection.worlds) == set(conditions.worlds)
    assert set(selection.methods) == set(conditions.variants)
    assert conditions.rules.seeds == "held_out"


def test_names_stand_for_themselves_until_an_entry_says_otherwise(tmp_path: Path) -> None:
    text = (
        "title: Named\nworlds: [none, {name: hovering, site: pillars_5m, behaviour: hover}]\n"
        "methods: [flock, {name: other_flock, method: flock}]\n"
    )
    path = written(tmp_path, text)
    conditions = conditions_of(load_definition(path), path)
    assert {name: world.site_name for name, world in conditions.worlds.items()} == {
        "none": "none",
        "hovering": "pillars_5m",
    }
    assert {label: variant.method for label, variant in conditions.variants.items()} == {
        "flock": "flock",
        "other_flock": "flock",
    }


def test_gains_come_from_the_profile_that_an_entry_names(tmp_path: Path) -> None:
    (tmp_path / "gains.yaml").write_text(
        "vehicle: {name: uav9}\nrole: follower\nfollower: {flock: {cohesion_per_s: 0.77}}\n", encoding="utf-8"
    )
    text = "title: Tuned\nworlds: [none]\nmethods: [{name: tuned, method: flock, parameters: gains.yaml}]\n"
    path = written(tmp_path, text)
    conditions = conditions_of(load_definition(path), path)
    assert conditions.variants["tuned"].follower.flock.cohesion_per_s == 0.77


def test_full_fidelity_flies_in_gusts_and_all_weather_that_is_told_is_felt(tmp_path: Path) -> None:
    for file in (*FIELD_CONFIGS.glob("uav_*.yaml"), *FIELD_CONFIGS.glob("sitl_swarm_*er.yaml")):
        (tmp_path / file.name).write_bytes(file.read_bytes())

    def gusts(text: str) -> float:
        path = written(tmp_path, SMALL + text)
        return conditions_of(load_definition(path), path).rules.abstract.wind.gust_mps

    assert gusts("") == 0.0
    assert gusts("fidelity: full\n") == 0.3
    assert gusts("fidelity: full\nwind: {gust_mps: 2.0}\n") == 2.0
    assert gusts("perception: measured\nwind: {gust_mps: 2.0}\n") == 2.0
    with pytest.raises(ProfileError, match="do not feel any in abstract fidelity"):
        gusts("wind: {gust_mps: 2.0}\n")


def test_numbers_of_neighbours_are_rows_of_their_own_only_where_they_vary(tmp_path: Path) -> None:
    few = load_definition(written(tmp_path, SMALL + "observable_neighbours: [3, 10]\n"))
    assert selection_of(few).methods == ("flock_k3", "flock_k10")
    assert conditions_of(few, tmp_path / "campaign.yaml").variants["flock_k10"].observable_neighbours == 10
    one = load_definition(written(tmp_path, SMALL + "observable_neighbours: [3]\n"))
    assert selection_of(one).methods == ("flock",)
    assert conditions_of(one, tmp_path / "campaign.yaml").variants["flock"].observable_neighbours == 3


def test_a_part_of_a_campaign_keeps_the_order_of_the_file(tmp_path: Path) -> None:
    text = "title: Part\nworlds: [forest, none, pillars_5m]\nmethods: [flock]\nfollowers: [10, 2]\n"
    definition = load_definition(written(tmp_path, text))
    part = selection_of(definition, worlds=["pillars_5m", "forest"], followers=["2"])
    assert part.worlds == ("forest", "pillars_5m")
    assert part.followers == (2,)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("trails: 5", r"campaign.yaml:4:1: trails: unknown key, did you mean trials\?"),
        ("trials: 0", "trials: found 0, allowed is an integer from 1 to 1e"),
        ("fidelity: half", "fidelity: found text 'half', allowed is one of 'abstract', 'full'"),
        ("followers: [4, 4]", r"followers\[1\]: found '4' twice, allowed each once"),
        ("followers: [21]", r"followers\[0\]: found 21"),
        ("perception: perfect", "perception: found text 'perfect'"),
        ("obstacle_distance_cap_m: 0", "obstacle_distance_cap_m: found 0"),
    ],
)
def test_a_wrong_line_is_refused_with_its_place(tmp_path: Path, line: str, told: str) -> None:
    with pytest.raises(ProfileError, match=told):
        load_definition(written(tmp_path, f"{SMALL}{line}\n"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "title: A\nworlds: [moon]\nmethods: [flock]\n",
            r"campaign.yaml: worlds\[0\]: there is no site 'moon'; there are none",
        ),
        (
            "title: A\nworlds: [none]\nmethods: [boids]\n",
            r"methods\[0\]: there is no method 'boids'; there are",
        ),
        (
            "title: A\nworlds: [none]\nmethods: [{name: a, method: flock, parameters: lost.yaml}]\n",
            "lost.yaml:1:1: no such file",
        ),
    ],
)
def test_a_name_that_nothing_has_is_refused(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(ProfileError, match=told):
        conditions_of(load_definition(written(tmp_path, text)), tmp_path / "campaign.yaml")
