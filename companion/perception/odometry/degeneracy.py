"""Directions in which a scan does not say where the sensor is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray

_AXIS_COSINE = 0.94  # within 20 degrees of an axis it is called by that axis
_LEVEL_SINE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """How well a scan's residuals fix the six directions of the pose.

    Attributes:
        shares: (6,) eigenvalues of the scaled information over the total weight, ascending; a share of
            0.1 means that a tenth of the scan's weight observes that direction.
        directions: (6, 6) columns, rotation entries scaled by `lever_m`.
        lever_m: root mean square lever arm that makes rotations comparable with translations.
        kept: (6,) which directions correct the state.
    """

    shares: FloatArray
    directions: FloatArray
    lever_m: float
    kept: NDArray[np.bool_]

    @property
    def degenerate(self) -> int:
        """Number of directions left to the IMU."""
        return int(6 - self.kept.sum())


def keep_observed(
    information: FloatArray, gradient: FloatArray, weight: float, lever_square: float, least_share: float
) -> tuple[FloatArray, FloatArray, Observability]:
    """Remove from the normal equations what is not observed.

    In a corridor or over an empty field some directions receive only the noise of the normals; taking
    that for a measurement corrupts the state. Source: J. Zhang, M. Kaess, S. Singh, "On degeneracy of
    optimization-based state estimation problems", 2016 (solution remapping), applied to the
    measurement instead of the solution so that the IMU still decides those directions.

    Args:
        information: (6, 6) H' W H for position and rotation.
        gradient: (6,) -H' W r.
        weight: sum of the weights.
        lever_square: weighted sum of squared lever arms |x cross n|^2, m^2.
        least_share: smallest share of the weight that counts as observation.

    Returns:
        The (6, 6) information and (6,) gradient that remain, and what was found.
    """
    lever_m = float(np.sqrt(max(lever_square, 1e-9) / max(weight, 1e-9)))
    scale = np.array([1.0, 1.0, 1.0, 1.0 / lever_m, 1.0 / lever_m, 1.0 / lever_m])
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    shares = np.maximum(values, 0.0) / max(weight, 1e-9)
    kept = shares >= least_share
    found = Observability(shares, vectors, lever_m, kept)
    if kept.all():
        return information, gradient, found
    projection = vectors[:, kept] @ vectors[:, kept].T
    inverse = 1.0 / scale
    remaining = projection @ (information * np.outer(scale, scale)) @ projection
    return (
        remaining * np.outer(inverse, inverse),
        (projection @ (gradient * scale)) * inverse,
        found,
    )


def weak_directions(observability: Observability, R_map_imu: FloatArray) -> list[str]:
    """Name the directions left to the IMU: "along x of the map", "about z of the map" and so on.

    Args:
        observability: what a scan observed; its rotations are about the sensor's axes.
        R_map_imu: (3, 3) attitude, to name rotations by the map's axes too.
    """
    names = []
    for direction in observability.directions[:, ~observability.kept].T:
        along, about = direction[:3], R_map_imu @ direction[3:]
        shift = float(np.linalg.norm(along)) >= float(np.linalg.norm(about))
        names.append(f"{'along' if shift else 'about'} {_axis_name(along if shift else about)}")
    return names


def _axis_name(direction: FloatArray) -> str:
    """Name the nearest axis of the map, or the heading of what lies between x and y."""
    share = np.abs(direction) / max(float(np.linalg.norm(direction)), 1e-12)
    if float(share.max()) > _AXIS_COSINE or float(share[2]) > _LEVEL_SINE:
        return f"{'xyz'[int(np.argmax(share))]} of the map"
    heading = np.degrees(np.arctan2(direction[1], direction[0])) % 180.0
    return f"{heading:.0f} deg of the map"
