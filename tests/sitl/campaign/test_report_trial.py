import json
import math
import re
from pathlib import Path

import numpy as np

from companion.messages import FloatArray
from sitl.campaign.report_trial import write_trial_page
from sitl.swarm.scene import SwarmScene
from sitl.worlds.primitives import Cylinder, World
from tests.sitl.campaign.made_up_trials import trial


def scene() -> SwarmScene:
    pillar = Cylinder(start_world_m=(5, 2, 0), end_world_m=(5, 2, 4), radius_m=0.3)
    return SwarmScene(
        seed=1,
        world=World.of([pillar]),
        starts_world=np.zeros((3, 3)),
        yaws=np.zeros(3),
        waypoints_world=np.array([[10.0, 0.0, 1.5]]),
        holds_s=np.zeros(1),
        speed_mps=1.0,
        timeout_s=60.0,
        scene_hash="abc",
    )


def flight() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    t = np.arange(0.0, 10.0, 0.05)
    p = np.zeros((len(t), 3, 3))
    p[:, :, 0] = t[:, None] + [0.0, -1.5, -3.0]
    p[:, :, 2] = 1.5
    distances = np.linalg.norm(p[:, :, :2] - [5.0, 2.0], axis=2) - 0.3
    return t, p, np.broadcast_to([1.0, 0.0, 0.0], p.shape), distances


def test_a_trials_page_shows_its_way_and_its_metrics_over_time(tmp_path: Path) -> None:
    path = tmp_path / "trial.html"
    write_trial_page(path, trial(7, "obstacle", MDO=math.nan), scene(), *flight())
    text = path.read_text("utf-8")
    [figures] = re.findall(r"Object\.entries\((\{.*\})\)\) \{$", text, flags=re.MULTILINE)
    plots = json.loads(figures)
    assert list(plots) == ["plan", "fr", "ms", "al", "mdo"]
    assert {"leader", "follower 2", "obstacles"} <= {trace["name"] for trace in plots["plan"]["data"]}
    assert np.allclose(plots["ms"]["data"][0]["y"], 1.5)
    assert plots["ms"]["layout"]["shapes"][0]["y0"] == 0.4
    assert "<td>leader, 2</td>" in text.replace(' class="name"', "")
    assert "nearer than 4 m" in text
    assert "default-src 'none'" in text


def test_without_an_obstacle_near_there_is_no_plot_of_them(tmp_path: Path) -> None:
    t, p, v, distances = flight()
    path = tmp_path / "trial.html"
    write_trial_page(path, trial(0), scene(), t, p, v, np.full_like(distances, np.inf))
    assert 'id="plot-mdo"' not in path.read_text("utf-8")
