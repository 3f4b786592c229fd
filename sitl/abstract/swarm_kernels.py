"""One swarm: what happens in a control step, and a whole trial.

A step has five parts that others, such as a training environment, may put together in their own way:
`perceive` (what followers are given), `steer` (what they want), `lead` (what the leader wants), `move` and
`settle` (where everybody is then, and whether it is over).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.control.followers.laws_kernels import steer
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


@compiled(f"void(uint64, int64, {WORLD}, {GRID}, {MOTION}, {VIEWS}, {_F1})")
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
    kinds, rows, discs, candidates, counts = world
    limits, azimuth_rays, elevation_rays, column_edges, row_edges = grid
    history = motion[0]
    tracks, ego, neighbours, ranges, _, roles, up = views
    n = history.shape[1]
    if step % int(parameters[place.SCAN_STEPS]) == 0:
        states = history[past(history, step, int(parameters[place.GRID_DELAY]))]
        for i in range(n):
            counts[i] = cull(discs, states[i, 0], states[i, 1], parameters[place.CULL_RANGE], candidates[i])
        for i in range(1, n):
            look_around(
                seed, i, step, history, kinds, rows, discs, candidates[i], counts[i], parameters, tracks[i]
            )
            look_at_obstacles(
                i, step, history, kinds, rows, discs, candidates[i], counts[i], parameters, limits,
                azimuth_rays, elevation_rays, column_edges, row_edges, tracks[i], roles, up, ranges[i],
            )  # fmt: skip
    for i in range(1, n):
        observe(seed, i, step, history, parameters, tracks[i], ego[i], neighbours[i])


@compiled(f"float64(int64, {VIEWS}, {_F1})")
def leader_unseen(step: int, views: Arrays, parameters: FloatArray) -> float:
    """Return for how long no follower has perceived the leader, s, as far as scans have told."""
    tracks = views[0]
    newest = -math.inf
    for i in range(1, tracks.shape[0]):
        newest = max(newest, tracks[i, 0, T_SEEN])
    period = int(parameters[place.SCAN_STEPS])
    latest = (step - step % period - parameters[place.NEIGHBOUR_DELAY]) * parameters[place.CONTROL_STEP]
    return float(latest - newest)


@compiled(f"void(int64, {WORLD}, {MOTION}, {_F1})")
def settle(
    step: int,
    world: Arrays,
    motion: Arrays,
    parameters: FloatArray,
) -> None:
    """Take down where everybody is at a step, how near to obstacles, and who has touched one."""
    kinds, rows, discs, candidates, counts = world
    history, _, _, state, _, _, _, rooms, touching = motion
    now = step % history.shape[0]
    before = max(step - 1, 0) % history.shape[0]
    for i in range(state.shape[0]):
        for axis in range(3):
            history[now, i, axis] = state[i, P + axis]
            history[now, i, 3 + axis] = state[i, V + axis]
        for part in range(4):
            history[now, i, 6 + part] = state[i, Q + part]
        here, there = history[before, i, 0:3], history[now, i, 0:3]
        rooms[i] = room_at(kinds, rows, discs, candidates[i], counts[i], there[0], there[1], there[2])
        touching[i] = touches(
            kinds, rows, discs, candidates[i], counts[i], here, there, parameters[place.VEHICLE_RADIUS],
            rooms[i],
        )  # fmt: skip


@compiled(
    f"Tuple((int64, int64))(uint64, int64, int64, {WORLD}, {GRID}, {MOTION}, {VIEWS}, {ROUTE}, {_F1}, {_F1},"
    f" {_F1}, {_F1}, {_L1}, {_F3}, {_F3}, uint8[:,:,::1], {_F2})"
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
    trace: FloatArray,
    trace_commands: FloatArray,
    trace_known: NDArray[np.uint8],
    trace_rooms: FloatArray,
) -> tuple[int, int]:
    """Fly one trial from the state in `motion` until it ends.

    Args:
        seed: everything random in it comes from here.
        method: number of the followers' law.
        most_steps: the trial ends then in any case.
        world: see `WORLD`.
        grid: see `GRID`.
        motion: see `MOTION`.
        views: see `VIEWS`.
        route: see `ROUTE`.
        parameters: see `sitl.abstract.layout_kernels`.
        quadrotor: parameters of `dynamics_kernels.advance`.
        law: parameters of the law.
        sums: (7,) out, see `judging_kernels`.
        concerned: (2,) out, who ended it.
        trace: (T, n, 10) out, states sample by sample; T is 0 where nobody wants them.
        trace_commands: (T, n, 3) out, velocities asked for, world.
        trace_known: (T, n, n) out, who perceives whom.
        trace_rooms: (T, n) out, distances to the nearest surface.

    Returns:
        How it ended, and the last step.
    """
    candidates, counts = world[3], world[4]
    history, commands, gusts, state, loop, setpoint, wind, rooms, touching = motion
    tracks, ego, neighbours, ranges, memory, _, _ = views
    (
        waypoints, holds, legs, ends, clearances, distance, blocked, surface, first, rules, leader, sectors,
        granted,
    ) = route  # fmt: skip
    n = state.shape[0]
    dt = parameters[place.CONTROL_STEP]
    goal = waypoints[waypoints.shape[0] - 1]
    wanted = np.zeros(3)
    for i in range(n):
        counts[i] = cull(world[2], state[i, P], state[i, P + 1], parameters[place.CULL_RANGE], candidates[i])
    settle(0, world, motion, parameters)
    for step in range(most_steps + 1):
        now, before = step % history.shape[0], max(step - 1, 0) % history.shape[0]
        add_sample(history[now], rooms, parameters[place.CAP], sums)
        perceive(seed, step, world, grid, motion, views, parameters)
        row = step % commands.shape[0]
        lead(
            step * dt, dt, history[now, 0], waypoints, holds, legs, ends, clearances, distance, blocked,
            surface, first, rules, leader, sectors, granted, commands[row, 0],
        )  # fmt: skip
        for i in range(1, n):
            steer(method, ego[i], neighbours[i], ranges[i], memory[i], law, wanted)
            cosine, sine = math.cos(ego[i, 6]), math.sin(ego[i, 6])
            commands[row, i, 0] = cosine * wanted[0] - sine * wanted[1]
            commands[row, i, 1] = sine * wanted[0] + cosine * wanted[1]
            commands[row, i, 2] = wanted[2]
        if step < trace.shape[0]:
            for i in range(n):
                for column in range(10):
                    trace[step, i, column] = history[now, i, column]
                for axis in range(3):
                    trace_commands[step, i, axis] = commands[row, i, axis]
                for j in range(n):
                    trace_known[step, i, j] = tracks[i, j, IS_KNOWN] > 0.0
                trace_rooms[step, i] = rooms[i]
        end = judge(
            step * dt, history[before], history[now], touching, leader_unseen(step, views, parameters), goal,
            leader, parameters, concerned,
        )  # fmt: skip
        if end != FLYING or step == most_steps:
            return end, step
        move(seed, step, commands, parameters, quadrotor, gusts, state, loop, setpoint, wind)
        settle(step + 1, world, motion, parameters)
    return FLYING, most_steps
