"""One swarm: what happens in a control step, and a whole trial.

A step has two halves, so that something slower than a kernel can change what followers want in between:
`begin_step` (what followers are given, what the leader does and what their law wants) and `finish_step`
(whether it is over, and where everybody is then). `fly` does both, again and again.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.compiled import portable, portable_inlined
from companion.control.followers.laws_kernels import steer
from companion.control.followers.layout_kernels import PREVIOUS
from companion.messages import FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.grid_kernels import cull
from sitl.abstract.judging_kernels import FLYING, add_sample, judge
from sitl.abstract.leader_kernels import lead
from sitl.abstract.motion_kernels import move, room_at, touches
from sitl.abstract.perception_kernels import IS_KNOWN, T_SEEN, look_around, look_at_obstacles, observe, past
from sitl.dynamics_kernels import P, Q, V

Arrays = tuple[Any, ...]
"""A group of arrays of different kinds, told by one of the types below."""

_F1, _F2, _F3 = "float64[::1]", "float64[:,::1]", "float64[:,:,::1]"
_I1, _I2, _L1, _B1 = "int32[::1]", "int32[:,::1]", "int64[::1]", "uint8[::1]"

WORLD = f"Tuple(({_I1}, {_F2}, {_F2}, {_I2}, {_L1}))"
"""kinds (m,), rows (m, 8), discs (m, 3) of the obstacles; candidates (n, m), how many of them (n,)."""
GRID = f"Tuple(({_F1}, {_F2}, {_F2}, {_F2}, {_F2}))"
"""limits, rays by azimuth and by elevation, edges of columns and of rows: see `draw_grid`."""
MOTION = f"Tuple(({_F3}, {_F3}, {_F2}, {_F2}, {_F2}, {_F2}, {_F2}, {_F1}, {_B1}))"
"""history (h, n, 10), commands (h, n, 3), gusts (n, 3), motion (n, 19), loop (n, 6), setpoint (n, 5), wind
(n, 3), room (n,), touching (n,)."""
VIEWS = f"Tuple(({_F3}, {_F2}, {_F3}, {_F3}, {_F2}, {_B1}, {_F1}))"
"""tracks (n, n, 22), ego (n, 10), neighbours (n, k, 8), ranges (n, 72, 12), memory (n, ...), roles (n,),
up (3,)."""
ROUTE = (
    f"Tuple(({_F2}, {_F1}, {_F3}, {_F3}, {_F1}, float32[:,::1], uint8[:,::1], float32[:,:,::1], {_L1}, {_F1},"
    f" {_F1}, {_F2}, {_F2}))"
)
"""waypoints, holds, legs, ends, clearances, distance, blocked, surface, first, rules, memory, sectors,
granted: see `lead`."""

TRACE = f"Tuple(({_F3}, {_F3}, uint8[:,:,::1], {_F2}))"
"""What is kept sample by sample, T is 0 where nobody wants it: states (T, n, 10), velocities asked for, world
(T, n, 3), who perceives whom (T, n, n), distances to the nearest surface (T, n)."""


@portable_inlined
def look_about(i: int, step: int, world: Arrays, motion: Arrays, parameters: FloatArray) -> None:
    """Find the obstacles near vehicle i, if a scan arrives at this step."""
    if step % int(parameters[place.SCAN_STEPS]) == 0:
        _, _, discs, candidates, counts = world
        history = motion[0]
        then = past(history, step, int(parameters[place.GRID_DELAY]))
        counts[i] = cull(
            discs, history[then, i, 0], history[then, i, 1], parameters[place.CULL_RANGE], candidates[i]
        )


@portable_inlined
def perceive_one(
    seed: np.uint64,
    step: int,
    i: int,
    world: Arrays,
    grid: Arrays,
    motion: Arrays,
    views: Arrays,
    parameters: FloatArray,
    roles: NDArray[np.uint8],
    up: FloatArray,
) -> None:
    """Give follower i what it perceives at a step; nothing of the others changes.

    `roles` (n,) and `up` (3,) are scratch, the rest is as for `perceive`.
    """
    kinds, rows, discs, candidates, counts = world
    limits, azimuth_rays, elevation_rays, column_edges, row_edges = grid
    history = motion[0]
    tracks, ego, neighbours, ranges, _, _, _ = views
    look_about(i, step, world, motion, parameters)
    if step % int(parameters[place.SCAN_STEPS]) == 0:
        look_around(
            seed, i, step, history, kinds, rows, discs, candidates[i], counts[i], parameters, tracks[i]
        )
        look_at_obstacles(
            i, step, history, kinds, rows, discs, candidates[i], counts[i], parameters, limits,
            azimuth_rays, elevation_rays, column_edges, row_edges, tracks[i], roles, up, ranges[i],
        )  # fmt: skip
    observe(seed, i, step, history, parameters, tracks[i], ego[i], neighbours[i])


@portable(f"void(uint64, int64, {WORLD}, {GRID}, {MOTION}, {VIEWS}, {_F1})")
def perceive(
    seed: np.uint64,
    step: int,
    world: Arrays,
    grid: Arrays,
    motion: Arrays,
    views: Arrays,
    parameters: FloatArray,
) -> None:
    """Give every follower what it perceives at a step; see the types' descriptions for the arguments."""
    roles, up = views[5], views[6]
    look_about(0, step, world, motion, parameters)
    for i in range(1, roles.shape[0]):
        perceive_one(seed, step, i, world, grid, motion, views, parameters, roles, up)


@portable(f"float64(int64, {VIEWS}, {_F1})")
def leader_unseen(step: int, views: Arrays, parameters: FloatArray) -> float:
    """Return for how long no follower has perceived the leader, s, as far as scans have told."""
    tracks = views[0]
    newest = -math.inf
    for i in range(1, tracks.shape[0]):
        newest = max(newest, tracks[i, 0, T_SEEN])
    period = int(parameters[place.SCAN_STEPS])
    latest = (step - step % period - parameters[place.NEIGHBOUR_DELAY]) * parameters[place.CONTROL_STEP]
    return float(latest - newest)


@portable_inlined
def settle_one(step: int, i: int, world: Arrays, motion: Arrays, parameters: FloatArray) -> None:
    """Take down where vehicle i is at a step, how near to obstacles, and whether it has touched one."""
    kinds, rows, discs, candidates, counts = world
    history, _, _, state, _, _, _, rooms, touching = motion
    now = step % history.shape[0]
    before = max(step - 1, 0) % history.shape[0]
    for axis in range(3):
        history[now, i, axis] = state[i, P + axis]
        history[now, i, 3 + axis] = state[i, V + axis]
    for part in range(4):
        history[now, i, 6 + part] = state[i, Q + part]
    here, there = history[before, i, 0:3], history[now, i, 0:3]
    rooms[i] = room_at(kinds, rows, discs, candidates[i], counts[i], there[0], there[1], there[2])
    touching[i] = touches(
        kinds, rows, discs, candidates[i], counts[i], here, there, parameters[place.VEHICLE_RADIUS], rooms[i]
    )


@portable(f"void(int64, {WORLD}, {MOTION}, {_F1})")
def settle(
    step: int,
    world: Arrays,
    motion: Arrays,
    parameters: FloatArray,
) -> None:
    """Take down where everybody is at a step, how near to obstacles, and who has touched one."""
    for i in range(motion[3].shape[0]):
        settle_one(step, i, world, motion, parameters)


@portable(f"void({WORLD}, {MOTION}, {_F1})")
def set_off(world: Arrays, motion: Arrays, parameters: FloatArray) -> None:
    """Make a trial ready for its first step, from the state in `motion`."""
    discs, candidates, counts = world[2], world[3], world[4]
    state = motion[3]
    for i in range(state.shape[0]):
        counts[i] = cull(discs, state[i, P], state[i, P + 1], parameters[place.CULL_RANGE], candidates[i])
    settle(0, world, motion, parameters)


@portable(
    f"void(uint64, int64, int64, {WORLD}, {GRID}, {MOTION}, {VIEWS}, {ROUTE}, {_F1}, {_F1}, {_F1}, {_F2},"
    f" {_F2})"
)
def begin_step(
    seed: np.uint64,
    step: int,
    method: int,
    world: Arrays,
    grid: Arrays,
    motion: Arrays,
    views: Arrays,
    route: Arrays,
    parameters: FloatArray,
    law: FloatArray,
    sums: FloatArray,
    flown: FloatArray,
    wanted: FloatArray,
) -> None:
    """Take a sample, give everybody what it perceives, and ask the leader and the followers' law.

    Args:
        seed: everything random in the trial comes from here.
        step: number of the control step.
        method: number of the followers' law.
        world: see `WORLD`.
        grid: see `GRID`.
        motion: see `MOTION`.
        views: see `VIEWS`.
        route: see `ROUTE`.
        parameters: see `sitl.abstract.layout_kernels`.
        law: parameters of the law.
        sums: (7,) see `judging_kernels`; changed in place.
        flown: (n, 3) out, the velocities that followers' memories held before this step, map.
        wanted: (n, 3) out, what the followers' law wants, heading frame, m/s; the leader's row is zero.
    """
    history, commands, rooms = motion[0], motion[1], motion[7]
    _, ego, neighbours, ranges, memory, _, _ = views
    (
        waypoints, holds, legs, ends, clearances, distance, blocked, surface, first, rules, leader, sectors,
        granted,
    ) = route  # fmt: skip
    dt = parameters[place.CONTROL_STEP]
    now = step % history.shape[0]
    add_sample(history[now], rooms, parameters[place.CAP], sums)
    perceive(seed, step, world, grid, motion, views, parameters)
    lead(
        step * dt, dt, history[now, 0], waypoints, holds, legs, ends, clearances, distance, blocked,
        surface, first, rules, leader, sectors, granted, commands[step % commands.shape[0], 0],
    )  # fmt: skip
    for axis in range(3):
        flown[0, axis] = 0.0
        wanted[0, axis] = 0.0
    for i in range(1, ego.shape[0]):
        for axis in range(3):
            flown[i, axis] = memory[i, PREVIOUS + axis]
        steer(method, ego[i], neighbours[i], ranges[i], memory[i], law, wanted[i])


@portable(
    f"int64(uint64, int64, int64, {WORLD}, {MOTION}, {VIEWS}, {ROUTE}, {_F1}, {_F1}, {_F2}, {_L1}, {TRACE})"
)
def finish_step(
    seed: np.uint64,
    step: int,
    most_steps: int,
    world: Arrays,
    motion: Arrays,
    views: Arrays,
    route: Arrays,
    parameters: FloatArray,
    quadrotor: FloatArray,
    wanted: FloatArray,
    concerned: NDArray[np.int64],
    trace: Arrays,
) -> int:
    """Judge, and unless it is over fly on to the next step with what followers want.

    Args:
        seed: everything random in the trial comes from here.
        step: number of the control step.
        most_steps: after this step nobody moves any more.
        world: see `WORLD`.
        motion: see `MOTION`.
        views: see `VIEWS`.
        route: see `ROUTE`.
        parameters: see `sitl.abstract.layout_kernels`.
        quadrotor: parameters of `dynamics_kernels.advance`.
        wanted: (n, 3) velocities that followers want, heading frame, m/s.
        concerned: (2,) out, who ended it.
        trace: see `TRACE`.

    Returns:
        How it ended; `FLYING` if it has not.
    """
    history, commands, gusts, state, loop, setpoint, wind, rooms, touching = motion
    tracks, ego = views[0], views[1]
    waypoints, leader = route[0], route[10]
    states, asked, known, room = trace
    n = state.shape[0]
    now, before = step % history.shape[0], max(step - 1, 0) % history.shape[0]
    row = step % commands.shape[0]
    for i in range(1, n):
        cosine, sine = math.cos(ego[i, 6]), math.sin(ego[i, 6])
        commands[row, i, 0] = cosine * wanted[i, 0] - sine * wanted[i, 1]
        commands[row, i, 1] = sine * wanted[i, 0] + cosine * wanted[i, 1]
        commands[row, i, 2] = wanted[i, 2]
    if step < states.shape[0]:
        for i in range(n):
            for column in range(10):
                states[step, i, column] = history[now, i, column]
            for axis in range(3):
                asked[step, i, axis] = commands[row, i, axis]
            for j in range(n):
                known[step, i, j] = tracks[i, j, IS_KNOWN] > 0.0
            room[step, i] = rooms[i]
    end = judge(
        step * parameters[place.CONTROL_STEP], history[before], history[now], touching,
        leader_unseen(step, views, parameters), waypoints[waypoints.shape[0] - 1], leader, parameters,
        concerned,
    )  # fmt: skip
    if end == FLYING and step < most_steps:
        move(seed, step, commands, parameters, quadrotor, gusts, state, loop, setpoint, wind)
        settle(step + 1, world, motion, parameters)
    return int(end)


@portable(
    f"Tuple((int64, int64))(uint64, int64, int64, {WORLD}, {GRID}, {MOTION}, {VIEWS}, {ROUTE}, {_F1}, {_F1},"
    f" {_F1}, {_F1}, {_L1}, {_F2}, {_F2}, {TRACE})"
)
def fly(
    seed: np.uint64,
    method: int,
    most_steps: int,
    world: Arrays,
    grid: Arrays,
    motion: Arrays,
    views: Arrays,
    route: Arrays,
    parameters: FloatArray,
    quadrotor: FloatArray,
    law: FloatArray,
    sums: FloatArray,
    concerned: NDArray[np.int64],
    flown: FloatArray,
    wanted: FloatArray,
    trace: Arrays,
) -> tuple[int, int]:
    """Fly one trial from the state in `motion` until it ends; for the arguments see the two halves of a step.

    Returns:
        How it ended, and the last step.
    """
    set_off(world, motion, parameters)
    for step in range(most_steps + 1):
        begin_step(
            seed, step, method, world, grid, motion, views, route, parameters, law, sums, flown, wanted
        )  # fmt: skip
        end = finish_step(
            seed, step, most_steps, world, motion, views, route, parameters, quadrotor, wanted, concerned,
            trace,
        )  # fmt: skip
        if end != FLYING or step == most_steps:
            return end, step
    return FLYING, most_steps
