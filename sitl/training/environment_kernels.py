"""One control step of many swarms of one size: the same functions that fly trials, over batched arrays.

Every array of a batch begins with an axis over swarms; what ends in `_one` is the work of one thread of a
graphics card, see `cuda_kernels`. Streams, the rows of what is shown and rewarded, number all followers.
"""

import math
from typing import Any

import numpy as np

from companion.compiled import portable, portable_inlined
from companion.control.followers.laws_kernels import overrule, steer_flock
from companion.control.followers.layout_kernels import PREVIOUS
from companion.control.observation_kernels import describe_all_but_grid, describe_grid, keeping_of
from companion.messages import Float32Array, FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.grid_kernels import cull
from sitl.abstract.judging_kernels import (
    ALTITUDE,
    FLYING,
    LEADER_FOLLOWER,
    LEADER_LOST,
    OBSTACLE_HIT,
    SCATTERED,
    TIMEOUT,
    UAV_UAV,
    add_sample,
    judge,
)
from sitl.abstract.leader_kernels import FINISHED, PHASE
from sitl.abstract.motion_kernels import move_one
from sitl.abstract.perception_kernels import IS_KNOWN
from sitl.abstract.sight_kernels import up_of, yaw_of
from sitl.abstract.swarm_kernels import leader_unseen, look_about, perceive_one, settle_one
from sitl.dynamics_kernels import P, Q, V
from sitl.training import batch_layout_kernels as at
from sitl.training import reward_layout_kernels as term
from sitl.training.privileged_kernels import disclose
from sitl.training.reward_kernels import reward_terms
from sitl.training.snapshot_kernels import keep_snapshot

Arrays = tuple[Any, ...]

_LARGEST_DIFFERENCE = 16.0


@portable_inlined
def world_of(s: int, bank: Arrays, swarm: Arrays) -> Arrays:
    """Return one swarm's part of these arrays, a type of `swarm_kernels`."""
    kinds, rows, discs, _ = bank
    _, places, _, _, _, _, candidates, counts = swarm
    low, high = places[s, at.FIRST_PRIMITIVE], places[s, at.END_PRIMITIVE]
    return kinds[low:high], rows[low:high], discs[low:high], candidates[s], counts[s]


@portable_inlined
def motion_of(s: int, motion: Arrays) -> Arrays:
    """Likewise."""
    history, commands, gusts, state, loop, setpoint, wind, rooms, touching = motion
    return (
        history[s], commands[s], gusts[s], state[s], loop[s], setpoint[s], wind[s], rooms[s], touching[s],
    )  # fmt: skip


@portable_inlined
def views_of(s: int, views: Arrays) -> Arrays:
    """Likewise."""
    tracks, ego, neighbours, ranges, memory, roles, up = views
    return tracks[s], ego[s], neighbours[s], ranges[s], memory[s], roles[s], up[s]


@portable_inlined
def grid_of(s: int, rays: Arrays, swarm: Arrays) -> Arrays:
    """Likewise."""
    azimuth_rays, elevation_rays, column_edges, row_edges, _ = rays
    return swarm[4][s], azimuth_rays, elevation_rays, column_edges, row_edges


@portable_inlined
def see_one(
    s: int, i: int, contract: int, showing: int, world: Arrays, grid: Arrays, moving: Arrays, own: Arrays,
    law: FloatArray, swarm: Arrays, motion: Arrays, views: Arrays, acts: Arrays, shown: Arrays,
    snapshots: Arrays, roles: np.ndarray[tuple[int], np.dtype[np.uint8]], up: FloatArray,
) -> None:  # fmt: skip
    """Give follower i what it perceives, ask its law, and write as much of its observation as is wanted.

    `world`, `grid`, `moving` and `own` are the swarm's, `roles` (n,) and `up` (3,) scratch; nothing of the
    other vehicles changes.
    """
    seeds, places, parameters = swarm[0], swarm[1], swarm[2]
    flown, wanted = acts[0], acts[1]
    ego_out, neighbours_out, grid_out, memory_out, privileged, reference = shown
    step = places[s, at.STEP]
    if step % at.SNAPSHOT_STEPS == 0:
        keep_snapshot(s, i, step, motion, views, snapshots)
    if i == 0:
        look_about(0, step, world, moving, parameters[s])
        return
    perceive_one(seeds[s], step, i, world, grid, moving, own, parameters[s], roles, up)
    ego, neighbours, ranges, memory = own[1], own[2], own[3], own[4]
    is_new_grid = step % int(parameters[s, place.SCAN_STEPS]) == 0
    k = places[s, at.FIRST_STREAM] + i - 1
    for axis in range(3):
        flown[s, i, axis] = memory[i, PREVIOUS + axis]
    steer_flock(ego[i], neighbours[i], ranges[i], memory[i], law, wanted[s, i], is_new_grid)
    for axis in range(3):
        reference[k, axis] = wanted[s, i, axis]
    if showing == at.SHOW_NOTHING:
        return
    states = motion[0][s, step % motion[0].shape[1]]
    rooms = motion[7][s]
    left = (places[s, at.LAST_STEP] - step) * parameters[s, place.CONTROL_STEP]
    # The attitude is known at once, as the heading is.
    yaw = yaw_of(states[i, 6:10])
    ux, uy, uz = up_of(states[i, 6:10])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    up[0], up[1], up[2] = cosine * ux + sine * uy, cosine * uy - sine * ux, uz
    cosine, sine = math.cos(ego[i, 6]), math.sin(ego[i, 6])
    previous = acts[2][s, i]
    previous[0] = cosine * flown[s, i, 0] + sine * flown[s, i, 1]
    previous[1] = cosine * flown[s, i, 1] - sine * flown[s, i, 0]
    previous[2] = flown[s, i, 2]
    if is_new_grid or showing == at.SHOW_ALL:
        describe_grid(ranges[i], grid_out[k])
    describe_all_but_grid(
        contract, ego[i], up, neighbours[i], memory[i], law, wanted[s, i], previous, ego_out[k],
        neighbours_out[k], memory_out[k],
    )  # fmt: skip
    disclose(
        i, states, rooms[i], parameters[s, place.GROUND], left, world[0], world[1], world[2],
        world[3][i], world[4][i], privileged[k],
    )  # fmt: skip


@portable_inlined
def begin_one(s: int, i: int, world: Arrays, moving: Arrays, swarm: Arrays) -> None:
    """Make vehicle i, whose state has just been set, ready for its first step."""
    places, parameters, candidates, counts = swarm[1], swarm[2], swarm[6], swarm[7]
    x, y = moving[3][i, P], moving[3][i, P + 1]
    counts[s, i] = cull(world[2], x, y, parameters[s, place.CULL_RANGE], candidates[s, i])
    settle_one(places[s, at.STEP], i, world, moving, parameters[s])


@portable_inlined
def take_sample(s: int, swarm: Arrays, motion: Arrays, acts: Arrays) -> None:
    """Add where a swarm is now to the sums of its metrics."""
    now = swarm[1][s, at.STEP] % motion[0].shape[1]
    add_sample(motion[0][s, now], motion[7][s], swarm[2][s, place.CAP], acts[3][s])


@portable(
    f"void(int64[::1], int64, {at.BANK}, {at.RAYS}, float64[::1], {at.SWARM}, {at.MOTION}, {at.VIEWS},"
    f" {at.ACTS}, {at.SHOWN}, {at.SNAPSHOTS})"
)
def begin_swarms(
    which: np.ndarray[tuple[int], np.dtype[np.int64]],
    contract: int,
    bank: Arrays,
    rays: Arrays,
    law: FloatArray,
    swarm: Arrays,
    motion: Arrays,
    views: Arrays,
    acts: Arrays,
    shown: Arrays,
    snapshots: Arrays,
) -> None:
    """Show the first observation of swarms whose state has just been set; see `batch_layout_kernels`.

    Args:
        which: numbers of these swarms.
        contract: number of the observations' contract.
        bank: obstacles and leaders' flights of all scenes.
        rays: tables of the grid.
        law: parameters of `flock`.
        swarm: what holds for each swarm.
        motion: how its vehicles move.
        views: what they perceive.
        acts: what they do and earn.
        shown: what policies and critics see.
        snapshots: of the recent past.
    """
    n = motion[3].shape[1]
    for index in range(which.shape[0]):
        s = which[index]
        world, moving = world_of(s, bank, swarm), motion_of(s, motion)
        own, grid = views_of(s, views), grid_of(s, rays, swarm)
        for i in range(n):
            begin_one(s, i, world, moving, swarm)
        take_sample(s, swarm, motion, acts)
        for i in range(n):
            see_one(
                s, i, contract, at.SHOW_ALL, world, grid, moving, own, law, swarm, motion, views, acts, shown,
                snapshots, own[5], own[6],
            )  # fmt: skip


@portable_inlined
def fly_one(
    s: int, i: int, contract: int, velocity: Float32Array, flights: FloatArray, world: Arrays, moving: Arrays,
    own: Arrays, law: FloatArray, swarm: Arrays, acts: Arrays,
) -> None:  # fmt: skip
    """Give vehicle i its command and move it on by one control step; the leader flies as it is known to."""
    seeds, places, parameters, quadrotor, _, _, _, _ = swarm
    _, commands, gusts, state, loop, setpoint, wind, _, _ = moving
    step = places[s, at.STEP]
    row = step % commands.shape[0]
    at_last = min(places[s, at.FIRST_FLIGHT] + step + 1, places[s, at.END_FLIGHT] - 1)
    if i == 0:
        for axis in range(3):
            commands[row, 0, axis] = flights[at_last, 3 + axis]
    else:
        _command(s, i, row, contract, velocity, commands, own, law, swarm, acts)
    move_one(
        seeds[s], step, i, commands, parameters[s], quadrotor[s], gusts, state, loop, setpoint, wind
    )  # fmt: skip
    if i == 0:
        for axis in range(3):
            state[0, P + axis] = flights[at_last, axis]
            state[0, V + axis] = flights[at_last, 3 + axis]
        for part in range(4):
            state[0, Q + part] = flights[at_last, 6 + part]
    settle_one(step + 1, i, world, moving, parameters[s])


@portable_inlined
def _command(
    s: int, i: int, row: int, contract: int, velocity: Float32Array, commands: FloatArray, own: Arrays,
    law: FloatArray, swarm: Arrays, acts: Arrays,
) -> None:  # fmt: skip
    """Limit what a follower is asked for, and pay for how it differs from the law's wish and from before."""
    ego, memory = own[1][i], own[4][i]
    flown, wanted, asked, earned = acts[0][s, i], acts[1][s, i], acts[2][s, i], acts[6][s, i]
    k = swarm[1][s, at.FIRST_STREAM] + i - 1
    off = 0.0
    for axis in range(3):
        asked[axis] = velocity[k, axis]
        off += (asked[axis] - wanted[axis]) ** 2
    if math.isfinite(off):
        # Otherwise the law's own command is flown, as a companion does.
        overrule(keeping_of(contract), ego, flown, memory, law, asked)
    changed = 0.0
    for axis in range(3):
        changed += (memory[PREVIOUS + axis] - flown[axis]) ** 2
        commands[row, i, axis] = memory[PREVIOUS + axis]
    earned[term.SMOOTHNESS] = -changed
    earned[term.RESIDUAL] = -off if off < _LARGEST_DIFFERENCE else -_LARGEST_DIFFERENCE


@portable_inlined
def end_of(s: int, swarm: Arrays, motion: Arrays, views: Arrays, acts: Arrays) -> int:
    """Return how a swarm's trial ends now, `FLYING` if it goes on."""
    _, places, parameters, _, _, goals, _, _ = swarm
    history, touching, concerned, leader = motion[0][s], motion[8][s], acts[4][s], acts[5][s]
    step = places[s, at.STEP]
    dt = parameters[s, place.CONTROL_STEP]
    now, before = step % history.shape[0], max(step - 1, 0) % history.shape[0]
    known = places[s, at.END_FLIGHT] - places[s, at.FIRST_FLIGHT] - 1
    leader[PHASE] = float(FINISHED) if step >= known else -1.0
    unseen = leader_unseen(step, views_of(s, views), parameters[s])
    end = judge(
        step * dt, history[before], history[now], touching, unseen, goals[s], leader, parameters[s],
        concerned,
    )  # fmt: skip
    if end != FLYING:
        return int(end)
    states, farthest = history[now], parameters[s, at.STRAYED]
    for i in range(1, states.shape[0]):
        square = 0.0
        for axis in range(3):
            square += (states[i, axis] - states[0, axis]) ** 2
        if not square <= farthest * farthest:
            concerned[0] = i
            return SCATTERED
    if step >= places[s, at.LAST_STEP]:
        concerned[0] = 0
        return TIMEOUT
    return FLYING


@portable_inlined
def pay_one(
    s: int, i: int, rays: Arrays, numbers: FloatArray, weights: FloatArray, swarm: Arrays, motion: Arrays,
    views: Arrays, acts: Arrays, paid: Arrays,
) -> None:  # fmt: skip
    """Write what follower i has earned in this step, and whether its life is over."""
    places, parameters = swarm[1], swarm[2]
    tracks, ranges = views[0][s], views[3][s]
    concerned, earned, sums, totals = acts[4][s], acts[6][s], acts[7][s], acts[8][s]
    terms_out, reward, terminated, truncated = paid
    end = places[s, at.END]
    states, rooms = motion[0][s, places[s, at.STEP] % motion[0].shape[1]], motion[7][s]
    perceived = 0
    for j in range(states.shape[0]):
        if j != i and tracks[i, j, IS_KNOWN] > 0.0:
            perceived += 1
    reward_terms(
        i, states, rooms[i], parameters[s, place.GROUND], perceived, ranges[i], rays[4], numbers, earned[i]
    )  # fmt: skip
    is_concerned = concerned[0] == i or concerned[1] == i
    crashed = is_concerned and end in (UAV_UAV, LEADER_FOLLOWER, OBSTACLE_HIT)
    lost = end == LEADER_LOST or (is_concerned and end == ALTITUDE)
    if end == SCATTERED:
        square = 0.0
        for axis in range(3):
            square += (states[i, axis] - states[0, axis]) ** 2
        farthest = parameters[s, place.GATHERED if acts[5][s, PHASE] == FINISHED else at.STRAYED]
        lost = is_concerned or not square <= farthest * farthest
    earned[i, term.COLLISION] = -1.0 if crashed else 0.0
    earned[i, term.LOSS] = -1.0 if lost else 0.0
    k = places[s, at.FIRST_STREAM] + i - 1
    total = 0.0
    for index in range(earned.shape[1]):
        terms_out[k, index] = earned[i, index]
        sums[i, index] += earned[i, index]
        total += weights[index] * earned[i, index]
    totals[i] += total
    reward[k] = total
    terminated[k] = crashed or lost
    truncated[k] = end != FLYING and not (crashed or lost)


@portable(
    f"void(int64, int64, int64, int64, float32[:,::1], {at.BANK}, {at.RAYS}, float64[::1], float64[::1],"
    f" float64[::1], {at.SWARM}, {at.MOTION}, {at.VIEWS}, {at.ACTS}, {at.SHOWN}, {at.PAID}, {at.SNAPSHOTS})"
)
def step_swarms(
    first: int,
    last: int,
    contract: int,
    showing: int,
    velocity: Float32Array,
    bank: Arrays,
    rays: Arrays,
    law: FloatArray,
    numbers: FloatArray,
    weights: FloatArray,
    swarm: Arrays,
    motion: Arrays,
    views: Arrays,
    acts: Arrays,
    shown: Arrays,
    paid: Arrays,
    snapshots: Arrays,
) -> None:
    """Fly some swarms of a batch on by one control step; for the arrays see `batch_layout_kernels`.

    A swarm whose trial is over keeps the number of its end in its places and must be begun anew.

    Args:
        first: number of the first swarm.
        last: one more than that of the last.
        contract: number of the observations' contract.
        showing: what of the new observations is written, see `batch_layout_kernels`.
        velocity: (K, 3) what each stream wants to fly, heading frame, m/s.
        bank: obstacles and leaders' flights of all scenes.
        rays: tables of the grid.
        law: parameters of `flock`.
        numbers: of the reward, see `reward_layout_kernels`.
        weights: (R,) of its terms.
        swarm: what holds for each swarm.
        motion: how its vehicles move.
        views: what they perceive.
        acts: what they do and earn.
        shown: out, what policies and critics see.
        paid: out, rewards and ends.
        snapshots: of the recent past.
    """
    n = motion[3].shape[1]
    for s in range(first, last):
        world, moving = world_of(s, bank, swarm), motion_of(s, motion)
        own, grid = views_of(s, views), grid_of(s, rays, swarm)
        for i in range(n):
            fly_one(s, i, contract, velocity, bank[3], world, moving, own, law, swarm, acts)
        swarm[1][s, at.STEP] += 1
        take_sample(s, swarm, motion, acts)
        for i in range(n):
            see_one(
                s, i, contract, showing, world, grid, moving, own, law, swarm, motion, views, acts, shown,
                snapshots, own[5], own[6],
            )  # fmt: skip
        swarm[1][s, at.END] = end_of(s, swarm, motion, views, acts)
        for i in range(1, n):
            pay_one(s, i, rays, numbers, weights, swarm, motion, views, acts, paid)
