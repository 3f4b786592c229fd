"""A worker's share of a swarm: some of its vehicles, advanced step by step together with all others."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.errors import LogError
from companion.logs.writer import FlightLog
from companion.messages import FloatArray
from sitl.lockstep import BOOT_NS, open_log
from sitl.scenario import Scenario, Stage
from sitl.slots import PointSlots
from sitl.swarm.eyes import Eye, Midway
from sitl.swarm.scene import SwarmScene
from sitl.swarm.table import Table
from sitl.swarm.vehicles import Crew, Member, member_name, member_stage

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

    def stage(self, number: int) -> Stage:
        """Return what one vehicle needs."""
        return member_stage(self.setting, self.crew, self.scene, number, packets=self.packets)

    def log_path(self, number: int) -> Path:
        """Return the name of one vehicle's log."""
        return self.folder / member_name(number) / LOG_NAME


class Share:
    """Some vehicles of a swarm.

    Attributes:
        eyes: the LiDARs simulated here, by the number of their vehicles.
    """

    def __init__(
        self,
        plan: FlightPlan,
        numbers: Sequence[int],
        *,
        blind: Collection[int] = (),
        hosted: Collection[int] = (),
    ) -> None:
        """Switch them on and open their logs.

        Args:
            plan: of the flight.
            numbers: which vehicles.
            blind: those of them whose LiDAR is simulated elsewhere.
            hosted: other vehicles whose LiDAR is simulated here.

        Raises:
            LogError, OSError: if a log cannot be created.
        """
        self._logs: list[FlightLog] = []
        self._members: dict[int, Member] = {}
        self._blind = sorted(blind)
        self.eyes: dict[int, Eye] = {}
        try:
            for number in hosted:
                self.eyes[number] = Eye(plan.stage(number), number, plan.vehicles)
            for number in numbers:
                stage = plan.stage(number)
                if number not in self._blind:
                    self.eyes[number] = Eye(stage, number, plan.vehicles)
                path = plan.log_path(number)
                path.parent.mkdir(parents=True, exist_ok=True)
                self._logs.append(open_log(stage, path))
                problem = self._logs[-1].status().reason
                if problem:
                    raise LogError(f"{path}: no log: {problem}")
                self._members[number] = Member(stage, self._logs[-1], number, BOOT_NS)
        except BaseException:
            self.close()
            raise

    def rows(self) -> FloatArray:
        """Return what may be known of these vehicles now (k, WIDTH)."""
        return np.stack([member.row() for member in self._members.values()])

    def move(self) -> FloatArray:
        """Advance the airframes by 5 ms; return their rows."""
        for member in self._members.values():
            member.move()
        return self.rows()

    def live(
        self,
        before: Table,
        now: Table,
        midway: Midway,
        *,
        start_given: bool,
        receive: Callable[[], PointSlots] | None = None,
    ) -> None:
        """Let everybody measure and talk during the step just made.

        Args:
            before: everybody at its beginning.
            now: everybody at its end.
            midway: everybody in its middle.
            start_given: all are ready and may be authorised.
            receive: waits for what a LiDAR simulated elsewhere measured, those of the vehicles with lower
                numbers first.
        """
        for number, member in self._members.items():
            if number not in self._blind:
                slots = self.eyes[number].look(before, now, midway)
                member.live(slots, now, start_given=start_given)
        for number in self._blind:
            assert receive is not None
            self._members[number].live(receive(), now, start_given=start_given)

    def close(self) -> None:
        """Complete the logs."""
        for log in self._logs:
            log.close()
