from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.control.followers.settings import FollowerSettings
from companion.logs import channels
from companion.logs.codec import codec_of
from sitl.abstract.flight import fly_abstract
from sitl.abstract.flight_log import write_log
from sitl.abstract.settings import AbstractSettings
from sitl.swarm.scene import set_scene
from sitl.swarm.settings import SwarmSettings


def test_the_log_of_a_flight_holds_every_pose_the_obstacles_and_the_outcome(tmp_path: Path) -> None:
    scene = set_scene(SwarmSettings(goal_distance_m=6.0, followers=2), "pillars_5m", 3)
    flight = fly_abstract(scene, "flock", FollowerSettings(), AbstractSettings(), record=True)
    path = tmp_path / "flight.mcap"
    path.write_text("an older one")
    write_log(scene, flight, path)
    assert flight.trajectory is not None
    poses: dict[str, list[object]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            poses.setdefault(channel.topic, []).append(message.data)
    steps = len(flight.trajectory.t)
    for vehicle in range(3):
        assert len(poses[f"/uav_{vehicle}/pose"]) == steps
        assert len(poses[f"/uav_{vehicle}/setpoint"]) == steps
    last = codec_of(channels.POSE).decode(poses["/uav_2/pose"][-1])  # type: ignore[arg-type]
    np.testing.assert_allclose(last.p, flight.trajectory.p_world[-1, 2])  # type: ignore[attr-defined]
    cloud = codec_of(channels.CLOUD).decode(poses["/cloud"][0])  # type: ignore[arg-type]
    on_surface = scene.world.obstacles().clearance(cloud.points_map)  # type: ignore[attr-defined]
    assert np.abs(on_surface).max() < 1e-4
    outcome = codec_of(channels.LOG).decode(poses["/log"][0])  # type: ignore[arg-type]
    assert flight.record.end in outcome.text  # type: ignore[attr-defined]


def test_a_flight_without_trajectory_cannot_be_written(tmp_path: Path) -> None:
    scene = set_scene(SwarmSettings(goal_distance_m=6.0), "none", 3)
    flight = fly_abstract(scene, "flock", FollowerSettings(), AbstractSettings())
    with pytest.raises(ValueError, match="was not recorded"):
        write_log(scene, flight, tmp_path / "flight.mcap")
