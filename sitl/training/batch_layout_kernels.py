"""The arrays of a batch of swarms of one size: groups of them, their types, and what stands where.

S swarms, n vehicles in each with the leader as number 0, K streams in all batches together.
"""

from sitl.abstract import layout_kernels as abstract

# Places in the whole numbers of a swarm: its rows in the bank, the step it has come to, the one at which its
# trial is cut off, the stream of its first follower, and how its trial has ended.
FIRST_PRIMITIVE, END_PRIMITIVE, FIRST_FLIGHT, END_FLIGHT, STEP, LAST_STEP, FIRST_STREAM, END = range(8)
N_PLACES = 8

STRAYED = abstract.N_PARAMETERS
"""After the parameters of the abstract swarm: how far from its leader a follower has strayed, m."""
N_PARAMETERS = abstract.N_PARAMETERS + 1

SNAPSHOT_STEPS = 20
"""A snapshot is kept every so many steps; a whole number of scan periods."""

SHOW_NOTHING, SHOW_CHANGES, SHOW_ALL = range(3)
"""What of an observation is written at a step: only flock's command; what may have changed since the step
before, that is all but the grid, and the grid if a scan has come; or all of it."""

_F1, _F2, _F3, _F4 = "float64[::1]", "float64[:,::1]", "float64[:,:,::1]", "float64[:,:,:,::1]"
_F5 = "float64[:,:,:,:,::1]"
_G1, _G2, _G3, _G4 = "float32[::1]", "float32[:,::1]", "float32[:,:,::1]", "float32[:,:,:,::1]"
_I1, _I3, _L1, _L2, _B1, _B2 = (
    "int32[::1]", "int32[:,:,::1]", "int64[::1]", "int64[:,::1]", "uint8[::1]", "uint8[:,::1]",
)  # fmt: skip

BANK = f"Tuple(({_I1}, {_F2}, {_F2}, {_F2}))"
"""kinds (M,), rows (M, 8), discs (M, 3) of all obstacles; leaders' flights (T, 10)."""
RAYS = f"Tuple(({_F2}, {_F2}, {_F2}, {_F2}, {_F3}))"
"""rays by azimuth and by elevation, edges of columns and of rows: see `grid_kernels.draw_grid`; direction of
each cell (72, 12, 3)."""
SWARM = f"Tuple((uint64[::1], {_L2}, {_F2}, {_F2}, {_F2}, {_F2}, {_I3}, {_L2}))"
"""seeds (S,), places (S, 8), parameters (S, 47), quadrotor (S, 22), limits of the grid (S, 7), goals (S, 3),
candidates (S, n, m), how many (S, n)."""
MOTION = f"Tuple(({_F4}, {_F4}, {_F3}, {_F3}, {_F3}, {_F3}, {_F3}, {_F2}, {_B2}))"
"""history (S, h, n, 10), commands (S, h, n, 3), gusts (S, n, 3), motion (S, n, 19), loop (S, n, 6), setpoint
(S, n, 5), wind (S, n, 3), room (S, n), touching (S, n)."""
VIEWS = f"Tuple(({_F4}, {_F3}, {_F4}, {_F4}, {_F3}, {_B2}, {_F2}))"
"""tracks (S, n, n, 22), ego (S, n, 10), neighbours (S, n, k, 8), ranges (S, n, 72, 12), memory (S, n, ...),
roles (S, n), up (S, 3)."""
ACTS = f"Tuple(({_F3}, {_F3}, {_F3}, {_F2}, {_L2}, {_F2}, {_F3}, {_F3}, {_F2}))"
"""flown before (S, n, 3) map; what the law wants (S, n, 3) and what is asked for (S, n, 3) in the heading
frame; sums (S, 7) and concerned (S, 2): see `judging_kernels`; the leader's memory (S, 9) as far as judging
wants it; terms (S, n, R) of this step and their sums over the trial, sums of the reward (S, n)."""
SHOWN = f"Tuple(({_G2}, {_G3}, {_G4}, {_G2}, {_G2}, {_G2}))"
"""ego, neighbours, grid, memory, privileged, reference: see `environment_results.Observation`."""
PAID = f"Tuple(({_G2}, {_G1}, {_B1}, {_B1}))"
"""terms (K, R), reward (K,), terminated (K,), truncated (K,)."""
SNAPSHOTS = f"Tuple(({_L2}, {_F5}, {_F5}, {_F4}, {_F4}, {_F4}, {_F5}, {_F4}, {_F4}))"
"""step of each (S, slots), -1 if there is none; then with a second axis over slots history, commands, gusts,
motion, loop, tracks, ego, memory."""
