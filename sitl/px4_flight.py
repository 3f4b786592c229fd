"""A flight of a PX4 that somebody else runs, with its internal simulator: our sensors follow its motion."""

import asyncio
import gc
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from companion.clock import SystemClock, ns_to_seconds, seconds_to_ns
from companion.config import load_profile
from companion.control_socket import NotRunningError, ask
from companion.errors import StartError
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.kernel_cache import load_kernels
from companion.logs import channels
from companion.logs.log_queue import LogEntry
from companion.logs.records import StampedPose
from companion.messages import LandedState
from sitl.companion_process import CompanionProcess, run_until_terminated
from sitl.dynamics import GRAVITY, STEP_NS
from sitl.ground_link import GROUND_ADDRESS, GroundLink
from sitl.kinematics import Kinematics
from sitl.livox_sockets import LivoxSockets
from sitl.network import Network
from sitl.operator import Operator, ScriptStatus
from sitl.operator_script import land_now, takeoff
from sitl.outcome import Ending
from sitl.px4_parameters import ParameterVisit
from sitl.px4_truth import Px4Truth, Px4TruthSettings
from sitl.referee import Referee, Sighting
from sitl.scenario import Scenario, Stage, set_stage
from sitl.truth_link import TruthLink
from sitl.vehicle import build_livox, build_sensors, operator_settings
from sitl.vehicle_truth import VehicleTruth

Progress = Callable[[float, str, float], None]

_TRUTH_TIMEOUT_NS = seconds_to_ns(20.0)
_SETTLED_MESSAGES = 50
_TRUTH_PERIOD_NS = seconds_to_ns(0.02)
_PROGRESS_PERIOD_NS = seconds_to_ns(1.0)
_ENGAGE_PERIOD_NS = seconds_to_ns(1.0)
_PROFILE_NAME = "px4_profile.yaml"


class Px4Flight:
    """Our LiDAR and IMU on the motion of somebody else's PX4, and one companion that flies it."""

    def __init__(self, stage: Stage, truth: Px4Truth, folder: Path, clock: SystemClock) -> None:
        """Switch the emulated sensor on."""
        boot_ns = clock.now_ns()
        self._stage = stage
        self._clock = clock
        self._truth = truth
        self._t_ns = boot_ns
        self._motion = _kinematics(self._state(boot_ns))
        self._sensors = build_sensors(stage)
        self._lidar = LivoxSockets(
            build_livox(stage, boot_ns),
            clock,
            hears_broadcast=stage.profile.lidar.broadcast_search,
            network=Network(stage.scenario.network, stage.generator("network"), boot_ns),
        )
        self.companion = CompanionProcess(stage.profile_path, folder)
        self.operator = Operator(takeoff(stage.scenario.operator.takeoff_height_m), operator_settings(stage))
        self.ground = GroundLink(self.operator, clock)
        self.referee = Referee(stage, boot_ns)
        self.truth_log: list[LogEntry] = []
        self._obstacles = stage.world.obstacles()
        self._collisions = 0
        self._touching = False
        self._next_truth_ns = boot_ns
        self._next_engage_ns: int | None = None
        self.engaged = False

    async def open(self) -> None:
        """Open all sockets and start the companion.

        Raises:
            OSError: if an address is taken.
        """
        await self.ground.open(GROUND_ADDRESS)
        self._lidar.start()
        await self.companion.start()

    async def close(self) -> None:
        """End the companion, land what still flies, then end the emulated sensor."""
        await self.companion.stop()
        if self.operator.view.armed:
            self.operator.follow(land_now())
            while self.operator.status is ScriptStatus.RUNNING:
                await self.advance()
        self._lidar.stop()
        self.ground.close()

    async def advance(self) -> None:
        """Follow the published motion up to now and let the sensor measure it."""
        while self._t_ns + STEP_NS <= self._clock.now_ns():
            self._t_ns += STEP_NS
            state = self._state(self._t_ns)
            motion = _kinematics(state)
            # Standing with idle motors and flying shake the sensor; how much is the model's business.
            thrust = GRAVITY if self.operator.view.armed else 0.0
            slots, inertial = self._sensors.step(self._motion, motion, STEP_NS, thrust)
            self._lidar.inertial(inertial)
            self._lidar.points(slots)
            self._watch(state, motion)
            self._motion = motion
            self.ground.poll()
            await self._clock.sleep(0)
        await self._engage_when_due()
        await self._clock.sleep_until(self._t_ns + STEP_NS)

    def _state(self, t_ns: int) -> VehicleTruth:
        state = self._truth.state_at(t_ns)
        if state is None:
            raise StartError("simulator's motion: nothing was received")
        return state

    def _watch(self, state: VehicleTruth, motion: Kinematics) -> None:
        contact = self._obstacles.first_contact(
            self._motion.p_world[None, :], motion.p_world[None, :], self._stage.scenario.vehicle_radius_m
        )
        touching = bool(np.isfinite(contact[0]))
        self._collisions += touching and not self._touching
        self._touching = touching
        view = self.operator.view
        landed = view.landed is LandedState.ON_GROUND
        self.referee.watch(Sighting(self._t_ns, state.p_world, landed, view.armed, self._collisions))
        if self._t_ns >= self._next_truth_ns:
            self._next_truth_ns = self._t_ns + _TRUTH_PERIOD_NS
            pose = StampedPose(self._t_ns, "world", state.p_world, state.q_world_body)
            self.truth_log.append(LogEntry(channels.TRUTH, self._t_ns, len(self.truth_log), pose))
        if self.operator.status is ScriptStatus.FAILED:
            self.referee.end(f"the operator gave up: {self.operator.reason}")

    async def _engage_when_due(self) -> None:
        """Authorise on the companion's own computer, once the vehicle has hovered for a while."""
        if self.engaged or not self.companion.running or self.operator.status is not ScriptStatus.DONE:
            return
        if self._next_engage_ns is None:
            self._next_engage_ns = self._t_ns + seconds_to_ns(self._stage.scenario.operator.authorise_after_s)
        if self._t_ns < self._next_engage_ns:
            return
        self._next_engage_ns = self._t_ns + _ENGAGE_PERIOD_NS
        try:
            answer = await asyncio.to_thread(ask, self.companion.control_socket, {"verb": "engage"})
        except NotRunningError:
            return
        self.engaged = answer.get("ok") is True


def _kinematics(state: VehicleTruth) -> Kinematics:
    return Kinematics(state.p_world, state.v_world, state.q_world_body, state.omega_body)


def _derived_profile(profile_path: Path, url: str, folder: Path) -> Path:
    """Write a profile that differs from the scenario's only in the autopilot's address."""
    path = folder / _PROFILE_NAME
    parent = os.path.relpath(profile_path.resolve(), folder.resolve())
    text = yaml.safe_dump({"extends": parent, "autopilot": {"url": url}}, sort_keys=False)
    path.write_text(text, encoding="utf-8")
    return path


async def _fly(
    scenario: Scenario,
    folder: Path,
    seed: int | None,
    log_path: Path,
    url: str,
    truth_address: tuple[str, int],
    apply: bool,
    on_progress: Progress | None,
    on_parameter: Callable[[str], None],
) -> Ending:
    clock = SystemClock()
    start_ns = clock.now_ns()
    truth = Px4Truth(Px4TruthSettings(), np.array([*scenario.start_world_m, _standing_m(scenario)]))
    link = TruthLink(truth, clock)
    await link.open(truth_address)
    flight: Px4Flight | None = None
    try:
        profile = _derived_profile(folder / scenario.profile, url, log_path.parent)
        load_profile(profile)  # a wrong address is told before anybody waits for PX4
        await link.wait(clock, _TRUTH_TIMEOUT_NS, _SETTLED_MESSAGES)
        scenario = scenario.model_copy(update={"profile": profile.name})
        state = truth.state_at(clock.now_ns())
        if state is None:
            raise StartError("simulator's motion: nothing was received")
        T_world_start = Pose.of(state.p_world, rotation.from_yaw(rotation.yaw_of(state.q_world_body)))
        stage = set_stage(scenario, log_path.parent, seed, T_world_start)
        for line in await ParameterVisit(stage.profile, clock).run(apply=apply):
            on_parameter(line)
        flight = Px4Flight(stage, truth, log_path.parent, clock)
        await flight.open()
        await _until_over(flight, on_progress)
    finally:
        link.close()
        if flight is not None:
            await flight.close()
            flight.companion.hand_over_log(flight.truth_log, log_path)
    return flight.referee.ending(wall_time_s=ns_to_seconds(clock.now_ns() - start_ns))


async def _until_over(flight: Px4Flight, on_progress: Progress | None) -> None:
    referee = flight.referee
    next_progress_ns = referee.t_ns
    while not referee.over:
        await flight.advance()
        if not flight.companion.running:
            referee.end(f"the companion ended: {flight.companion.last_words()}")
        if on_progress is not None and referee.t_ns >= next_progress_ns:
            next_progress_ns = referee.t_ns + _PROGRESS_PERIOD_NS
            on_progress(referee.elapsed_s, flight.operator.view.mode.value, referee.goal_distance_m)


def _standing_m(scenario: Scenario) -> float:
    return scenario.quadrotor.ground_height_m + scenario.quadrotor.standing_height_m


def fly_px4(
    scenario: Scenario,
    folder: Path,
    seed: int | None,
    log_path: Path,
    *,
    url: str,
    truth_address: tuple[str, int],
    apply: bool,
    on_progress: Progress | None = None,
    on_parameter: Callable[[str], None] = lambda line: None,
) -> Ending:
    """Fly a PX4 that runs already.

    Args:
        scenario: world and operator; the start is where the simulator stands.
        folder: of the scenario's file.
        seed: instead of the scenario's own.
        log_path: where the companion's log goes, with the truth added; must not exist.
        url: where the autopilot speaks to companions.
        truth_address: where its simulator sends HIL_STATE_QUATERNION to.
        apply: write the parameters that differ.
        on_progress: called once a second with (seconds, the autopilot's mode, goal distance in m).
        on_parameter: called with one line for every parameter that differs.

    Raises:
        StartError: if PX4, its simulator or the companion cannot be reached.
        OSError: if an address is taken.
    """
    load_kernels()
    gc.collect()
    gc.freeze()
    return run_until_terminated(
        _fly(scenario, folder, seed, log_path, url, truth_address, apply, on_progress, on_parameter)
    )
