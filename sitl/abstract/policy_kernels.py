"""What stands between a swarm's kernels and a learned policy: observations out, velocities in."""

import math

import numpy as np

from companion.compiled import compiled
from companion.control.followers.laws_kernels import overrule
from companion.control.observation_kernels import describe, keeping_of
from companion.messages import Float32Array, FloatArray
from sitl.abstract.swarm_kernels import VIEWS, Arrays
from sitl.dynamics_kernels import Q

_F1, _F2 = "float64[::1]", "float64[:,::1]"
_S2, _S3, _S4 = "float32[:,::1]", "float32[:,:,::1]", "float32[:,:,:,::1]"


@compiled(f"void(int64, {VIEWS}, {_F2}, {_F1}, {_F2}, {_F2}, {_S2}, {_S3}, {_S4}, {_S2})")
def describe_swarm(
    contract: int,
    views: Arrays,
    state: FloatArray,
    law: FloatArray,
    flown: FloatArray,
    wanted: FloatArray,
    ego_out: Float32Array,
    neighbours_out: Float32Array,
    grid_out: Float32Array,
    memory_out: Float32Array,
) -> None:
    """Write the observations of all followers of a swarm, after `begin_step`.

    Args:
        contract: its number, see `observation_kernels.describe`.
        views: see `swarm_kernels.VIEWS`.
        state: (n, 19) where everybody is and how it is inclined, see `dynamics_kernels`.
        law: (PARAMETER_COUNT,) of the followers' law.
        flown: (n, 3) velocities flown before this step, map.
        wanted: (n, 3) what the law wants, heading frame.
        ego_out: (n - 1, E) out, see `describe`; so are the others.
        neighbours_out: (n - 1, k, w) out.
        grid_out: (n - 1, 2, 72, 12) out.
        memory_out: (n - 1, M) out.
    """
    _, ego, neighbours, ranges, memory, _, up = views
    previous = np.empty(3)
    for i in range(1, ego.shape[0]):
        w, x, y, z = state[i, Q], state[i, Q + 1], state[i, Q + 2], state[i, Q + 3]
        cosine, sine = math.cos(ego[i, 6]), math.sin(ego[i, 6])
        east, north = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
        up[0] = cosine * east + sine * north
        up[1] = cosine * north - sine * east
        up[2] = 1.0 - 2.0 * (x * x + y * y)
        previous[0] = cosine * flown[i, 0] + sine * flown[i, 1]
        previous[1] = cosine * flown[i, 1] - sine * flown[i, 0]
        previous[2] = flown[i, 2]
        row = i - 1
        describe(
            contract, ego[i], up, neighbours[i], ranges[i], memory[i], law, wanted[i], previous, ego_out[row],
            neighbours_out[row], grid_out[row], memory_out[row],
        )  # fmt: skip


@compiled(f"int64(int64, {VIEWS}, {_F1}, {_F2}, {_S2}, {_F2})")
def overrule_swarm(
    contract: int,
    views: Arrays,
    law: FloatArray,
    flown: FloatArray,
    velocities: Float32Array,
    wanted: FloatArray,
) -> int:
    """Let all followers of a swarm fly a policy's velocities, limited like those of a law.

    Whoever gets a velocity that is not finite goes on as the law wants.

    Args:
        contract: of the policy, see `observation_kernels.describe`.
        views: see `swarm_kernels.VIEWS`.
        law: (PARAMETER_COUNT,) of the followers' law.
        flown: (n, 3) velocities flown before this step, map.
        velocities: (n - 1, 3) the policy's, heading frame, m/s.
        wanted: (n, 3) in: what the law wants; out: what is flown, heading frame.

    Returns:
        How many go on as the law wants.
    """
    _, ego, _, _, memory, _, _ = views
    fallen = 0
    for i in range(1, ego.shape[0]):
        x, y, z = velocities[i - 1, 0], velocities[i - 1, 1], velocities[i - 1, 2]
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            fallen += 1
            continue
        wanted[i, 0] = x
        wanted[i, 1] = y
        wanted[i, 2] = z
        overrule(keeping_of(contract), ego[i], flown[i], memory[i], law, wanted[i])
    return fallen
