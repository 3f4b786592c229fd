import functools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from companion.errors import StartError
from sitl.campaign.conditions import conditions_of
from sitl.campaign.definition import CampaignDefinition
from sitl.campaign.ray_runner import on_cluster
from sitl.campaign.runner import run_campaign
from sitl.campaign.scenes import prepare
from sitl.campaign.store import TABLE_NAME
from sitl.campaign.tasks import SceneTask, selection_of
from sitl.campaign.trials import fly_scenes
from sitl.swarm.record import TrialRecord
from tests.sitl.campaign.chores import die_once
from tests.sitl.campaign.deadly_flights import fly_or_die

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
cluster_utils = pytest.importorskip("ray.cluster_utils")

pytestmark = [
    pytest.mark.sockets,
    # Ray leaves pipes of the processes that it starts to the garbage collector.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A head that only keeps books, and two computers with one processor each, all on loopback."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parents[3]), before or ""])
    memory = 80 * 2**20
    cluster = cluster_utils.Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 0, "include_dashboard": False, "object_store_memory": memory},
    )
    cluster.spare = cluster.add_node(num_cpus=1, object_store_memory=memory)
    cluster.add_node(num_cpus=1, object_store_memory=memory)
    yield cluster
    cluster.shutdown()
    if before is None:
        del os.environ["PYTHONPATH"]
    else:
        os.environ["PYTHONPATH"] = before


def test_a_campaign_on_a_cluster_that_loses_a_worker_gives_the_same_bytes(
    cluster: Any, tmp_path: Path
) -> None:
    definition = CampaignDefinition(
        title="Cluster", worlds=["none", "pillars_10m"], methods=["flock"], followers=[2], trials=8
    )
    conditions = conditions_of(definition, Path("campaign.yaml"))
    prepare()

    def on_two_computers(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
        work = functools.partial(fly_or_die, mark=str(tmp_path / "mark"))
        return on_cluster(work, tasks, cluster.address)

    def here(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
        return map(fly_scenes, tasks)

    for name, execute in (("cluster", on_two_computers), ("here", here)):
        run_campaign(conditions, selection_of(definition), tmp_path / name, execute, lambda progress: None)
    assert (tmp_path / "mark").exists(), "a worker died in the middle"
    assert (tmp_path / "cluster" / TABLE_NAME).read_bytes() == (tmp_path / "here" / TABLE_NAME).read_bytes()


def test_tasks_of_a_computer_that_dies_are_done_by_another(cluster: Any, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    mark.touch()
    results = []
    for number, _ in on_cluster(die_once, [(number, str(mark)) for number in range(40)], cluster.address):
        results.append(number)
        if len(results) == 10:
            cluster.remove_node(cluster.spare, allow_graceful=False)
    assert sorted(results) == list(range(40))


def test_a_cluster_that_is_not_there_is_refused_in_one_sentence() -> None:
    with pytest.raises(StartError, match="no Ray cluster at nonsense"):
        list(on_cluster(die_once, [], "nonsense"))
