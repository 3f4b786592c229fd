import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from companion.config import load_profile
from companion.control.followers.settings import METHODS, FollowerSettings, gains_of
from companion.errors import LogError, ProfileError
from sitl.campaign.tasks import SceneTask
from sitl.swarm.record import TrialRecord
from sitl.tune.exam import (
    COMMON,
    NoTargetError,
    Target,
    flock_exam,
    free_space_exam,
    obstacle_exam,
    target_of,
)
from sitl.tune.search import Examiner, Found, search
from sitl.tune.space import OBSTACLE_GAIN, axes_of, obstacle_values, start_of, with_values
from sitl.tune.stored import BASE, store, stored_text
from sitl.tune.tuning import tune
from tests.sitl.campaign.varied_trials import RECORD

FIELD_CONFIGS = Path(__file__).parents[3] / "field_configs"
SCENES = 4


def valley(task: SceneTask) -> list[TrialRecord]:
    """Pretend: separation follows `edge`, radius follows `gain_mps`, obstacles want `obstacle_mps` of 2."""
    assert task.rules.seeds == "training"
    records = []
    for trial in task.trials:
        for label, variant in task.variants:
            gains = variant.follower.vpf
            struck = task.world.site_name != "none" and abs(gains.obstacle_mps - 2.0) > 0.3
            records.append(
                replace(
                    RECORD,
                    world=task.world.name,
                    method=label,
                    followers=task.followers,
                    trial=trial,
                    end="obstacle" if struck else "success",
                    mission_progress_percent=50.0 if struck else 100.0,
                    flock_radius_m=3.0 - 0.2 * gains.gain_mps + 0.01 * math.sin(trial),
                    minimum_separation_m=0.15 / max(gains.edge, 0.01),
                )
            )
    return records


def execute(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
    return map(valley, tasks)


def backwards(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
    return map(valley, reversed(tasks))


def searched(
    journal: Path,
    flies: Callable[[Sequence[SceneTask]], Iterator[list[TrialRecord]]] = execute,
    *,
    budget: int,
    seed: int = 1,
) -> Found:
    exam = free_space_exam(COMMON, SCENES)
    examiner = Examiner("vpf", seed, flies)
    return search(
        examiner,
        exam,
        "vpf",
        budget=budget,
        seed=seed,
        journal=journal,
        on_progress=lambda done, best: None,
    )


def test_a_search_finds_the_target(tmp_path: Path) -> None:
    found = searched(tmp_path / "a.jsonl", budget=240)
    assert found.score < 0.05 < found.start_score
    assert found.follower.vpf.gain_mps == pytest.approx(6.0, abs=0.2)
    assert found.follower.vpf.edge == pytest.approx(0.1, abs=0.005)
    assert 240 <= found.evaluations < 260


def test_a_seed_finds_the_same_in_any_order_and_another_seed_something_else(tmp_path: Path) -> None:
    first = searched(tmp_path / "a.jsonl", budget=20)
    assert searched(tmp_path / "b.jsonl", backwards, budget=20) == first
    assert (tmp_path / "a.jsonl").read_bytes() == (tmp_path / "b.jsonl").read_bytes()
    assert searched(tmp_path / "c.jsonl", budget=20, seed=2).follower != first.follower


def test_a_stopped_search_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    whole = searched(tmp_path / "whole.jsonl", budget=40)
    flown = 0

    def stops(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
        nonlocal flown
        flown += 1
        if flown == 4:
            raise KeyboardInterrupt
        return execute(tasks)

    path = tmp_path / "stopped.jsonl"
    with pytest.raises(KeyboardInterrupt):
        searched(path, stops, budget=40)
    path.write_bytes(path.read_bytes() + b'{"scores": [1.0,')
    flown = 4
    assert searched(path, stops, budget=40) == whole
    assert path.read_bytes() == (tmp_path / "whole.jsonl").read_bytes()
    generations = len(path.read_bytes().splitlines()) - 1
    assert flown == 4 + (generations - 3) + 1, "only what was missing, and the confirmation"


def test_a_journal_of_another_search_is_refused(tmp_path: Path) -> None:
    searched(tmp_path / "a.jsonl", budget=8)
    with pytest.raises(LogError, match="holds another search"):
        searched(tmp_path / "a.jsonl", budget=8, seed=2)
    (tmp_path / "a.jsonl").write_bytes(b"nonsense\n")
    with pytest.raises(LogError, match="not the journal of a search"):
        searched(tmp_path / "a.jsonl", budget=8)


def test_the_gain_against_obstacles_is_chosen_between_pillars(tmp_path: Path) -> None:
    tuned = tune(
        "vpf",
        "paper",
        budget=40,
        scenes=SCENES,
        seed=1,
        journal=tmp_path / "a.jsonl",
        execute=execute,
        on_progress=lambda done, best: None,
    )
    assert tuned.found.follower.vpf.obstacle_mps == pytest.approx(2.0, abs=0.3)
    assert {trial.end for trial in tuned.found.flown[1]} == {"success"}
    assert {trial.world for trial in tuned.free} == {"none"}


@pytest.mark.parametrize("method", METHODS)
def test_every_law_is_searched_within_its_bounds(method: str) -> None:
    axes = axes_of(method)
    bounds = {gain.name: gain for gain in gains_of(method)}
    for axis in axes:
        gain = bounds[axis.name]
        assert gain.low <= axis.low <= axis.start <= axis.high <= gain.high
        assert axis.start == pytest.approx(gain.default)
        assert axis.spread > 0.0
    for corner in (-1e9, 1e9):
        follower = with_values(FollowerSettings(), method, axes, [corner] * len(axes))
        assert follower.method == method
    assert "body_radius_m" not in {axis.name for axis in axes}


@pytest.mark.parametrize("method", OBSTACLE_GAIN)
def test_gains_against_obstacles_are_tried_on_both_sides(method: str) -> None:
    values = obstacle_values(method, FollowerSettings(), 9)
    now = getattr(getattr(FollowerSettings(), method), OBSTACLE_GAIN[method])
    assert values == sorted(values)
    assert values[0] < now < values[-1]


def test_targets_are_the_papers_rows_or_common() -> None:
    assert target_of("pacnav", "paper") == Target(1.80, 1.23)
    assert target_of("vpf_polar", "paper") == Target(2.20, 1.49)
    assert target_of("reynolds_apf", "paper") == Target(2.96, 1.54)
    assert target_of("flock", "paper") == Target(1.61, 1.55)
    assert target_of("lloyd", "common") == COMMON == Target(1.8, 1.5)
    with pytest.raises(NoTargetError, match="no row for lloyd: use --target common"):
        target_of("lloyd", "paper")


def test_the_score_is_that_of_its_formula() -> None:
    exam = free_space_exam(Target(1.8, 1.5), 4)
    good = replace(RECORD, flock_radius_m=1.8, minimum_separation_m=1.5)
    assert exam.score([[good] * 4]) == 0.0
    off = replace(good, flock_radius_m=1.95, minimum_separation_m=1.6)
    assert exam.score([[off] * 4]) == pytest.approx(1.0 + 4.0)
    hit = replace(good, end="uav_uav")
    assert exam.score([[good, good, good, hit]]) == pytest.approx(25.0 + 5.0)
    lost = replace(good, end="leader_lost")
    assert exam.score([[good, good, good, lost]]) == pytest.approx(5.0)
    nothing = replace(good, flock_radius_m=math.nan)
    assert math.isfinite(exam.score([[nothing] * 4]))


@pytest.mark.parametrize("build", [free_space_exam, obstacle_exam, flock_exam])
def test_an_exam_starts_in_free_space_and_names_its_cases_apart(build: Callable[..., object]) -> None:
    exam = build(COMMON, 6)
    parts = exam.parts  # type: ignore[attr-defined]
    assert (parts[0].world.name, parts[0].followers) == ("none", 4)
    assert len({(part.world.name, part.followers) for part in parts}) == len(parts)


def test_an_exam_has_the_cases_that_are_asked_for_with_their_weights() -> None:
    exam = flock_exam(COMMON, 6, ["pillars_5m:10=2", "forest:4", "forest:4:hover=0.25"])
    named = [(p.world.name, p.world.site_name, p.world.behaviour, p.followers, p.weight) for p in exam.parts]
    assert named == [
        ("none", "none", None, 4, 1.0),
        ("pillars_5m", "pillars_5m", None, 10, 2.0),
        ("forest", "forest", None, 4, 1.0),
        ("forest_hover", "forest", "hover", 4, 0.25),
    ]
    assert [part.scenes for part in exam.parts] == [3, 6, 6, 3]
    good = replace(RECORD, flock_radius_m=1.8, minimum_separation_m=1.5, end="success")
    lost = replace(good, end="leader_lost", mission_progress_percent=100.0)
    flown = [[good], [lost], [good], [good]]
    assert exam.score(flown) == pytest.approx(2.0 * exam.score([[good], [good], [lost], [good]]))


@pytest.mark.parametrize(
    ("case", "complaint"),
    [
        ("pillars_5m", "must be SITE:FOLLOWERS"),
        ("swamp:4", "no site 'swamp'"),
        ("forest:21", "1 to 20 are allowed"),
        ("forest:4:loop", "no leader behaves 'loop'"),
        ("forest:4=0", "must be above 0"),
        ("none:4", "is there already"),
    ],
)
def test_a_case_that_cannot_be_flown_is_refused_in_one_sentence(case: str, complaint: str) -> None:
    with pytest.raises(ProfileError, match=complaint) as caught:
        flock_exam(COMMON, 6, [case])
    assert "\n" not in str(caught.value)


def test_the_laws_of_others_fly_no_cases_of_ones_own(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="cases are for flock"):
        tune(
            "vpf",
            "paper",
            budget=40,
            scenes=SCENES,
            seed=1,
            journal=tmp_path / "a.jsonl",
            execute=execute,
            on_progress=lambda done, best: None,
            cases=["forest:4"],
        )
    assert list(tmp_path.iterdir()) == []


def test_stored_gains_are_a_profile(tmp_path: Path) -> None:
    for path in FIELD_CONFIGS.glob("uav_*.yaml"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    follower = with_values(FollowerSettings(), "vpf", axes_of("vpf"), [1.23456, 0.2, 0.5])
    out = tmp_path / "follower_vpf_T9.yaml"
    store(out, stored_text(follower, "vpf", ["Found by chance."]))
    assert "# Found by chance.\n" in out.read_text(encoding="utf-8")
    profile = load_profile(out)
    assert profile.follower is not None
    assert profile.follower.method == "vpf"
    assert profile.follower.vpf == follower.vpf
    assert profile.follower.vpf.gain_mps == 1.235


def test_the_laws_of_others_are_tuned_and_stored_without_a_limit_on_the_change_of_commands() -> None:
    assert start_of("flock") == FollowerSettings()
    follower = start_of("vpf")
    assert follower.command.max_acceleration_mps2 == 10.0
    assert "max_acceleration_mps2: 10.0" in stored_text(follower, "vpf", [])
    assert "command" not in stored_text(start_of("flock"), "flock", [])


def test_gains_are_not_stored_where_nothing_could_load_them(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=BASE):
        store(tmp_path / "follower.yaml", stored_text(FollowerSettings(), "vpf", []))
    assert list(tmp_path.iterdir()) == []


def test_the_journal_is_plain(tmp_path: Path) -> None:
    searched(tmp_path / "a.jsonl", budget=8)
    head, *generations = (tmp_path / "a.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(head)["method"] == "vpf"
    assert all(len(json.loads(line)["scores"]) >= 4 for line in generations)
