"""A worker's share of a swarm: some of its vehicles, advanced step by step together with all others."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.errors import LogError
from companion.logs.writer import FlightLog
from companion.messages import FloatArray
from sitl.lockstep import BOOT_NS, open_log
from sitl.scenario import Scenario
from sitl.swarm.scene import SwarmScene
from sitl.swarm.table import Table
from sitl.swarm.vehicles import Crew, Member, member_name, member_stage
from sitl.worlds.bodies import poses_midway

LOG_NAME = "flight.mcap"


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """Everything that decides a swarm's flight; equal plans write equal logs.

    Attributes:
        setting: weather, network, vehicle type and operator of all vehicles.
        crew: their profiles.
        scene: where they start and where the leader goes.
        folder: where every vehicle gets a folder with its log.
        packets: log what a replay needs, as the profiles say; light logs otherwise (`member_stage`).
    """

    setting: Scenario
    crew: Crew
    scene: SwarmScene
    folder: Path
    packets: bool

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return len(self.scene.starts_world)

    def log_path(self, number: int) -> Path:
        """Return the name of one vehicle's log."""
        return self.folder / member_name(number) / LOG_NAME


class Share:
    """Some vehicles of a swarm."""

    def __init__(self, plan: FlightPlan, numbers: Sequence[int]) -> None:
        """Switch them on and open their logs.

        Raises:
            LogError, OSError: if a log cannot be created.
        """
        self._logs: list[FlightLog] = []
        self._members: list[Member] = []
        try:
            for number in numbers:
                stage = member_stage(plan.setting, plan.crew, plan.scene, number, packets=plan.packets)
                path = plan.log_path(number)
                path.parent.mkdir(parents=True, exist_ok=True)
                self._logs.append(open_log(stage, path))
                problem = self._logs[-1].status().reason
                if problem:
                    raise LogError(f"{path}: no log: {problem}")
                self._members.append(Member(stage, self._logs[-1], number, plan.vehicles, BOOT_NS))
        except BaseException:
            self.close()
            raise

    def rows(self) -> FloatArray:
        """Return what may be known of these vehicles now (k, WIDTH)."""
        return np.stack([member.row() for member in self._members])

    def move(self) -> FloatArray:
        """Advance the airframes by 5 ms; return their rows."""
        for member in self._members:
            member.move()
        return self.rows()

    def live(self, before: Table, now: Table, *, start_given: bool) -> None:
        """Let everybody measure and talk during the step just made.

        Args:
            before: everybody at its beginning.
            now: everybody at its end.
            start_given: all are ready and may be authorised.
        """
        midway = poses_midway(before.p_world, before.q_world_body, now.p_world, now.q_world_body)
        for member in self._members:
            member.live(midway, now, start_given=start_given)

    def close(self) -> None:
        """Complete the logs."""
        for log in self._logs:
            log.close()
