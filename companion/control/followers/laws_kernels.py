"""One entry to all followers' laws: `steer`, the same in flight, in emulation and in training."""

import math

from companion.compiled import portable, portable_inlined
from companion.control.followers.flock_kernels import flock
from companion.control.followers.flock_limit_kernels import keep_to_limits
from companion.control.followers.layout_kernels import (
    EGO_ALONE,
    EGO_DT,
    EGO_YAW,
    MAX_ACCELERATION,
    MAX_SPEED,
    MAX_VERTICAL_SPEED,
    METHOD_IDS,
    PREVIOUS,
    STARTED,
)
from companion.control.followers.lloyd_kernels import lloyd
from companion.control.followers.pacnav_kernels import pacnav
from companion.control.followers.reynolds_kernels import reynolds
from companion.control.followers.sensing_kernels import keep_height
from companion.control.followers.visual_kernels import visual_field, visual_field_polar
from companion.messages import FloatArray

_FLOCK = METHOD_IDS["flock"]
_PACNAV = METHOD_IDS["pacnav"]
_VPF = METHOD_IDS["vpf"]
_VPF_POLAR = METHOD_IDS["vpf_polar"]
_REYNOLDS_APF = METHOD_IDS["reynolds_apf"]
_LLOYD = METHOD_IDS["lloyd"]


@portable(
    "void(int64, float64[::1], float64[:,::1], float64[:,::1], float64[::1], float64[::1], float64[::1])"
)
def steer(
    method: int,
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    command: FloatArray,
) -> None:
    """Choose a follower's velocity.

    Args:
        method: number of the law, see `METHOD_IDS`; any other asks for zero velocity.
        ego: (10,) own position in the map m, velocity in the heading frame m/s, yaw in the map rad, height
            over the start's ground m, time since the last call s, time since anybody was perceived s.
        neighbours: (k, 8) nearest first: relative position m and relative velocity m/s in the heading
            frame, 1 where there is a neighbour, number of its track; the other rows are zero.
        ranges: (72, 12) obstacle grid of the newest scan in the level heading frame, m, infinity where
            free; see `layout_kernels` for its cells.
        memory: (MEMORY_SIZE,) whatever the law remembers; all zero at the start.
        parameters: (PARAMETER_COUNT,) from `FollowerSettings.packed`.
        command: (3,) receives the velocity in the heading frame, m/s; always finite. Where an input is not
            a number it is zero.
    """
    if method == _FLOCK:
        steer_flock(ego, neighbours, ranges, memory, parameters, command, is_new_grid=True)
        return
    if not (_is_sound(ego, neighbours) and _is_sound_grid(ranges)):
        _stop(memory, command)
        return
    command[0] = 0.0
    command[1] = 0.0
    command[2] = 0.0
    if method == _PACNAV:
        pacnav(ego, neighbours, ranges, memory, parameters, command)
    elif method == _VPF:
        visual_field(ego, neighbours, ranges, memory, parameters, command)
    elif method == _VPF_POLAR:
        visual_field_polar(ego, neighbours, ranges, memory, parameters, command)
    elif method == _REYNOLDS_APF:
        reynolds(ego, neighbours, ranges, memory, parameters, command)
    elif method == _LLOYD:
        lloyd(ego, neighbours, ranges, memory, parameters, command)
    if method in (_PACNAV, _VPF, _VPF_POLAR, _REYNOLDS_APF, _LLOYD):
        command[2] = keep_height(ego, neighbours, parameters)
    _finish(ego, memory, parameters, command)


@portable_inlined
def steer_flock(
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    command: FloatArray,
    is_new_grid: bool,
) -> None:
    """Choose a velocity as `steer` does with `flock`.

    Args:
        ego: as for `steer`.
        neighbours: likewise.
        ranges: likewise.
        memory: likewise.
        parameters: likewise.
        command: likewise.
        is_new_grid: False only if `ranges` was sound in the call before, with this memory, and has not
            changed since; it is not looked at again then.
    """
    if not (_is_sound(ego, neighbours) and (not is_new_grid or _is_sound_grid(ranges))):
        _stop(memory, command)
        return
    command[0] = 0.0
    command[1] = 0.0
    command[2] = 0.0
    flock(ego, neighbours, ranges, memory, parameters, command, is_new_grid)
    _finish(ego, memory, parameters, command)


@portable_inlined
def _stop(memory: FloatArray, command: FloatArray) -> None:
    """Ask for zero velocity, and remember that."""
    for axis in range(3):
        command[axis] = 0.0
        memory[PREVIOUS + axis] = 0.0


@portable_inlined
def _is_sound(ego: FloatArray, neighbours: FloatArray) -> bool:
    """Return whether everything but the grid can be reckoned with."""
    for index in range(EGO_ALONE):
        if not math.isfinite(ego[index]):
            return False
    if math.isnan(ego[EGO_ALONE]) or ego[EGO_DT] < 0.0:
        return False
    for row in range(neighbours.shape[0]):
        for index in range(neighbours.shape[1]):
            if not math.isfinite(neighbours[row, index]):
                return False
    return True


@portable_inlined
def _is_sound_grid(ranges: FloatArray) -> bool:
    """Return whether the grid can be reckoned with."""
    unsound = 0
    for column in range(ranges.shape[0]):
        for row in range(ranges.shape[1]):
            # Unsound is what is not a number, too; counting leaves the loop without a way out in between.
            unsound += 0 if ranges[column, row] >= 0.0 else 1
    return unsound == 0


@portable_inlined
def _finish(ego: FloatArray, memory: FloatArray, parameters: FloatArray, command: FloatArray) -> None:
    """Limit the command's speed and its change, and remember it in the map."""
    _limit(
        ego,
        memory[PREVIOUS],
        memory[PREVIOUS + 1],
        memory[PREVIOUS + 2],
        parameters,
        command,
    )
    _remember(ego, memory, command)


@portable_inlined
def _limit(
    ego: FloatArray,
    previous_x: float,
    previous_y: float,
    previous_z: float,
    parameters: FloatArray,
    command: FloatArray,
) -> None:
    """Limit a command's speed, and its change since the previous one, which is given in the map."""
    if not (math.isfinite(command[0]) and math.isfinite(command[1]) and math.isfinite(command[2])):
        command[0] = 0.0
        command[1] = 0.0
        command[2] = 0.0
    limit = parameters[MAX_VERTICAL_SPEED]
    command[2] = min(max(command[2], -limit), limit)
    size = math.sqrt(command[0] * command[0] + command[1] * command[1] + command[2] * command[2])
    if size > parameters[MAX_SPEED]:
        scale = parameters[MAX_SPEED] / size
        command[0] *= scale
        command[1] *= scale
        command[2] *= scale
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    before_x = cos_yaw * previous_x + sin_yaw * previous_y
    before_y = cos_yaw * previous_y - sin_yaw * previous_x
    before_z = previous_z
    dx, dy, dz = command[0] - before_x, command[1] - before_y, command[2] - before_z
    step = math.sqrt(dx * dx + dy * dy + dz * dz)
    allowed = parameters[MAX_ACCELERATION] * ego[EGO_DT]
    if step > allowed:
        command[0] = before_x + dx * allowed / step
        command[1] = before_y + dy * allowed / step
        command[2] = before_z + dz * allowed / step


@portable_inlined
def _remember(ego: FloatArray, memory: FloatArray, command: FloatArray) -> None:
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    memory[STARTED] = 1.0
    memory[PREVIOUS] = cos_yaw * command[0] - sin_yaw * command[1]
    memory[PREVIOUS + 1] = sin_yaw * command[0] + cos_yaw * command[1]
    memory[PREVIOUS + 2] = command[2]


@portable("boolean(float64[::1], float64[:,::1], float64[:,::1])")
def is_sound(ego: FloatArray, neighbours: FloatArray, ranges: FloatArray) -> bool:
    """Return whether `steer` can reckon with its inputs; if not it asks for zero velocity."""
    return _is_sound(ego, neighbours) and _is_sound_grid(ranges)


@portable("void(float64[::1], float64[::1], float64[::1], float64[::1])")
def limit_command(
    ego: FloatArray, previous_map: FloatArray, parameters: FloatArray, command: FloatArray
) -> None:
    """Limit a wanted velocity as `steer` limits what its laws want.

    Args:
        ego: (10,) as for `steer`.
        previous_map: (3,) the command flown before, in the map, m/s.
        parameters: (PARAMETER_COUNT,) as for `steer`.
        command: (3,) in and out: velocity in the heading frame, m/s; reckoned as zero where it is
            not finite.
    """
    _limit(ego, previous_map[0], previous_map[1], previous_map[2], parameters, command)


@portable("void(int64, float64[::1], float64[::1], float64[::1], float64[::1], float64[::1])")
def overrule(
    keeping: int,
    ego: FloatArray,
    previous_map: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    command: FloatArray,
) -> None:
    """Fly another velocity than the law has just asked for.

    It is limited against what was flown before this tick, and remembered in place of the law's command: the
    law goes on from what is really flown.

    Args:
        keeping: 1 if it must keep to what `flock`, which is then the law, allows: its half-planes have the
            last word before the limits of all commands; 0 if not.
        ego: (10,) as given to `steer` in this tick.
        previous_map: (3,) the command flown before this tick, in the map: what `memory` held from `PREVIOUS`
            on before `steer`.
        memory: (MEMORY_SIZE,) the law's, after `steer`.
        parameters: (PARAMETER_COUNT,) as for `steer`.
        command: (3,) in and out: velocity in the heading frame, m/s.
    """
    if keeping == 1 and math.isfinite(command[0]) and math.isfinite(command[1]):
        cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
        asked_x = cos_yaw * memory[PREVIOUS] + sin_yaw * memory[PREVIOUS + 1]
        asked_y = cos_yaw * memory[PREVIOUS + 1] - sin_yaw * memory[PREVIOUS]
        keep_to_limits(asked_x, asked_y, memory, command)
    _limit(ego, previous_map[0], previous_map[1], previous_map[2], parameters, command)
    _remember(ego, memory, command)
