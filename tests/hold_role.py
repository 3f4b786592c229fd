"""The role of a vehicle that only keeps its place, for tests that need none in particular."""

from dataclasses import dataclass

import numpy as np

from companion.messages import (
    NeighbourTracks,
    Odometry,
    PlanUpdate,
    RegisteredScan,
    StatusText,
    VelocityCommand,
)


@dataclass(frozen=True, slots=True)
class HoldDecision:
    """Zero velocity, for as long as control lasts."""

    command: VelocityCommand
    plan: PlanUpdate | None = None
    finished: bool = False
    remarks: tuple[StatusText, ...] = ()


class HoldRole:
    """Brakes and stays; never finishes by itself."""

    counters = None

    def meet(self, tracks: NeighbourTracks) -> None:
        """Nobody near changes what a holding vehicle does."""

    def observe(self, scan: RegisteredScan) -> None:
        """Nothing in the surroundings changes what a holding vehicle does."""

    def decide(self, odometry: Odometry, t_ns: int) -> HoldDecision:
        """Ask for zero velocity on the strength of the newest odometry."""
        return HoldDecision(VelocityCommand(odometry.t_ns, np.zeros(3), 0.0))

    def reset(self, odometry: Odometry) -> None:
        """Keep no memory."""
