"""What a laser scanner sees of an upright cylinder: the model of another UAV's body."""

import math

import numpy as np

from companion.messages import FloatArray
from companion.perception.tracking.settings import TrackingSettings

_BEYOND_M = 0.13, 0.09  # arms, rotors and legs reach beyond the cylinder


def visible_surface(direction_map: FloatArray, radius_m: float, height_m: float) -> FloatArray:
    """Return the mean (3,) of the visible points of a body about its centre.

    Beams from afar hit the half of the side and the cap that face the sensor, evenly over the outline
    they present.

    Args:
        direction_map: (3,) from the sensor to the body, any length above 0.
        radius_m: of the upright cylinder.
        height_m: of the upright cylinder.
    """
    x, y, z = (direction_map / np.linalg.norm(direction_map)).tolist()
    flat = math.hypot(x, y)
    side_area, cap_area = 2.0 * radius_m * height_m * flat, math.pi * radius_m**2 * abs(z)
    side = side_area / (side_area + cap_area)
    # Seen from straight below or above the cap is all there is, and the horizontal direction no matter.
    inward = 0.25 * math.pi * radius_m / max(flat, 1e-9)
    downward = math.copysign(0.5 * height_m, z)
    return np.array([-side * inward * x, -side * inward * y, -(1.0 - side) * downward])


def outline_m(settings: TrackingSettings) -> tuple[float, float]:
    """Return half the width and half the height of everything that may belong to a body."""
    return settings.body_radius_m + _BEYOND_M[0], 0.5 * settings.body_height_m + _BEYOND_M[1]


def whole_body_points(range_m: float, settings: TrackingSettings) -> float:
    """Return how many points of one scan a body shows of itself, on average."""
    outline = 2.0 * settings.body_radius_m * settings.body_height_m
    return settings.points_per_steradian * outline / range_m**2
