"""How a network learns a law by watching it fly."""

from typing import Literal

from pydantic import Field

from companion.settings import Settings


class ImitationSettings(Settings):
    """Rounds of flying and learning; what flies is ever more the network itself.

    Source: Ross et al., A reduction of imitation learning and structured prediction to no-regret online
    learning (DAgger), 2011.
    """

    sight: Literal["own", "clear"] = "own"
    """What the law sees whose commands are learned: `own`, as the follower sees it; `clear`, what is in sight
    as it is, without noise, delay or misses."""
    cohesion: float = Field(default=1.0, ge=0.0, le=10.0)
    """With `clear` sight: the learned law's cohesion, as a multiple of the follower's own."""
    trust: float = Field(default=1.0, gt=0.0, le=1.0)
    """With `clear` sight: share of the difference to what the follower's own law wants that is learned: the
    whole of it draws the flock together, too."""
    rounds: int = Field(default=60, ge=1, le=100_000)
    """Of flying and learning."""
    steps: int = Field(default=64, ge=1, le=1024)
    """Control steps that are flown in a round."""
    teacher_rounds: int = Field(default=15, ge=0, le=100_000)
    """Over so many rounds the share of followers that the law itself flies falls from 1 to 0."""
    keep: float = Field(default=0.125, gt=0.0, le=1.0)
    """Share of what was seen that is kept to learn from: successive steps are much alike."""
    capacity: int = Field(default=120_000, ge=100, le=10_000_000)
    """Observations kept; new ones replace the oldest."""
    noise_mps: float = Field(default=0.1, ge=0.0, le=1.0)
    """Standard deviation of what is added to the velocity that a follower flies, held for a second: so that
    getting back into place is seen, too."""
    gradient_steps: int = Field(default=100, ge=1, le=100_000)
    """In a round."""
    minibatch: int = Field(default=1024, ge=1, le=100_000)
    """Observations of a gradient step."""
    rate: float = Field(default=1e-3, gt=0.0, le=0.1)
    """Learning rate at the start; it falls to a twentieth like a cosine."""
    huber_mps: float = Field(default=0.2, gt=0.0, le=10.0)
    """Larger errors of a velocity count no more than in proportion."""
