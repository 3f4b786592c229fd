"""The members of a swarm: each a complete vehicle that sees the others as shapes in its LiDAR's world."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import SeedSequence

from companion.config import Profile
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.logs.writer import FlightLog
from companion.messages import FlightState, FloatArray
from sitl import dynamics
from sitl.scenario import Scenario, Stage
from sitl.slots import PointSlots
from sitl.stepped_vehicle import SteppedVehicle
from sitl.swarm.scene import SwarmScene
from sitl.swarm.sight import LeaderSight
from sitl.swarm.start import StartSignal, swarm_operator
from sitl.swarm.table import (
    COLLISIONS,
    LEADER_SEEN_S,
    MISSION_OVER,
    NEVER_S,
    READY,
    STATE,
    STATE_NUMBERS,
    TURN,
    WIDTH,
    P,
    Q,
    Table,
    V,
)
from sitl.vehicle import operator_settings

ROTOR_HZ = 95.0
LIGHT_ODOMETRY_HZ = 20.0
_ROTOR_SPREAD = 0.05


@dataclass(frozen=True, slots=True)
class Crew:
    """Who flies.

    Attributes:
        leader, follower: profiles; name, system id and the leader's mission are set for each vehicle.
    """

    leader: Profile
    follower: Profile


def member_name(number: int) -> str:
    """Return the name of a vehicle, of its folder and in its log: number 0 leads."""
    return f"vehicle_{number:02d}_{'leader' if number == 0 else 'follower'}"


def member_stage(
    setting: Scenario, crew: Crew, scene: SwarmScene, number: int, *, packets: bool = True
) -> Stage:
    """Return what one vehicle of a swarm needs for its flight.

    Args:
        setting: weather, network, vehicle type and operator of all of them.
        crew: their profiles.
        scene: where they start and where the leader goes.
        number: which vehicle.
        packets: log what a replay needs, as the profile says; otherwise no LiDAR packets, clouds and MAVLink
            messages, and odometry at 20 Hz.
    """
    floor_m = setting.quadrotor.ground_height_m + setting.quadrotor.standing_height_m
    x, y, height = scene.starts_world[number].tolist()
    T_world_start = Pose.of([x, y, floor_m], rotation.from_yaw(scene.yaws[number]))
    profile = _member_profile(crew, scene, number, T_world_start)
    if not packets:
        log = profile.log.model_copy(
            update={"raw_lidar": False, "clouds": False, "mavlink": False, "odometry_hz": LIGHT_ODOMETRY_HZ}
        )
        profile = profile.model_copy(update={"log": log})
    operator = setting.operator.model_copy(update={"takeoff_height_m": height - floor_m})
    return Stage(
        scenario=setting.model_copy(
            update={"operator": operator, "seed": scene.seed, "start_world_m": (x, y)}
        ),
        profile=profile,
        profile_path=Path(setting.profile),
        world=scene.world,
        T_world_start=T_world_start,
        goal_world=scene.waypoints_world[-1],
        seeds=SeedSequence([scene.seed, number]),
    )


def _member_profile(crew: Crew, scene: SwarmScene, number: int, T_world_start: Pose) -> Profile:
    profile = crew.leader if number == 0 else crew.follower
    changes: dict[str, object] = {
        "vehicle": profile.vehicle.model_copy(update={"name": member_name(number)}),
        "autopilot": profile.autopilot.model_copy(update={"system_id": number + 1}),
    }
    if number == 0 and profile.leader is not None:
        T_start_world = T_world_start.inverse()
        waypoints = [T_start_world.transform(waypoint).tolist() for waypoint in scene.waypoints_world]
        mission = profile.leader.mission.model_copy(
            update={
                "waypoints_m": waypoints,
                "speed_mps": scene.speed_mps,
                "wait_s": scene.wait_s,
                "ramp_s": scene.ramp_s,
                "waypoint_holds_s": scene.holds_s[:-1].tolist(),
                "final_hold_s": float(scene.holds_s[-1]),
                "land_when_finished": False,
            }
        )
        changes["leader"] = profile.leader.model_copy(update={"mission": mission})
    return profile.model_copy(update=changes)


class Member:
    """One vehicle among others, in steps of 5 ms."""

    def __init__(self, stage: Stage, log: FlightLog, number: int, boot_ns: int) -> None:
        """Switch everything on at host time `boot_ns`.

        Args:
            stage: of this vehicle.
            log: of this vehicle.
            number: which of them it is.
            boot_ns: time of power-on.
        """
        operator = stage.scenario.operator
        self._signal = StartSignal(operator.authorise_after_s)
        self._vehicle = SteppedVehicle(
            stage,
            log,
            boot_ns,
            swarm_operator(operator_settings(stage), operator.takeoff_height_m, self._signal),
        )
        self._sight = LeaderSight(number) if number > 0 else None
        spread = stage.generator("rotors").uniform(-_ROTOR_SPREAD, _ROTOR_SPREAD)
        self._rotor_turn = 2.0 * math.pi * ROTOR_HZ * (1.0 + spread) * dynamics.STEP_S
        self._turn = 0.0

    @property
    def state(self) -> FlightState:
        """The companion's state."""
        return self._vehicle.companion.state

    def move(self) -> None:
        """Advance the airframe by 5 ms."""
        self._vehicle.move()
        if self._vehicle.simulated.autopilot.armed:
            self._turn = math.fmod(self._turn + self._rotor_turn, 2.0 * math.pi)

    def row(self) -> FloatArray:
        """Return what the others' light and the referee may know of this vehicle now."""
        row = np.empty(WIDTH)
        motion = self._vehicle.simulated.airframe.kinematics
        row[P], row[V], row[Q] = motion.p_world, motion.v_world, motion.q_world_body
        row[TURN] = self._turn
        row[COLLISIONS] = self._vehicle.simulated.airframe.collisions
        row[STATE] = STATE_NUMBERS[self.state]
        row[READY] = self._signal.ready and self._knows_somebody()
        row[LEADER_SEEN_S] = NEVER_S if self._sight is None else self._sight.seen_s
        row[MISSION_OVER] = self._vehicle.companion.mission_over
        return row

    def _knows_somebody(self) -> bool:
        """A follower is let go only once its companion reports a neighbour."""
        tracks = self._vehicle.companion.tracks
        if self._sight is None:
            return True
        return tracks is not None and any(track.validated for track in tracks.tracks)

    def live(self, slots: PointSlots, now: Table, *, start_given: bool) -> None:
        """Measure and talk during the step just made.

        Args:
            slots: what the LiDAR measured.
            now: everybody at its end.
            start_given: all are ready and may be authorised.
        """
        self._signal.given = start_given
        self._vehicle.live(slots)
        if self._sight is not None:
            self._sight.remember(self._vehicle.simulated.t_ns, now)
            companion = self._vehicle.companion
            self._sight.judge(companion.tracks, companion.scan_odometry)


def shares(vehicles: int, workers: int) -> list[tuple[int, ...]]:
    """Return which vehicles each worker advances; the first share, of who also judges, is never larger.

    Args:
        vehicles: how many there are.
        workers: among how many they are shared; no more than there are vehicles are used.
    """
    used = max(1, min(workers, vehicles))
    dealt: Sequence[tuple[int, ...]] = [tuple(range(first, vehicles, used)) for first in range(used)]
    return sorted(dealt, key=lambda share: (len(share), -share[0]))
