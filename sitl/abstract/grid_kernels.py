"""The obstacle grid of one vehicle from the world itself, without points: what a cell's nearest return is.

Upright cylinders and spheres are solved cell by cell in closed form; everything else by rays inside its
window of azimuth and elevation. Scalar arithmetic only, in the common subset of compilers for processors
and graphics cards. The grid is that of `companion.perception.occupancy`.
"""

import math

import numpy as np

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.worlds.raycast_kernels import BOX, CAPSULE, CYLINDER, SPHERE, ray_box, ray_rod, ray_sphere

IndexArray = np.ndarray[tuple[int], np.dtype[np.int32]]

# Places in the array of limits.
MIN_RANGE, MAX_RANGE, MIN_HEIGHT, LOWEST, HIGHEST, SIGHT_LOWEST, SIGHT_HIGHEST = range(7)
N_LIMITS = 7

# What a vehicle in view is to the grid.
LEFT_OUT, AN_OBSTACLE, KNOWN = 0, 1, 2

_UPRIGHT = 1.0 - 1e-9
_TURN = 2.0 * math.pi


@portable_inlined
def cull(discs: FloatArray, x: float, y: float, reach: float, candidates: IndexArray) -> int:
    """List the primitives within a horizontal reach of a point; return how many there are."""
    count = 0
    for k in range(discs.shape[0]):
        dx, dy = discs[k, 0] - x, discs[k, 1] - y
        bound = reach + discs[k, 2]
        if dx * dx + dy * dy <= bound * bound:
            candidates[count] = k
            count += 1
    return count


@portable_inlined
def _keep(ranges: FloatArray, column: int, row: int, t: float, limits: FloatArray) -> None:
    if t < ranges[column, row] and t >= limits[MIN_RANGE] and t <= limits[MAX_RANGE]:
        ranges[column, row] = t


@portable_inlined
def _rows_between(low: float, high: float, limits: FloatArray, elevations: int) -> tuple[int, int]:
    """Return the first row that an interval of elevations touches and one past the last."""
    height = (limits[HIGHEST] - limits[LOWEST]) / elevations
    first = math.floor((low - limits[LOWEST]) / height)
    last = math.floor((high - limits[LOWEST]) / height)
    return max(int(first), 0), min(int(last) + 1, elevations)


@portable_inlined
def _draw_upright(
    x: float, y: float, z_low: float, z_high: float, radius: float,
    limits: FloatArray, row_edges: FloatArray, ranges: FloatArray,
) -> None:  # fmt: skip
    """Draw a cylinder about the vertical through (x, y) that reaches from below the centre to above it."""
    columns, elevations = ranges.shape
    width = _TURN / columns
    distance = math.sqrt(x * x + y * y)
    if distance <= radius or distance - radius > limits[MAX_RANGE]:
        return
    middle = math.atan2(y, x)
    half = math.asin(radius / distance)
    first, last = math.floor((middle - half) / width), math.floor((middle + half) / width)
    for index in range(int(first), int(last) + 1):
        # The nearest point in a column is the nearest of all, or lies on the column's edge.
        off = max(index * width - middle, 0.0)
        off = off if off > 0.0 else min((index + 1) * width - middle, 0.0)
        near = distance - radius
        if off != 0.0:
            across = distance * math.sin(off)
            near = distance * math.cos(off) - math.sqrt(max(radius * radius - across * across, 0.0))
        first_row, end_row = _rows_between(
            math.atan2(z_low, near), math.atan2(z_high, near), limits, elevations
        )
        for row in range(first_row, end_row):
            t = near
            if row_edges[row, 0] > 0.0:
                t = near / row_edges[row, 1]
            elif row_edges[row + 1, 0] < 0.0:
                t = near / row_edges[row + 1, 1]
            _keep(ranges, index % columns, row, t, limits)


@portable_inlined
def _draw_sphere(
    x: float, y: float, z: float, radius: float, floor: float,
    limits: FloatArray, column_edges: FloatArray, row_edges: FloatArray, ranges: FloatArray,
) -> None:  # fmt: skip
    """Draw a ball; `floor` is the lowest height above the grid's centre at which anything is shown."""
    columns, elevations = ranges.shape
    width = _TURN / columns
    flat = math.sqrt(x * x + y * y)
    distance = math.sqrt(flat * flat + z * z)
    if distance <= radius or distance - radius > limits[MAX_RANGE]:
        return
    sine = radius / distance
    alpha = math.asin(sine)
    elevation = math.atan2(z, flat)
    first_row, end_row = _rows_between(elevation - alpha, elevation + alpha, limits, elevations)
    if first_row >= end_row:
        return
    middle = math.atan2(y, x)
    first, last = 0, columns - 1
    if abs(elevation) + alpha < 0.5 * math.pi - 1e-6:
        half = math.asin(min(sine * distance / flat, 1.0))
        first, last = math.floor((middle - half) / width), math.floor((middle + half) / width)
    for index in range(first, min(last, first + columns - 1) + 1):
        # The ray of the cell that passes nearest to the centre returns the nearest point, or none does.
        column = index % columns
        from_middle = middle - index * width
        from_middle -= _TURN * math.floor(from_middle / _TURN)
        if from_middle <= width:
            ca, sa = x / flat, y / flat
        else:
            edge = column + 1 if from_middle - width < _TURN - from_middle else column
            ca, sa = column_edges[edge, 0], column_edges[edge, 1]
        for row in range(first_row, end_row):
            if ranges[column, row] <= distance - radius:
                continue
            ce, se = flat / distance, z / distance
            if elevation < row_edges[row, 0]:
                ce, se = row_edges[row, 1], row_edges[row, 2]
            elif elevation > row_edges[row + 1, 0]:
                ce, se = row_edges[row + 1, 1], row_edges[row + 1, 2]
            t = ray_sphere(-x, -y, -z, ce * ca, ce * sa, se, radius)
            if t * se >= floor:
                _keep(ranges, column, row, t, limits)


@portable_inlined
def _draw_by_rays(
    kind: int, row_of: FloatArray, disc_radius: float, disc_x: float, disc_y: float,
    px: float, py: float, pz: float, cos_yaw: float, sin_yaw: float,
    limits: FloatArray, azimuth_rays: FloatArray, elevation_rays: FloatArray, ranges: FloatArray,
) -> None:  # fmt: skip
    """Draw a rod or a box with the rays that may meet it."""
    columns, elevations = ranges.shape
    per_cell = azimuth_rays.shape[0] // columns
    floor = limits[MIN_HEIGHT] - pz
    # Into the heading frame, seen from the grid's centre.
    mx = cos_yaw * (px - row_of[0]) + sin_yaw * (py - row_of[1])
    my = cos_yaw * (py - row_of[1]) - sin_yaw * (px - row_of[0])
    mz = pz - row_of[2]
    if kind == BOX:
        z_low, z_high = -mz - row_of[5], -mz + row_of[5]
        ux, uy = cos_yaw * row_of[6] + sin_yaw * row_of[7], cos_yaw * row_of[7] - sin_yaw * row_of[6]
    else:
        end = -mz + row_of[6] * row_of[5]
        z_low, z_high = min(-mz, end) - row_of[7], max(-mz, end) + row_of[7]
        ux, uy = cos_yaw * row_of[3] + sin_yaw * row_of[4], cos_yaw * row_of[4] - sin_yaw * row_of[3]
    z_low = max(z_low, floor)
    if z_high <= z_low:
        return
    x, y = cos_yaw * disc_x + sin_yaw * disc_y, cos_yaw * disc_y - sin_yaw * disc_x
    distance = math.sqrt(x * x + y * y)
    near, far = max(distance - disc_radius, 1e-3), distance + disc_radius
    if near > limits[MAX_RANGE]:
        return
    low = math.atan2(z_low, near if z_low < 0.0 else far)
    high = math.atan2(z_high, far if z_high < 0.0 else near)
    first_row, end_row = _rows_between(low, high, limits, elevations)
    width = _TURN / columns
    first, last = 0, columns - 1
    if distance > disc_radius:
        middle, half = math.atan2(y, x), math.asin(disc_radius / distance)
        first, last = math.floor((middle - half) / width), math.floor((middle + half) / width)
        last = min(last, first + columns - 1)
    for index in range(first, last + 1):
        column = index % columns
        for row in range(first_row, end_row):
            best = ranges[column, row]
            if best <= near:
                continue
            for a in range(column * per_cell, (column + 1) * per_cell):
                for e in range(row * per_cell, (row + 1) * per_cell):
                    ce, se = elevation_rays[e, 0], elevation_rays[e, 1]
                    dx, dy = ce * azimuth_rays[a, 0], ce * azimuth_rays[a, 1]
                    if kind == BOX:
                        t = ray_box(mx, my, mz, dx, dy, se, row_of[3], row_of[4], row_of[5], ux, uy)
                    else:
                        t = ray_rod(
                            mx, my, mz, dx, dy, se, ux, uy, row_of[5], row_of[6], row_of[7], kind == CAPSULE
                        )
                    if t < best and t * se >= floor:
                        best = t
            _keep(ranges, column, row, best, limits)


@portable_inlined
def _draw_primitive(
    kind: int, row_of: FloatArray, disc_radius: float, disc_x: float, disc_y: float,
    px: float, py: float, pz: float, cos_yaw: float, sin_yaw: float, limits: FloatArray,
    azimuth_rays: FloatArray, elevation_rays: FloatArray, column_edges: FloatArray, row_edges: FloatArray,
    ranges: FloatArray,
) -> None:  # fmt: skip
    dx, dy, dz = row_of[0] - px, row_of[1] - py, row_of[2] - pz
    x, y = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
    floor = limits[MIN_HEIGHT] - pz
    if kind == SPHERE:
        _draw_sphere(x, y, dz, row_of[7], floor, limits, column_edges, row_edges, ranges)
        return
    if kind == CYLINDER and abs(row_of[5]) >= _UPRIGHT:
        low, high = dz + min(row_of[5] * row_of[6], 0.0), dz + max(row_of[5] * row_of[6], 0.0)
        if low <= 0.0 <= high and floor <= 0.0:
            _draw_upright(x, y, max(low, floor), high, row_of[7], limits, row_edges, ranges)
            return
    _draw_by_rays(
        kind, row_of, disc_radius, disc_x - px, disc_y - py, px, py, pz, cos_yaw, sin_yaw,
        limits, azimuth_rays, elevation_rays, ranges,
    )  # fmt: skip


@portable_inlined
def _hide_behind(
    x: float, y: float, z: float, radius: float, column_edges: FloatArray, row_edges: FloatArray,
    ranges: FloatArray,
) -> None:  # fmt: skip
    """Take away what lies behind a body in the cells that the body covers wholly."""
    columns, elevations = ranges.shape
    square = x * x + y * y + z * z
    if square <= radius * radius:
        return
    distance = math.sqrt(square)
    least = math.sqrt(1.0 - radius * radius / square) * distance
    # No elevation brings an edge of a column nearer to the body's centre than this.
    barely = least * least * (1.0 - 1e-9)
    b = column_edges[0, 0] * x + column_edges[0, 1] * y
    for column in range(columns):
        # Nothing is covered in columns that look elsewhere.
        a, b = b, column_edges[column + 1, 0] * x + column_edges[column + 1, 1] * y
        across = min(a, b)
        if across <= 0.0 or across * across + z * z < barely:
            continue
        for row in range(elevations):
            if ranges[column, row] < distance:
                continue
            covered = True
            for edge in range(row, row + 2):
                up = row_edges[edge, 2] * z
                if min(row_edges[edge, 1] * a + up, row_edges[edge, 1] * b + up) < least:
                    covered = False
            if covered:
                ranges[column, row] = math.inf


@portable_inlined
def _sine_at(row: int, across: float, up: float, row_edges: FloatArray) -> float:
    """Return the sine of a cell's elevation in the body's own axes."""
    ce = 0.5 * (row_edges[row, 1] + row_edges[row + 1, 1])
    se = 0.5 * (row_edges[row, 2] + row_edges[row + 1, 2])
    return float(ce * across + se * up)


@portable_inlined
def _hide_out_of_view(
    column: int, across: float, up: float, limits: FloatArray, row_edges: FloatArray, ranges: FloatArray
) -> None:
    """Take away the cells of a column that lie outside the tilted field of view.

    Args:
        column: which.
        across: the body's upward axis along the column's azimuth.
        up: its upright component.
        limits: of the grid.
        row_edges: of its rows.
        ranges: changed in place.
    """
    last = ranges.shape[1] - 1
    # Little tilted, higher rows are higher in the body's axes, too: only rows at the ends can be out of view.
    ordered = row_edges[last + 1, 1] * up > row_edges[last + 1, 2] * abs(across)
    for row in range(last + 1):
        sine = _sine_at(row, across, up, row_edges)
        if sine < limits[SIGHT_LOWEST] or sine > limits[SIGHT_HIGHEST]:
            ranges[column, row] = math.inf
        elif ordered:
            break
    if ordered:
        for row in range(last, -1, -1):
            sine = _sine_at(row, across, up, row_edges)
            if sine >= limits[SIGHT_LOWEST] and sine <= limits[SIGHT_HIGHEST]:
                break
            ranges[column, row] = math.inf


@portable(
    "void(int32[::1], float64[:,::1], float64[:,::1], int32[::1], int64, float64[:,::1], uint8[::1], float64,"
    " float64, float64, float64, float64, float64[::1], float64[::1], float64[:,::1], float64[:,::1],"
    " float64[:,::1], float64[:,::1], float64[:,::1])"
)
def draw_grid(
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    candidates: IndexArray,
    count: int,
    bodies: FloatArray,
    roles: np.ndarray[tuple[int], np.dtype[np.uint8]],
    body_radius: float,
    px: float,
    py: float,
    pz: float,
    yaw: float,
    up_heading: FloatArray,
    limits: FloatArray,
    azimuth_rays: FloatArray,
    elevation_rays: FloatArray,
    column_edges: FloatArray,
    row_edges: FloatArray,
    ranges: FloatArray,
) -> None:
    """Find the nearest return of every cell.

    Args:
        kinds: (m,) kind of each primitive.
        rows: (m, 8) its shape.
        discs: (m, 3) its enclosing vertical cylinder.
        candidates: those that may be near, the first `count` of them.
        count: how many.
        bodies: (n, 3 or more) where the vehicles are, world, m.
        roles: (n,) what each is: left out (the vehicle itself), an obstacle, or known: then it is not in
            the grid, but hides what is behind it.
        body_radius: of a ball that stands for a vehicle, m.
        px: the grid's centre, world, m.
        py: likewise.
        pz: likewise, above the ground.
        yaw: its heading, rad.
        up_heading: (3,) body z axis in the heading frame: the field of view tilts with the body.
        limits: (7,) nearest and farthest range m; lowest height shown m; lowest and highest elevation of
            the grid rad; sines of those of the sensor's field of view.
        azimuth_rays: (columns k, 2) cosine and sine of the azimuths of rays.
        elevation_rays: (rows k, 2) likewise of their elevations.
        column_edges: (columns + 1, 2) cosine and sine of the edges of columns.
        row_edges: (rows + 1, 3) angle, cosine and sine of the edges of rows.
        ranges: (columns, rows) out, m; infinity where nothing returns.
    """
    columns, elevations = ranges.shape
    for column in range(columns):
        for row in range(elevations):
            ranges[column, row] = math.inf
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    for slot in range(count):
        k = candidates[slot]
        _draw_primitive(
            kinds[k], rows[k], discs[k, 2], discs[k, 0], discs[k, 1], px, py, pz, cos_yaw, sin_yaw, limits,
            azimuth_rays, elevation_rays, column_edges, row_edges, ranges,
        )  # fmt: skip
    for role in range(1, 3):
        for j in range(roles.shape[0]):
            if roles[j] != role:
                continue
            dx, dy, dz = bodies[j, 0] - px, bodies[j, 1] - py, bodies[j, 2] - pz
            x, y = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
            if role == AN_OBSTACLE:
                _draw_sphere(
                    x, y, dz, body_radius, limits[MIN_HEIGHT] - pz, limits, column_edges, row_edges, ranges
                )
            elif x * x + y * y + dz * dz < limits[MAX_RANGE] * limits[MAX_RANGE]:
                _hide_behind(x, y, dz, body_radius, column_edges, row_edges, ranges)
    for column in range(columns):
        ca, sa = (
            0.5 * (column_edges[column, 0] + column_edges[column + 1, 0]),
            0.5 * (column_edges[column, 1] + column_edges[column + 1, 1]),
        )
        _hide_out_of_view(
            column, ca * up_heading[0] + sa * up_heading[1], up_heading[2], limits, row_edges, ranges
        )
