"""What training rewards: the terms, and what each is worth."""

from typing import Literal

import numpy as np
from pydantic import Field

from companion.messages import FloatArray
from companion.settings import Settings
from sitl.training import reward_layout_kernels as place

TERMS = (
    "separation", "cohesion", "proximity", "direction", "altitude", "attitude", "visibility", "recovery",
    "collision", "loss", "smoothness", "residual", "spread", "leash", "alignment",
)  # fmt: skip
"""Names of the terms, in the order of `StepResult.terms`; the first nine are the paper's."""

Direction = Literal["mean", "sum", "mean_all"]


class RewardSettings(Settings):
    """Weights and shapes of the reward; the defaults are the paper's, where the others weigh nothing.

    Source: the reward function of the paper on communication-free collective navigation.
    """

    flock: float = Field(default=1.5, ge=0.0, le=1000.0)
    """Weight of separation and cohesion."""
    obstacle: float = Field(default=2.0, ge=0.0, le=1000.0)
    """Weight of proximity and direction."""
    stable: float = Field(default=1.0, ge=0.0, le=1000.0)
    """Weight of altitude and attitude."""
    perception: float = Field(default=1.0, ge=0.0, le=1000.0)
    """Weight of visibility and recovery."""
    collision: float = Field(default=10.0, ge=0.0, le=10000.0)
    """Cost of a collision to all who take part in it."""
    loss: float = Field(default=0.0, ge=0.0, le=10000.0)
    """Cost of losing the leader, straying, or leaving the altitudes of flight."""
    smoothness: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Weight of the square of the change of the flown command in a step, (m/s)^2."""
    residual: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Weight of the square of the difference to what the law would fly, (m/s)^2."""
    spread: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Weight of the distance beyond `spread_m` from the middle of the flock."""
    leash: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Weight of the distance beyond `leash_m` from the leader."""
    alignment: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Weight of how far the cosine between the own velocity and the flock's is below 1, while both move."""

    separation_m: float = Field(default=1.6, gt=0.0, le=10.0)
    """Others nearer than this cost."""
    cohesion_m: float = Field(default=2.0, ge=0.0, le=20.0)
    """Being farther than this from the middle of the flock costs."""
    cohesion_floor: float = Field(default=5.0, gt=0.0, le=1000.0)
    """It costs no more than this."""
    proximity_m: float = Field(default=3.0, gt=0.0, le=10.0)
    """Surfaces nearer than this cost."""
    direction: Direction = "mean"
    """What is done with the cells of the grid in the cone about the own velocity: their `mean`, their `sum`,
    or their sum over the number of all cells of the grid (`mean_all`)."""
    direction_deg: float = Field(default=20.0, gt=0.0, lt=90.0)
    """Half the opening of that cone."""
    altitude_m: float = Field(default=0.1, gt=0.0, le=10.0)
    """Difference of height to the leader at which the reward for it has fallen to 1/e."""
    attitude: float = Field(default=0.1, gt=0.0, le=10.0)
    """The same for the upright component of the body's upward axis, from 1."""
    recovery_height_m: float = Field(default=1.0, ge=0.0, le=50.0)
    """Where whoever perceives nobody ought to fly."""
    most_visible: int = Field(default=6, ge=1, le=20)
    """Whoever perceives so many perceives enough."""
    spread_m: float = Field(default=2.0, ge=0.0, le=20.0)
    """See `spread`."""
    leash_m: float = Field(default=4.5, ge=0.0, le=20.0)
    """See `leash`."""

    @property
    def weights(self) -> FloatArray:
        """Return the weight (R,) of every term, in the order of `TERMS`."""
        weight = {
            "separation": self.flock,
            "cohesion": self.flock,
            "proximity": self.obstacle,
            "direction": self.obstacle,
            "altitude": self.stable,
            "attitude": self.stable,
            "visibility": self.perception,
            "recovery": self.perception,
        }
        return np.array([weight[name] if name in weight else getattr(self, name) for name in TERMS])

    def packed(self, vehicle_radius_m: float) -> FloatArray:
        """Return the numbers in the order of `reward_layout_kernels`.

        Args:
            vehicle_radius_m: of the ball that collides.
        """
        numbers = {
            place.SEPARATION_REACH: self.separation_m,
            place.COHESION_REACH: self.cohesion_m,
            place.COHESION_FLOOR: self.cohesion_floor,
            place.PROXIMITY_REACH: self.proximity_m,
            place.DIRECTION_MODE: float(("mean", "sum", "mean_all").index(self.direction)),
            place.DIRECTION_COSINE: float(np.cos(np.radians(self.direction_deg))),
            place.ALTITUDE_SCALE: self.altitude_m,
            place.ATTITUDE_SCALE: self.attitude,
            place.RECOVERY_HEIGHT: self.recovery_height_m,
            place.MOST_VISIBLE: float(self.most_visible),
            place.SPREAD_REACH: self.spread_m,
            place.LEASH: self.leash_m,
            place.RADIUS: vehicle_radius_m,
        }
        return np.array([numbers[index] for index in range(place.N_NUMBERS)], np.float64)
