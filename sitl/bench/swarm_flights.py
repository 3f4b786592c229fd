"""Swarms around one UAV that carries the sensor: sensor events as flown, and the truth to judge by.

Vehicle 0 is the ego vehicle. It stands still at first, as odometry needs it, takes off and joins the plan;
the others are in the air from the start.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample, LidarScan
from sitl import dynamics
from sitl.bench.swarm_motion import Plan, uprights, wanted_velocity
from sitl.bench.swarm_truth import NeighbourSights, SightCounter
from sitl.bench.synthetic_flights import CLOCK_OFFSET_NS, SCAN_NS, T_BODY_LIDAR, cut_scan
from sitl.dynamics import QuadrotorSettings, QuadrotorState
from sitl.kinematics import BodyTrajectory, Kinematics
from sitl.sensors.imu import ImuModel, ImuSettings
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.slots import SLOT_PERIOD_NS, PointSlots
from sitl.wind import Wind, WindSettings
from sitl.worlds.bodies import Bodies, poses_midway
from sitl.worlds.distractors import Distractors
from sitl.worlds.primitives import World
from sitl.worlds.uav_body import UavBodySettings, rotor_turns, uav_body

PLAN_START_S = 5.0
_TAKE_OFF_S = 2.5
_ARM_S = 2.2
_CLIMB_MAX = 1.2
_ROTOR_HZ = 95.0
_SLOTS_PER_STEP = dynamics.STEP_NS // SLOT_PERIOD_NS
_STEPS_PER_SCAN = SCAN_NS // dynamics.STEP_NS
_USUAL_BODY = UavBodySettings()
_USUAL_CHIP = ImuSettings()
_USUAL_VEHICLE = QuadrotorSettings()
LIGHT_WIND = WindSettings(gust_mps=0.3, vertical_gust_mps=0.1)
"""What blows unless a scene says otherwise."""

_CHECKED_STEPS = (0, _STEPS_PER_SCAN // 2, _STEPS_PER_SCAN - 1)


@dataclass(frozen=True)
class SwarmScene:
    """A world, and what the swarm does in it.

    Attributes:
        world: what stands there, distractors included.
        distractors: the people who walk there, and what of the world only looks like a UAV.
        plan: where the vehicles want to be; vehicle 0 carries the sensor.
        uavs: their number, the ego vehicle included.
        yaw_rate: mean turn of the ego vehicle about the vertical, rad/s.
        yaw_sway: amplitude of its change, rad/s.
        body: how every vehicle looks.
        wind: on each vehicle.
        imu: the ego vehicle's inertial chip.
        vehicle: how every vehicle answers.
    """

    world: World
    distractors: Distractors
    plan: Plan
    uavs: int
    yaw_rate: float = 0.2
    yaw_sway: float = 0.3
    body: UavBodySettings = _USUAL_BODY
    wind: WindSettings = LIGHT_WIND
    imu: ImuSettings = _USUAL_CHIP
    vehicle: QuadrotorSettings = _USUAL_VEHICLE


@dataclass(frozen=True, slots=True, eq=False)
class SwarmStep:
    """One step of a scene.

    Attributes:
        t_sensor_ns: its end.
        truth: the ego vehicle's motion then.
        p_world: (n, 3) positions of the other vehicles then.
        v_world: (n, 3) their velocities.
        q_world_body: (n, 4) their attitudes.
        events: what the ego vehicle's sensors reported, in order of arrival; none in the first step.
        sights: in a step that ends a scan, how the neighbours stood to the sensor.
    """

    t_sensor_ns: int
    truth: Kinematics
    p_world: FloatArray
    v_world: FloatArray
    q_world_body: FloatArray
    events: tuple[ImuSample | LidarScan, ...]
    sights: NeighbourSights | None = None


def move(scene: SwarmScene, duration_s: float, rng: np.random.Generator) -> Iterator[QuadrotorState]:
    """Simulate the vehicles alone: their state at the start, then after every step.

    Args:
        scene: what happens.
        duration_s: from power-on.
        rng: of the wind.
    """
    wind = Wind(rng, scene.uavs, scene.wind)
    pillars = uprights(scene.world)
    start_world = scene.plan(0.0)
    start_world[0, 2] = 0.0
    state = dynamics.at_rest(start_world, np.linspace(0.4, 5.0, scene.uavs), settings=scene.vehicle)
    yield state
    for index in range(round(duration_s / dynamics.STEP_S)):
        state = dynamics.step(
            state,
            _command(scene, pillars, state, index * dynamics.STEP_S),
            state.v_world,
            wind.step(dynamics.STEP_S),
            settings=scene.vehicle,
        )
        yield state


def stream(
    scene: SwarmScene,
    duration_s: float,
    rng: np.random.Generator,
    lidar: Mid360Settings | None = None,
) -> Iterator[SwarmStep]:
    """Simulate one scene step by step.

    Args:
        scene: what happens.
        duration_s: from power-on.
        rng: of wind and sensor noise.
        lidar: the ego vehicle's scanner.
    """
    wind_rng, rotor_rng, sensor_rng = rng.spawn(3)
    imu_model = ImuModel(sensor_rng, T_BODY_LIDAR, scene.imu)
    lidar_model = Mid360Model(sensor_rng, T_BODY_LIDAR, lidar or Mid360Settings())
    others, people = scene.uavs - 1, scene.distractors.people
    rotor_hz = np.append(_ROTOR_HZ * rotor_rng.uniform(0.95, 1.05, others), np.zeros(len(people)))
    bodies = Bodies(scene.world, [*[uav_body(scene.body)] * others, *people])
    hull = scene.body.hull_size_m
    sights = SightCounter(others, 0.5 * max(hull[:2]), 0.5 * hull[2])
    pieces: list[PointSlots] = []
    for index, (state, after) in enumerate(itertools.pairwise(move(scene, duration_s, wind_rng))):
        if index == 0:
            yield _step_of(0, state, ())
        start_ns, end_ns = index * dynamics.STEP_NS, (index + 1) * dynamics.STEP_NS
        start, end = state.kinematics(0), after.kinematics(0)
        sample = imu_model.sample(start_ns, start, end_ns, end, float(after.thrust[0]))
        world = _placed(scene, bodies, state, after, rotor_hz, index * dynamics.STEP_S)
        seen = lidar_model.observe(
            index * _SLOTS_PER_STEP,
            _SLOTS_PER_STEP,
            BodyTrajectory.between(start_ns, start, end_ns, end),
            world,
        )
        pieces.append(seen.slots)
        T_world_lidar = Pose(end.p_world, end.q_world_body) @ T_BODY_LIDAR
        sights.count(world, seen.aimed, seen.sources)
        if index % _STEPS_PER_SCAN in _CHECKED_STEPS:
            sights.check(T_world_lidar, world, after.p_world[1:])
        events: tuple[ImuSample | LidarScan, ...] = (
            ImuSample(end_ns + CLOCK_OFFSET_NS, end_ns, sample.gyro_imu, sample.accel_imu),
        )
        step = _step_of(end_ns, after, events)
        if end_ns % SCAN_NS == 0:
            sequence = end_ns // SCAN_NS - 1
            step = replace(
                step,
                events=(*events, cut_scan(pieces, sequence, end_ns)),
                sights=sights.close(
                    end_ns, sequence, T_world_lidar.p, step.p_world, step.v_world, step.q_world_body
                ),
            )
            pieces = []
        yield step


def _placed(
    scene: SwarmScene, bodies: Bodies, start: QuadrotorState, end: QuadrotorState,
    rotor_hz: FloatArray, t_s: float,
) -> World:  # fmt: skip
    """Return the world with everybody where they are in the middle of a step that begins at `t_s`."""
    p_others, q_others = poses_midway(
        start.p_world[1:], start.q_world_body[1:], end.p_world[1:], end.q_world_body[1:]
    )
    p_people, q_people = scene.distractors.poses(t_s + 0.5 * dynamics.STEP_S)
    return bodies.at(
        np.vstack([p_others, p_people]), np.vstack([q_others, q_people]), turns=rotor_turns(rotor_hz, t_s)
    )


def _step_of(t_ns: int, state: QuadrotorState, events: tuple[ImuSample | LidarScan, ...]) -> SwarmStep:
    return SwarmStep(
        t_ns, state.kinematics(0), state.p_world[1:], state.v_world[1:], state.q_world_body[1:], events
    )


def _command(
    scene: SwarmScene, pillars: FloatArray, state: QuadrotorState, t: float
) -> dynamics.QuadrotorCommand:
    v = wanted_velocity(scene.plan, t - PLAN_START_S, state, pillars)
    if t < _TAKE_OFF_S:
        v[0] = 0.0
    elif t < PLAN_START_S:
        v[0, 2] = np.clip(v[0, 2], -_CLIMB_MAX, _CLIMB_MAX)
    yaw_rate = np.zeros(scene.uavs)
    if t > PLAN_START_S:
        yaw_rate[0] = scene.yaw_rate + scene.yaw_sway * np.sin(0.8 * t)
        yaw_rate[1:] = 0.4 * np.sin(0.5 * t + np.arange(1, scene.uavs))
    armed = np.ones(scene.uavs, np.bool_)
    armed[0] = t > _ARM_S
    return dynamics.QuadrotorCommand(v, yaw_rate, armed)
