"""What a laser scanner sees of an upright cylinder: the model of another UAV's body."""

import math

import numpy as np

from companion.messages import FloatArray
from companion.perception.tracking.settings import TrackingSettings

_TAPE_WEIGHT = 5.0
_TAPE_TELLS = np.array([1.0, 0.0, 1.0])
# How far points scatter about their mean along the beam, across it (in radii) and upwards (in heights);
# beams fall more evenly than by chance, so across a body the mean is better than the scatter says.
_TAPE_SCATTER = 0.23, 0.3
_DIM_SCATTER = 0.63, 0.67
_WIDTH_SCATTER = 0.63
# How much nearer than the outline's mean that mean is.
_TAPE_DEPTH, _DIM_DEPTH = 1.3, 0.63
_BEYOND_M = 0.16, 0.11  # arms, rotors and legs reach beyond the cylinder...
_BEYOND_SHARE = 1.08  # ...and return so many points for each one on it


def visible_surface(direction_map: FloatArray, radius_m: float, height_m: float) -> FloatArray:
    """Return the mean (3,) of the visible points of a body about its centre.

    Beams from afar hit the half of the side and the cap that face the sensor, evenly over the outline
    they present.

    Args:
        direction_map: (3,) from the sensor to the body, any length above 0.
        radius_m: of the upright cylinder.
        height_m: of the upright cylinder.
    """
    x, y, z = direction_map.tolist()
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    flat = math.hypot(x, y)
    side_area, cap_area = 2.0 * radius_m * height_m * flat, math.pi * radius_m**2 * abs(z)
    side = side_area / (side_area + cap_area)
    # Seen from straight below or above the cap is all there is, and the horizontal direction no matter.
    inward = 0.25 * math.pi * radius_m / max(flat, 1e-9)
    downward = math.copysign(0.5 * height_m, z)
    return np.array([-side * inward * x, -side * inward * y, -(1.0 - side) * downward])


def seen_of(
    dim: int, bright: int, tape_map: FloatArray, axes: FloatArray, settings: TrackingSettings
) -> tuple[FloatArray, FloatArray]:
    """Return the way from the mean of a body's points to its centre (3,), and how surely that is it.

    Tape is on the hull and in its middle; arms, rotors and legs, which have none, are all around it. So
    bright points tell more of the distance and the height; across the beam all tell the same.

    Args:
        dim: number of points that are not bright.
        bright: number of bright ones.
        tape_map: (3,) from the mean of all points to that of the bright ones.
        axes: (3, 3) see `sight_axes`.
        settings: size of the body.

    Returns:
        The way, and the variance (3,) of its end along the beam, across it and upwards, m^2.
    """
    radius, height = settings.body_radius_m, settings.body_height_m
    weighed = _TAPE_WEIGHT * bright
    total = max(weighed + dim, 1.0)
    depth = (_TAPE_DEPTH * weighed + _DIM_DEPTH * dim) / total
    shift = -depth * visible_surface(axes[0], radius, height)
    if bright:
        shift += ((_TAPE_WEIGHT - 1.0) * bright / total) * ((axes @ tape_map) * _TAPE_TELLS) @ axes
    along, up = (
        (_TAPE_WEIGHT * weighed * tape**2 + dim * rest**2) / total**2
        for tape, rest in zip(_TAPE_SCATTER, _DIM_SCATTER, strict=True)
    )
    across = _WIDTH_SCATTER**2 / max(bright + dim, 1)
    size = np.array([radius, radius, height])
    return shift, np.array([along, across, up]) * (settings.scatter_factor * size) ** 2


def sight_axes(direction_map: FloatArray) -> FloatArray:
    """Return the axes of sight (3, 3), one a row: along the beam, across it and level, upwards."""
    x, y, z = direction_map.tolist()
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    flat = math.hypot(x, y)
    left, ahead = (-y / flat, x / flat) if flat > 1e-6 else (0.0, 1.0)
    return np.array([[x, y, z], [left, ahead, 0.0], [-z * ahead, z * left, x * ahead - y * left]])


def outline_m(settings: TrackingSettings) -> tuple[float, float]:
    """Return half the width and half the height of everything that may belong to a body."""
    return settings.body_radius_m + _BEYOND_M[0], 0.5 * settings.body_height_m + _BEYOND_M[1]


def whole_body_points(range_m: float, settings: TrackingSettings) -> float:
    """Return how many points of one scan a body shows of itself, on average."""
    outline = (1.0 + _BEYOND_SHARE) * 2.0 * settings.body_radius_m * settings.body_height_m
    return settings.points_per_steradian * outline / range_m**2
