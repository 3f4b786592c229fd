"""One flight of a swarm from its scenario file, in either fidelity."""

import math
from dataclasses import dataclass
from pathlib import Path

from companion.config import load_profile
from companion.errors import ProfileError
from companion.kernel_cache import load_kernels
from sitl.abstract.flight import fly_abstract
from sitl.abstract.flight_log import write_log
from sitl.abstract.settings import AbstractSettings
from sitl.scenario import Scenario
from sitl.swarm.full import FullFlight, Progress, fly_full
from sitl.swarm.record import Fidelity, TrialRecord
from sitl.swarm.referee import TrialNames
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import SwarmSettings
from sitl.swarm.vehicles import Crew, member_name

ABSTRACT_LOG = "swarm.mcap"
FULL_LOG = "flight.mcap"


@dataclass(frozen=True, slots=True)
class SwarmOutcome:
    """What a swarm's flight came to.

    Attributes:
        record: the trial, judged.
        full: more about a flight in full fidelity.
        logs: of every vehicle, the leader's first; a single one of an abstract flight.
    """

    record: TrialRecord
    full: FullFlight | None
    logs: tuple[Path, ...]

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        record, full = self.record, self.full
        result: dict[str, object] = {
            "success": record.end == "success",
            "reason": record.end,
            "ended_by": list(record.ended_by),
            "fidelity": record.fidelity,
            "world": record.world,
            "method": record.method,
            "followers": record.followers,
            "seed": record.seed,
            "scene_hash": record.scene_hash,
            "t_end_s": record.t_end_s,
            "MP": _number(record.mission_progress_percent),
            "FR": _number(record.flock_radius_m),
            "MS": _number(record.minimum_separation_m),
            "AL": _number(record.alignment),
            "MDO": _number(record.obstacle_distance_m),
            "logs": [str(log) for log in self.logs],
        }
        if full is not None:
            result["start_s"] = full.start_s
            result["sim_time_s"] = full.sim_time_s
            result["wall_time_s"] = full.wall_time_s
            result["real_time_factor"] = full.sim_time_s / full.wall_time_s
            result["vehicles"] = [
                {
                    "vehicle": member_name(member.number),
                    "state": member.state.value,
                    "leader_distance_m": member.leader_distance_m,
                    "obstacle_contacts": member.obstacle_contacts,
                    "log": str(member.log),
                }
                for member in full.members
            ]
        return result


def fly_scenario(
    scenario: Scenario,
    folder: Path,
    seed: int | None,
    out: Path,
    *,
    fidelity: Fidelity = "full",
    workers: int | None = None,
    packets: bool = True,
    on_progress: Progress | None = None,
) -> SwarmOutcome:
    """Fly a scenario with a swarm and judge it; older logs in `out` are kept under other names.

    Args:
        scenario: with its section `swarm`.
        folder: of the scenario's file, to which names of files in it are relative.
        seed: instead of the scenario's own.
        out: folder of the logs.
        fidelity: of the flight.
        workers: processes in full fidelity, one a core by default; results do not depend on it.
        packets: log raw LiDAR packets and clouds too, as the profiles say.
        on_progress: called once a simulated second in full fidelity.

    Raises:
        ProfileError: if a profile or a file of the world is wrong, or the scene cannot be built.
        LogError, OSError: if a log cannot be written.
        WorkerLostError: if a process dies.
    """
    swarm = scenario.swarm
    if swarm is None:
        raise ProfileError("the scenario has no section swarm")
    crew = Crew(load_profile(folder / scenario.profile), load_profile(folder / swarm.follower_profile))
    _check_roles(crew, scenario, swarm)
    scene = _scene(scenario, swarm, folder, scenario.seed if seed is None else seed)
    world = scenario.world.site or "own world"
    names = TrialNames(world, crew.follower.follower.method if crew.follower.follower else "hold")
    load_kernels()
    if fidelity == "abstract":
        return _abstractly(crew, scene, scenario, swarm, names, out)
    keep_older([out / member_name(number) / FULL_LOG for number in range(swarm.followers + 1)])
    flight = fly_full(
        scene,
        crew,
        scenario,
        out,
        names,
        termination=swarm.termination,
        workers=workers,
        packets=packets,
        on_progress=on_progress,
    )
    return SwarmOutcome(flight.record, flight, tuple(flight.logs))


def keep_older(logs: list[Path]) -> None:
    """Rename logs of an earlier flight that new ones would replace, finished or not."""
    for log in logs:
        for older in (log, log.with_name(f"{log.name}.open")):
            if older.exists():
                older.replace(older.with_name(f"previous-{older.name}"))


def _abstractly(
    crew: Crew, scene: SwarmScene, scenario: Scenario, swarm: SwarmSettings, names: TrialNames, out: Path
) -> SwarmOutcome:
    follower = crew.follower.follower
    if follower is None:
        raise ProfileError("an abstract flight needs a section follower in the followers' profile")
    settings = AbstractSettings(
        neighbours=crew.follower.neighbours,
        grid=crew.follower.grid,
        quadrotor=scenario.quadrotor,
        wind=scenario.wind,
    )
    flight = fly_abstract(
        scene,
        follower.method,
        follower,
        settings,
        termination=swarm.termination,
        record=True,
        world_name=names.world,
        leader=crew.leader.leader,
    )
    out.mkdir(parents=True, exist_ok=True)
    log = out / ABSTRACT_LOG
    keep_older([log])
    write_log(scene, flight, log)
    return SwarmOutcome(flight.record, None, (log,))


def _check_roles(crew: Crew, scenario: Scenario, swarm: SwarmSettings) -> None:
    for file, profile, wanted in (
        (scenario.profile, crew.leader, "leader"),
        (swarm.follower_profile, crew.follower, "follower"),
    ):
        if profile.role != wanted:
            raise ProfileError(f"{file}: role: {profile.role!r}, a swarm needs {wanted!r} here")


def _scene(scenario: Scenario, swarm: SwarmSettings, folder: Path, seed: int) -> SwarmScene:
    try:
        return set_scene(swarm, scenario.world, seed, folder=folder)
    except ValueError as error:
        raise ProfileError(f"no scene can be built: {error}") from None


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
