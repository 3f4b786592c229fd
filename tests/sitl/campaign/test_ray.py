import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.errors import StartError
from sitl.campaign.ray_runner import on_cluster
from tests.sitl.campaign.chores import die_once

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
    for _ in range(2):
        cluster.add_node(num_cpus=1, object_store_memory=memory)
    yield cluster
    cluster.shutdown()
    if before is None:
        del os.environ["PYTHONPATH"]
    else:
        os.environ["PYTHONPATH"] = before


def test_tasks_of_a_worker_that_dies_are_done_by_another(cluster: Any, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    chores = [(number, str(mark)) for number in range(20)]
    results = list(on_cluster(die_once, chores, cluster.address))
    assert mark.exists()
    assert sorted(number for number, _ in results) == list(range(20))
    assert os.getpid() not in {worker for _, worker in results}


def test_a_cluster_that_is_not_there_is_refused_in_one_sentence() -> None:
    with pytest.raises(StartError, match="no Ray cluster at nonsense"):
        list(on_cluster(die_once, [], "nonsense"))
