"""A small network, as little trained as possible, and scenes that are over soon."""

import torch

from sitl.training.evaluation import EvaluationCase
from sitl.training.networks import Policy, build
from sitl.training.settings import NetworkSettings, TrainingSettings

NEAR = (
    EvaluationCase("near_2", "none", followers=2, goal_distance_m=6.0),
    EvaluationCase("near_4", "pillars_5m", followers=4, goal_distance_m=6.0),
)
SMALL = NetworkSettings(azimuth_channels=[4, 4], neighbour_width=8, hidden=[16])
SETTINGS = TrainingSettings(network=SMALL)


def policy(spread: float = 0.0, settings: TrainingSettings = SETTINGS) -> Policy:
    """Return flock, or flock with something random of this size added."""
    actor, _ = build(settings.contract, settings.network, 3, settings.seed)
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        last = actor.mlp[-1]
        last.weight.add_(spread * torch.randn(last.weight.shape, generator=generator))
    return Policy(actor).eval()
