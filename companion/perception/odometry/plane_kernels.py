"""Planes through the fused points of the map."""

import numpy as np

from companion.compiled import inlined
from companion.messages import FloatArray

_LEAST_SPREAD = 0.02  # of the squared distances, below which curvature cannot be told from height
_PATCH = 0.2 / 1.5**2  # e^2 / 5 over the squared radius: between straight and slanted patches


@inlined
def smallest_eigenvector(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float, result: FloatArray
) -> None:
    """Decompose a symmetric 3x3 matrix.

    Source: O. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", CACM 4(4), 1961.

    Args:
        xx: entry (0, 0).
        xy: entry (0, 1).
        xz: entry (0, 2).
        yy: entry (1, 1).
        yz: entry (1, 2).
        zz: entry (2, 2).
        result: (6,) receives the unit eigenvector of the smallest eigenvalue, then the eigenvalues
            ascending; a zero vector where the smallest is not unique.
    """
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p2 = (a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0
    p = np.sqrt(p2)
    result[0], result[1], result[2] = 0.0, 0.0, 0.0
    result[3], result[4], result[5] = mean, mean, mean
    if not p > 1e-12:
        return
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    cosine = min(1.0, max(-1.0, determinant / (2.0 * p * p2)))
    angle = np.arccos(cosine) / 3.0
    high = mean + 2.0 * p * np.cos(angle)
    low = mean + 2.0 * p * np.cos(angle + 2.0943951023931953)
    result[3], result[4], result[5] = low, 3.0 * mean - high - low, high
    # Columns of (A - low I) span the other two eigenvectors: their cross products give the third.
    a, b, c = xx - low, yy - low, zz - low
    x0, y0, z0 = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
    x1, y1, z1 = xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz
    x2, y2, z2 = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    n0, n1, n2 = x0 * x0 + y0 * y0 + z0 * z0, x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
    if n0 >= n1 and n0 >= n2:
        x, y, z, square = x0, y0, z0, n0
    elif n1 >= n2:
        x, y, z, square = x1, y1, z1, n1
    else:
        x, y, z, square = x2, y2, z2, n2
    if square > 0.0:
        scale = 1.0 / np.sqrt(square)
        result[0], result[1], result[2] = x * scale, y * scale, z * scale


@inlined
def fit_plane(found: FloatArray, count: int, radius_m: float, eigen: FloatArray, plane: FloatArray) -> bool:
    """Fit the surface near the origin to fused points, nearer and better settled ones counting more.

    The normal comes from the scatter of the points, the offset from their heights h over the plane
    through the origin, fitted by h = a + b s with s the squared distance along the plane. Without b the
    plane lies inside every convex surface, 17 mm on a pillar of 30 cm radius: each scan is
    pushed away from it, and the map follows. A fused point itself lies inside by what its cell spans,
    which is b e^2 / 6 for a patch of the cell's edge e and more for one that cuts it at a slant.

    Args:
        found: (>= count, 6) offsets, numbers of points and squared distances.
        count: how many.
        radius_m: distance at which a point's weight reaches zero.
        eigen: (6,) scratch.
        plane: (>= 6,) receives the normal, minus the surface's height at the origin, the variance of
            that height and the variance of the points about their plane.

    Returns:
        Whether the points determine a plane.
    """
    inverse = 1.0 / (radius_m * radius_m)
    total, squares = 0.0, 0.0
    cx, cy, cz = 0.0, 0.0, 0.0
    for i in range(count):
        weight = (1.0 - found[i, 4] * inverse) * found[i, 3] / (found[i, 3] + 4.0)
        found[i, 3] = weight
        total += weight
        squares += weight * weight
        cx += weight * found[i, 0]
        cy += weight * found[i, 1]
        cz += weight * found[i, 2]
    if not total > 1e-6:
        return False
    cx, cy, cz = cx / total, cy / total, cz / total
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        dx, dy, dz = found[i, 0] - cx, found[i, 1] - cy, found[i, 2] - cz
        weight = found[i, 3] / total
        xx += weight * dx * dx
        xy += weight * dx * dy
        xz += weight * dx * dz
        yy += weight * dy * dy
        yz += weight * dy * dz
        zz += weight * dz * dz
    smallest_eigenvector(xx, xy, xz, yy, yz, zz, eigen)
    low, middle, high = max(eigen[3], 0.0), eigen[4], eigen[5]
    # A line, or a blob, is no plane.
    if middle < 0.08 * high or low > 0.2 * middle:
        return False
    nx, ny, nz = eigen[0], eigen[1], eigen[2]
    effective = total * total / squares
    # Sums for h = a + b u, with u = s / radius^2.
    wu, wuu, wh, whu = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        height = nx * found[i, 0] + ny * found[i, 1] + nz * found[i, 2]
        u = (found[i, 4] - height * height) * inverse
        weight = found[i, 3]
        wu += weight * u
        wuu += weight * u * u
        wh += weight * height
        whu += weight * u * height
    determinant = total * wuu - wu * wu
    distance, spread = wh / total, 1.0
    if determinant > _LEAST_SPREAD * total * total:
        bend = (total * whu - wu * wh) / determinant
        distance = (wuu * wh - wu * whu) / determinant - _PATCH * bend
        spread = total * wuu / determinant
    along = nx * cx + ny * cy + nz * cz
    lever = cx * cx + cy * cy + cz * cz - along * along
    plane[0], plane[1], plane[2], plane[3] = nx, ny, nz, -distance
    plane[4] = low * (spread + lever / middle) * (1.0 / max(effective - 2.0, 1.0))
    plane[5] = low
    return True
