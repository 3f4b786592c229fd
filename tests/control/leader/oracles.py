"""Slow, readable counterparts of the leader's kernels."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from companion.control.leader import map_kernels
from companion.messages import FloatArray


def hits_of(
    points: FloatArray,
    p: FloatArray,
    first: NDArray[np.int64],
    shape: tuple[int, int, int],
    cell: float,
    layer: float,
    reach: float,
    self_radius: float,
    floor_z: float,
) -> tuple[NDArray[np.int8], FloatArray]:
    hits = np.zeros(shape, np.int8)
    sums = np.zeros((*shape[:2], 3))
    sizes = np.array([cell, cell, layer])
    for point in points.astype(np.float64):
        if not np.all(np.isfinite(point)) or point[2] < floor_z:
            continue
        if np.hypot(*(point - p)[:2]) > reach or np.linalg.norm(point - p) < self_radius:
            continue
        voxel = np.floor(point / sizes).astype(int)
        if np.any(voxel < first) or np.any(voxel >= first + np.array(shape)):
            continue
        i, j, k = voxel % np.array(shape)
        hits[i, j, k] = min(hits[i, j, k] + 1, 3)
        sums[i, j, :2] += point[:2] - (voxel[:2] + 0.5) * cell
        sums[i, j, 2] += 1.0
    return hits, sums


def ranges_of(points: FloatArray, p: FloatArray, self_radius: float, rows: int, columns: int) -> FloatArray:
    image = np.full((rows, columns), np.inf)
    low, high = np.sin(np.radians(-7.0)), np.sin(np.radians(52.0))
    for point in points.astype(np.float64):
        offset = point - p
        length = float(np.linalg.norm(offset))
        if not np.isfinite(length) or length <= self_radius:
            continue
        row = int(np.floor((offset[2] / length - low) / (high - low) * rows))
        column = azimuth_column(offset, columns)
        if 0 <= row < rows:
            image[row, column] = min(image[row, column], length)
    return image


def azimuth_column(offset: FloatArray, columns: int) -> int:
    """Column of a direction: walk round the unit diamond |x| + |y| = 1, a quarter of the image a side."""
    x, y = offset[:2] / (np.abs(offset[0]) + np.abs(offset[1]))
    turn = (y if y >= 0.0 else 4.0 + y) if x >= 0.0 else 2.0 - y
    return min(int(turn / 4.0 * columns), columns - 1)


def evidence_after(
    evidence: NDArray[np.int16],
    hits: NDArray[np.int8],
    image: FloatArray,
    p: FloatArray,
    first: NDArray[np.int64],
    cell: float,
    layer: float,
    ceiling: int,
) -> NDArray[np.int16]:
    after = evidence.copy()
    shape = np.array(evidence.shape)
    low, high = np.sin(np.radians(-7.0)), np.sin(np.radians(52.0))
    for index in np.ndindex(*evidence.shape):
        voxel = first + (np.array(index) - first) % shape
        offset = (voxel + 0.5) * np.array([cell, cell, layer]) - p
        length = float(np.linalg.norm(offset))
        row = int(np.floor((offset[2] / length - low) / (high - low) * image.shape[0]))
        if hits[index] > 0:
            after[index] = min(int(evidence[index]) + 10 * int(hits[index]), ceiling)
            continue
        loss = 1 if evidence[index] < map_kernels.EVIDENCE_OCCUPIED else 0
        if 0 <= row < image.shape[0]:
            nearest = image[row, azimuth_column(offset, image.shape[1])]
            if np.isinf(nearest):
                loss = 1
            elif nearest > length + 0.3:
                loss = map_kernels.EVIDENCE_PER_PASS
        after[index] = max(int(evidence[index]) - loss, 0)
    return after


def distances_of(blocked: NDArray[np.uint8], cell: float, cap_cells: int) -> FloatArray:
    occupied = np.argwhere(blocked)
    result = np.full(blocked.shape, cap_cells * cell)
    for index in np.ndindex(*blocked.shape):
        if occupied.size:
            nearest = np.hypot(*(occupied - np.array(index)).T).min() * cell
            result[index] = min(result[index], nearest)
    return result


def tree_of(
    clearance: Callable[[FloatArray], float],
    wanted: float,
    start: FloatArray,
    goal: FloatArray,
    samples: FloatArray,
    disc: float,
    goal_bias: float,
    step: float,
    most: int,
) -> tuple[FloatArray, list[int], int]:
    """Grow the tree where `clearance` of a point says there is room."""

    def is_free(a: FloatArray, b: FloatArray) -> bool:
        count = int(np.ceil(np.hypot(*(b - a)) / 0.1))
        line = a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a)
        return all(clearance(point) >= wanted for point in line)

    nodes, parents = [start], [-1]
    for chance, squared, turn in samples:
        if len(nodes) >= most - 1:
            break
        angle = 2.0 * np.pi * turn
        target = start + disc * np.sqrt(squared) * np.array([np.cos(angle), np.sin(angle)])
        if chance < goal_bias:
            target = goal
        gaps = np.hypot(*(np.array(nodes) - target).T)
        nearest = int(np.argmin(gaps))
        if gaps[nearest] < 1e-9:
            continue
        new = nodes[nearest] + min(1.0, step / gaps[nearest]) * (target - nodes[nearest])
        if not is_free(nodes[nearest], new):
            continue
        nodes.append(new)
        parents.append(nearest)
        if np.hypot(*(goal - new)) <= step and is_free(new, goal):
            nodes.append(goal)
            parents.append(len(nodes) - 2)
            return np.array(nodes), parents, len(nodes) - 1
    return np.array(nodes), parents, -1


def nearest_per_sector(points: FloatArray, p: FloatArray, reach: float, count: int) -> FloatArray:
    sectors = np.zeros((count, 3))
    sectors[:, 2] = np.inf
    for point in points:
        offset = point - p
        gap = float(np.hypot(*offset))
        angle = float(np.arctan2(offset[1], offset[0])) % (2.0 * np.pi)
        sector = int(angle / (2.0 * np.pi) * count) % count
        if 0.0 < gap <= reach and gap < sectors[sector, 2]:
            sectors[sector] = [*(offset / gap), gap]
    return sectors


def repulsion_of(
    sectors: FloatArray, radius: float, gain: float, distance: float, limit: float
) -> FloatArray:
    rooms = np.maximum(sectors[:, 2] - radius, 0.05)
    reach = np.minimum(distance, 0.5 * (rooms + np.roll(rooms, -(len(rooms) // 2))))
    force = np.zeros(2)
    for sector, room, most in zip(sectors, rooms, reach, strict=True):
        if room < most:
            force -= min(gain * (1.0 / room - 1.0 / most) / room**2, limit) * sector[:2]
    size = float(np.hypot(*force))
    return force if size <= limit else force * limit / size
