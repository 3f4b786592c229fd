import hashlib
from pathlib import Path

import pytest

from companion.control.followers.settings import SHIPPED_MODEL
from companion.errors import ProfileError
from sitl.abstract.policy_flight import POLICY
from sitl.abstract.settings import AbstractSettings
from sitl.campaign.conditions import conditions_of
from sitl.campaign.definition import LEARNED, load_definition
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
    with pytest.raises(ProfileError, match=r"campaign.yaml:4:1: wind: .* do not feel any in abstract"):
        gusts("wind: {gust_mps: 2.0}\n")
    windy = load_definition(written(tmp_path, SMALL + "fidelity: full\nwind: {gust_mps: 2.0}\n"))
    with pytest.raises(ProfileError, match=r"campaign.yaml: wind: .* do not feel any in abstract"):
        conditions_of(windy.model_copy(update={"fidelity": "abstract"}), tmp_path / "campaign.yaml")


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
            "title: A\nworlds:\n  - none\n  - moon\nmethods: [flock]\n",
            r"campaign.yaml:4:5: worlds\[1\]: found site 'moon', allowed one of none, pillars_10m",
        ),
        (
            "title: A\nworlds: [{name: a, site: moon}]\nmethods: [flock]\n",
            r"campaign.yaml:2:10: worlds\[0\]: found site 'moon', allowed one of none",
        ),
        (
            "title: A\nworlds: [none]\nmethods: [boids]\n",
            r"campaign.yaml:3:11: methods\[0\]: found method 'boids', allowed one of flock, pacnav",
        ),
        (
            "title: A\nworlds: [none]\nmethods:\n  - {name: a, method: flock, parameters: lost.yaml}\n",
            r"campaign.yaml:4:42: methods\[0\].parameters: found 'lost.yaml', allowed is a file that exists",
        ),
        (
            "title: A\nworlds: [{name: mine, file: lost.yaml}]\nmethods: [flock]\n",
            r"campaign.yaml:2:29: worlds\[0\].file: found 'lost.yaml', allowed is a file that exists",
        ),
        (
            "title: A\nworlds: [{name: mine, file: a.yaml, mesh: a.ply}]\nmethods: [flock]\n",
            r"campaign.yaml:2:43: worlds\[0\].mesh: found file and mesh, allowed one of site, file, mesh",
        ),
        (
            "title: A\nworlds: [{name: a, site: 5}]\nmethods: [flock]\n",
            r"campaign.yaml:2:26: worlds\[0\].site: found 5, allowed is text of 1 to 48 characters",
        ),
        (
            "title: A\nworlds: [none]\nmethods: [5]\n",
            r"campaign.yaml:3:11: methods\[0\]: found 5, allowed is text",
        ),
        (
            "title: A\nworlds: [{name: indoor_wall, spawn_world_m: [1, 1]}]\nmethods: [flock]\n",
            r"worlds\[0\].spawn_world_m: found a way in indoor_wall, allowed none",
        ),
    ],
)
def test_a_name_that_nothing_has_is_refused_with_its_place(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(ProfileError, match=told):
        load_definition(written(tmp_path, text))


def test_a_learned_law_is_the_shipped_one_unless_told_where_it_is(tmp_path: Path) -> None:
    assert LEARNED == POLICY
    named = "title: A\nworlds: [none]\nmethods: [{name: mine, method: policy%s}]\n"
    shipped = written(tmp_path, named % "")
    assert conditions_of(load_definition(shipped), shipped).variants["mine"].follower.model == SHIPPED_MODEL
    profile = "vehicle: {name: uav9}\nrole: follower\nfollower: {controller: %s, model: mine.onnx}\n"
    path = written(tmp_path, named % ", parameters: learned.yaml")
    (tmp_path / "learned.yaml").write_text(profile % "law", encoding="utf-8")
    definition = load_definition(path)
    assert selection_of(definition).methods == ("mine",)
    with pytest.raises(
        ProfileError, match=r"learned.yaml: follower.controller: found 'law', allowed 'policy'"
    ):
        conditions_of(definition, path)
    (tmp_path / "learned.yaml").write_text(profile % "policy", encoding="utf-8")
    (tmp_path / "mine.onnx").write_bytes(b"learned")
    variant = conditions_of(definition, path).variants["mine"]
    assert variant.method == POLICY
    assert variant.follower.model == str((tmp_path / "mine.onnx").resolve())
    assert variant.follower.model_sha256 == hashlib.sha256(b"learned").hexdigest()


def test_a_law_stays_a_law_whatever_else_its_profile_flies(tmp_path: Path) -> None:
    (tmp_path / "learned.yaml").write_text(
        "vehicle: {name: uav9}\nrole: follower\nfollower: {controller: policy}\n", encoding="utf-8"
    )
    text = "title: A\nworlds: [none]\nmethods: [{name: flock, parameters: learned.yaml}]\n"
    path = written(tmp_path, text)
    assert conditions_of(load_definition(path), path).variants["flock"].follower.controller == "law"


class TestPerceptions:
    def test_one_needs_no_name(self, tmp_path: Path) -> None:
        path = written(tmp_path, SMALL + "perception: measured\n")
        conditions = conditions_of(load_definition(path), path)
        assert conditions.rules.abstract == AbstractSettings.of("measured")
        assert set(conditions.variants) == {"flock"}

    def test_each_is_a_row_of_its_own_that_starts_from_a_preset(self, tmp_path: Path) -> None:
        text = (
            "perceptions:\n"
            "  - {name: published}\n"
            "  - {name: late, settings: {neighbour_delay_s: 0.4}, compensate_latency: false}\n"
            "  - {name: noisy, preset: measured, sigma_factor: 2}\n"
        )
        path = written(tmp_path, SMALL + "observable_neighbours: [3, 6]\n" + text)
        definition = load_definition(path)
        variants = conditions_of(definition, path).variants
        assert selection_of(definition).methods == tuple(variants) == (
            "flock_k3@published", "flock_k3@late", "flock_k3@noisy",
            "flock_k6@published", "flock_k6@late", "flock_k6@noisy",
        )  # fmt: skip
        published, late, noisy = (
            variants[f"flock_k3@{name}"].abstract for name in ("published", "late", "noisy")
        )
        assert published == AbstractSettings.of("paper")
        assert late is not None
        assert late.perception == AbstractSettings.of("paper").perception.model_copy(
            update={"neighbour_delay_s": 0.4}
        )
        assert not late.neighbours.compensate_latency
        measured = AbstractSettings.of("measured")
        assert noisy is not None
        assert noisy.dynamics == measured.dynamics
        assert noisy.perception.position_sigma_per_m == 2.0 * measured.perception.position_sigma_per_m
        assert noisy.perception.velocity_sigma_mps == 2.0 * measured.perception.velocity_sigma_mps
        assert noisy.perception.neighbour_delay_s == measured.perception.neighbour_delay_s

    def test_a_part_of_them_can_be_flown(self, tmp_path: Path) -> None:
        text = "perceptions: [{name: a}, {name: b, sigma_factor: 2}]\n"
        definition = load_definition(written(tmp_path, SMALL + text))
        assert selection_of(definition, perceptions=["b"]).methods == ("flock@b",)

    @pytest.mark.parametrize(
        ("text", "told"),
        [
            ("perceptions: [{name: a}, {name: a}]", r":4:26: perceptions\[1\]: found 'a' twice"),
            (
                "perceptions: [{name: a, settings: {delay_s: 1}}]",
                r"perceptions\[0\].settings.delay_s: unknown key, ",
            ),
            (
                "perceptions: [{name: a, preset: measured, settings: {dropout: 0.9}}]",
                r":4:43: perceptions\[0\].settings: found a contradiction with preset measured, "
                "allowed dropout and dropout_far together",
            ),
            (
                "perceptions: [{name: a, preset: measured, sigma_factor: 20,"
                " settings: {velocity_sigma_mps: 0.5}}]",
                r":4:\d+: perceptions\[0\].settings.velocity_sigma_mps: found 10.0, allowed",
            ),
            ("perceptions: [{name: a}]\nperception: paper", "perception: found both perception and percept"),
            ("perceptions: [{name: a}]\nfidelity: full", "perceptions: found perceptions in full fidelity"),
            (
                "perceptions: [{name: a}]\nwind: {gust_mps: 1}",
                "wind: found weather, allowed it with measured",
            ),
        ],
    )
    def test_what_cannot_be_is_refused_with_its_place(self, tmp_path: Path, text: str, told: str) -> None:
        with pytest.raises(ProfileError, match=told):
            load_definition(written(tmp_path, f"{SMALL}{text}\n"))
