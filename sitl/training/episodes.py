"""How the trials went that ended during a rollout, in a few numbers."""

from collections.abc import Sequence

import numpy as np

from sitl.training.environment_results import EpisodeSummary


def summarise(finished: Sequence[EpisodeSummary]) -> dict[str, float]:
    """Return means over trials that ended, and how many there were; nothing else if there were none.

    Rates are shares in per cent of the trials that began at a start: those that began before a stored crash
    are hard by choice, and are counted apart.
    """
    whole = [episode for episode in finished if not episode.replayed]
    replayed = [episode for episode in finished if episode.replayed]
    numbers: dict[str, float] = {"count": len(whole), "replayed": len(replayed)}
    if replayed:
        numbers["replayed_SR"] = _percentage(replayed, "success")
    if not whole:
        return numbers
    numbers["SR"] = _percentage(whole, "success")
    for end in sorted({episode.end for episode in whole} - {"success"}):
        numbers[f"end_{end}"] = _percentage(whole, end)
    for name, attribute in (
        ("FR", "flock_radius_m"),
        ("MS", "minimum_separation_m"),
        ("AL", "alignment"),
        ("steps", "steps"),
        ("total", "total"),
    ):
        values = np.array([getattr(episode, attribute) for episode in whole], float)
        if np.isfinite(values).any():
            numbers[name] = float(np.nanmean(values))
    return numbers


def _percentage(episodes: Sequence[EpisodeSummary], end: str) -> float:
    return 100.0 * sum(episode.end == end for episode in episodes) / len(episodes)
