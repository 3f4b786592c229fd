"""What a laser scanner sees of an upright cylinder: the model of another UAV's body."""

import math

import numpy as np

from companion.messages import FloatArray


def visible_surface(
    direction_map: FloatArray, radius_m: float, height_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean (3,) and covariance (3, 3) of the visible points of a body about its centre.

    Beams from afar hit the half of the side and the cap that face the sensor, evenly over the outline
    they present.

    Args:
        direction_map: (3,) from the sensor to the body, any length above 0.
        radius_m: of the upright cylinder.
        height_m: of the upright cylinder.
    """
    x, y, z = (direction_map / np.linalg.norm(direction_map)).tolist()
    flat = math.hypot(x, y)
    # Seen from straight below or above the cap is all there is; any horizontal direction will do.
    along = np.array([x / flat, y / flat, 0.0]) if flat > 1e-9 else np.array([1.0, 0.0, 0.0])
    across = np.array([-along[1], along[0], 0.0])
    up = np.array([0.0, 0.0, 1.0])
    side_area, cap_area = 2.0 * radius_m * height_m * flat, math.pi * radius_m**2 * abs(z)
    side = side_area / (side_area + cap_area)
    side_mean = -0.25 * math.pi * radius_m * along
    cap_mean = -math.copysign(0.5 * height_m, z) * up
    mean = side * side_mean + (1.0 - side) * cap_mean
    side_covariance = (
        radius_m**2 * (2.0 / 3.0 - math.pi**2 / 16.0) * np.outer(along, along)
        + radius_m**2 / 3.0 * np.outer(across, across)
        + height_m**2 / 12.0 * np.outer(up, up)
    )
    cap_covariance = 0.25 * radius_m**2 * (np.outer(along, along) + np.outer(across, across))
    between = np.outer(side_mean - cap_mean, side_mean - cap_mean)
    covariance = side * side_covariance + (1.0 - side) * cap_covariance + side * (1.0 - side) * between
    return mean, covariance
