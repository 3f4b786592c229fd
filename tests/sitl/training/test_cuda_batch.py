"""On a graphics card swarms fly as on the processor; here the card is Numba's simulator of CUDA."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import cuda

from companion.errors import StartError
from sitl.training.cuda_batch import CudaSwarmBatch
from sitl.training.environment_settings import EnvironmentSettings

# The simulator is chosen when Numba is imported, so it gets a process of its own. There every thread runs the
# plain Python of the kernels; random words of 64 bits overflow on purpose, of which NumPy warns.
COMPARE = """
import sys
import numpy as np
from sitl.training.cuda_batch import CudaSwarmBatch
from sitl.training.environment import EnvironmentSettings, SwarmBatch
from sitl.training.environment_settings import ReplaySettings
from sitl.training.randomisation import WIDE

ARRAYS = ("ego", "neighbours", "grid", "memory", "privileged", "reference")
settings = EnvironmentSettings(
    swarms=2, followers=[2, 1], worlds={"forest": 1.0}, perceptions={"paper": 1.0, "measured": 1.0}, scenes=2,
    stagger_s=STAGGER, episode_s=1.0, randomisation=WIDE, replay=ReplaySettings(share=0.5, before_s=0.5),
)
processor = SwarmBatch(settings, CONTRACT, 3)
card = CudaSwarmBatch(settings, CONTRACT, 3, bank=processor.bank)


def largest(ours, theirs):
    return float(np.max(np.abs(np.array(ours, float) - np.array(theirs, float)), initial=0.0))


def seen(ours, theirs):
    return max(largest(getattr(ours, name), getattr(theirs, name)) for name in ARRAYS)


def told(result):
    return [(end.swarm, end.end, end.ended_by, end.steps, end.world, end.replayed) for end in result.finished]


worst = seen(processor.reset(), card.reset())
rng = np.random.default_rng(0)
finished = 0
for step in range(STEPS):
    if step == 5:
        worst = max(worst, seen(processor.observation, card.restore(processor.state())))
    if step == 7:
        worst = max(worst, seen(processor.restore(card.state()), card.observation))
    reference = processor.observation.reference
    velocity = (reference + rng.normal(0.0, 0.3, reference.shape)).astype(np.float32)
    is_shown = step % 3 != 1
    ours, theirs = processor.step(velocity, is_shown=is_shown), card.step(velocity, is_shown=is_shown)
    worst = max(worst, seen(ours.observation, theirs.observation), largest(ours.terms, theirs.terms))
    worst = max(worst, largest(ours.reward, theirs.reward))
    assert np.array_equal(ours.terminated, np.array(theirs.terminated))
    assert np.array_equal(ours.truncated, np.array(theirs.truncated))
    assert told(ours) == told(theirs), (told(ours), told(theirs))
    finished += len(ours.finished)
print(worst, finished)
"""


def compare(contract: str, stagger_s: float, steps: int) -> tuple[float, int]:
    """Return the largest difference of any number, and how many trials ended meanwhile."""
    constants = f"CONTRACT, STAGGER, STEPS = {contract!r}, {stagger_s}, {steps}\n"
    root = Path(__file__).parents[3]
    result = subprocess.run(
        [sys.executable, "-W", "ignore::RuntimeWarning", "-c", constants + COMPARE],
        cwd=root,
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1", "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert result.returncode == 0, result.stderr
    worst, finished = result.stdout.split()
    return float(worst), int(finished)


def test_the_card_s_swarms_see_earn_end_and_begin_anew_like_the_processor_s() -> None:
    worst, finished = compare("best-2", 0.0, 22)
    assert worst < 1e-6
    assert finished == 2


def test_staggered_trials_and_the_paper_s_observations_agree_too() -> None:
    worst, _ = compare("paper-1", 0.2, 8)
    assert worst < 1e-6


def test_without_a_graphics_card_it_says_so_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "is_available", lambda: False)
    with pytest.raises(StartError, match=r"no graphics card .* --device cpu"):
        CudaSwarmBatch(EnvironmentSettings(), "best-2", 0)


def test_without_its_compiler_it_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "is_available", lambda: True)
    monkeypatch.setattr(cuda, "implementation", "Built-in")
    with pytest.raises(StartError, match=r"numba-cuda is missing: install the extra gpu"):
        CudaSwarmBatch(EnvironmentSettings(), "best-2", 0)
