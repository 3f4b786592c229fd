"""What a training environment is made of."""

from typing import Annotated

from pydantic import Field, model_validator

from companion.control.followers.settings import FollowerSettings
from companion.settings import Settings
from companion.yaml_problems import misfit
from sitl.abstract.settings import AbstractSettings, Preset
from sitl.swarm.settings import Behaviour, SwarmSettings
from sitl.training.randomisation import RandomisationSettings
from sitl.training.reward_settings import RewardSettings
from sitl.worlds.sites import OPEN_SITES

Share = Annotated[float, Field(ge=0.0, le=1000.0)]

TRAINING_WORLDS = (*OPEN_SITES, "pillars_4m")
"""Worlds to train in: open country of the catalogue, and a denser field of pillars."""


class ReplaySettings(Settings):
    """Flying again what went wrong."""

    share: float = Field(default=0.0, ge=0.0, le=0.95)
    """Share of trials that begin shortly before a stored crash instead of at a start."""
    before_s: float = Field(default=2.0, ge=0.5, le=4.0)
    """How long before the crash they begin, at least."""
    uses: int = Field(default=6, ge=1, le=100)
    """A crash is forgotten after it has been flown again so often."""
    kept: int = Field(default=200, ge=1, le=10000)
    """Crashes kept for each size of swarm; new ones replace the oldest."""


class EnvironmentSettings(Settings):
    """Swarms, scenes and rules of training; shares are relative to their sum."""

    swarms: int = Field(default=192, ge=1, le=65536)
    """How many fly at once."""
    followers: list[int] = Field(default=[4], min_length=1, max_length=64)
    """Sizes of the swarms without their leaders, in turn."""
    worlds: dict[str, Share] = Field(default={"pillars_5m": 1.0}, min_length=1)
    """Shares of the worlds: none, pillars_10m, pillars_5m, pillars_4m, simplified_forest, forest."""
    behaviours: dict[Behaviour, Share] = Field(default={"straight": 1.0}, min_length=1)
    """Shares of the leaders' behaviours."""
    perceptions: dict[Preset, Share] = Field(default={"paper": 1.0}, min_length=1)
    """Shares of the known perceptions; `measured` also flies as a quadrotor, `paper` with a lag."""
    scenes: int = Field(default=512, ge=1, le=1_000_000)
    """Scenes that are built before the first step and flown in turn at random."""
    first_scene: int = Field(default=0, ge=0, le=900_000_000)
    """Number of the first scene among those for training."""
    swarm: SwarmSettings = SwarmSettings()
    """Start, leader and rules; number and behaviour are those above."""
    follower: FollowerSettings = FollowerSettings()
    """Gains of the law that flies beside the policy, and limits of commands."""
    observable_neighbours: int = Field(default=12, ge=1, le=20)
    """How many neighbours are passed on."""
    compensate_latency: bool = True
    """Neighbours are predicted to now."""
    episode_s: float = Field(default=60.0, ge=1.0, le=600.0)
    """A trial is cut off after this time (the value of what would follow is estimated)."""
    end_on_loss: bool = True
    """A lost leader or a straying follower ends the trial; otherwise it goes on."""
    strayed_m: float = Field(default=10.0, ge=2.0, le=100.0)
    """A follower farther than this from its leader has strayed."""
    stagger_s: float = Field(default=20.0, ge=0.0, le=120.0)
    """The first trials have been flown by the law for a random time up to this when learning begins, so that
    swarms are not all at the same point of their trials."""
    randomisation: RandomisationSettings = RandomisationSettings()
    """What differs from trial to trial."""
    replay: ReplaySettings = ReplaySettings()
    """Flying again what went wrong."""
    reward: RewardSettings = RewardSettings()
    """What is rewarded."""

    @model_validator(mode="after")
    def _is_possible(self) -> "EnvironmentSettings":
        for index, number in enumerate(self.followers):
            if not 1 <= number <= 20:
                raise misfit(("followers", index), f"{number}", "1 to 20")
        for name in self.worlds:
            if name not in TRAINING_WORLDS:
                raise misfit(("worlds",), f"{name!r}", f"{', '.join(TRAINING_WORLDS)}")
        for key in ("worlds", "behaviours", "perceptions"):
            if not sum(getattr(self, key).values()) > 0.0:
                raise misfit((key,), "no share above 0", "at least one")
        return self

    def abstract(self, preset: Preset) -> AbstractSettings:
        """Return perception and motion under one of the known perceptions."""
        known = AbstractSettings.of(preset)
        seen = {"count": self.observable_neighbours, "compensate_latency": self.compensate_latency}
        return known.model_copy(update={"neighbours": known.neighbours.model_copy(update=seen)})
