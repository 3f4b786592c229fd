"""Snapshots of swarms in flight, from which trials can begin again."""

from typing import Any

from companion.compiled import portable_inlined
from companion.messages import FloatArray
from sitl.training import batch_layout_kernels as at

Arrays = tuple[Any, ...]


@portable_inlined
def keep_snapshot(s: int, i: int, step: int, motion: Arrays, views: Arrays, snapshots: Arrays) -> None:
    """Keep what vehicle i could begin a trial from, before it perceives anything in this step."""
    slot = (step // at.SNAPSHOT_STEPS) % snapshots[0].shape[1]
    if i == 0:
        snapshots[0][s, slot] = step
    for row in range(motion[0].shape[1]):
        _copy(motion[0][s, row, i], snapshots[1][s, slot, row, i])
        _copy(motion[1][s, row, i], snapshots[2][s, slot, row, i])
    _copy(motion[2][s, i], snapshots[3][s, slot, i])
    _copy(motion[3][s, i], snapshots[4][s, slot, i])
    _copy(motion[4][s, i], snapshots[5][s, slot, i])
    for j in range(views[0].shape[2]):
        _copy(views[0][s, i, j], snapshots[6][s, slot, i, j])
    _copy(views[1][s, i], snapshots[7][s, slot, i])
    _copy(views[4][s, i], snapshots[8][s, slot, i])


@portable_inlined
def _copy(source: FloatArray, target: FloatArray) -> None:
    for index in range(source.shape[0]):
        target[index] = source[index]
