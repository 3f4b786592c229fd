"""The shape of a UAV as others see it: hull with tape, arms, rotors, legs and its own LiDAR."""

import math

import numpy as np
from pydantic import Field

from companion.messages import FloatArray
from companion.settings import Settings
from sitl.worlds.bodies import Body
from sitl.worlds.primitives import Box, Capsule, Cylinder, Primitive, Vector

_TAPE_LIFT_M = 0.001


class UavBodySettings(Settings):
    """Size and surface of one UAV, about the origin of its body frame."""

    hull_size_m: Vector = (0.18, 0.18, 0.08)
    """Length, width and height of the hull. With all that sticks out of it a UAV returns, on average over
    all headings, as many points as a plate of 250 x 120 mm: about 11.7 a scan at 3 m."""
    hull_reflectivity: float = Field(default=0.1, ge=0.0, le=1.0)
    """Diffuse reflectivity of hull, arms, legs and rotors (dark plastic and carbon)."""
    wheelbase_m: float = Field(default=0.35, gt=0.0, le=2.0)
    """Distance of rotor hubs that face each other across the hull."""
    rotor_diameter_m: float = Field(default=0.13, gt=0.0, le=1.0)
    """Diameter of a rotor; only its two blades reflect, so most rays pass the disc."""
    leg_length_m: float = Field(default=0.06, gt=0.0, le=1.0)
    """Length of the four legs below the hull."""
    tape: bool = True
    """Retro-reflective tape on all sides of the hull: a band around its four sides and a strip over its
    top, front, bottom and back."""
    tape_width_m: float = Field(default=0.05, gt=0.0, le=0.12)
    """Width of band and strip."""
    tape_strength: float = Field(default=0.8, ge=0.0, le=1.0)
    """Strength of the tape's return, see `Surface.reflectivity`."""


def uav_body(settings: UavBodySettings) -> Body:
    """Return the body of one UAV."""
    length, width, height = settings.hull_size_m
    dark = settings.hull_reflectivity
    parts: list[Primitive] = [
        Box(centre_world_m=(0.0, 0.0, 0.0), size_m=settings.hull_size_m, reflectivity=dark),
        Cylinder(
            start_world_m=(0.0, 0.0, 0.5 * height),
            end_world_m=(0.0, 0.0, 0.5 * height + 0.055),
            radius_m=0.032,
            reflectivity=dark,
        ),
    ]
    if settings.tape:
        band, lift = settings.tape_width_m, 2.0 * _TAPE_LIFT_M
        sizes = [(length + lift, width + lift, band), (length + lift, band, height + lift)]
        parts += [
            Box(
                centre_world_m=(0.0, 0.0, 0.0),
                size_m=size,
                reflectivity=settings.tape_strength,
                retro_reflective=True,
            )
            for size in sizes
        ]
    corners = 0.5 * settings.wheelbase_m * math.sqrt(0.5) * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    parts += [
        Capsule(
            start_world_m=_point(corners[k, 0], corners[k, 1], 0.0),
            end_world_m=_point(corners[k + 2, 0], corners[k + 2, 1], 0.0),
            radius_m=0.01,
            reflectivity=dark,
        )
        for k in range(2)
    ]
    legs = 0.5 * np.array([length, width]) - 0.02
    for x, y in legs * np.sign(corners):
        top, foot = _point(x, y, -0.5 * height), _point(x, y, -0.5 * height - settings.leg_length_m)
        parts.append(Cylinder(start_world_m=top, end_world_m=foot, radius_m=0.006, reflectivity=dark))
    first_blade = len(parts)
    blade = 0.5 * settings.rotor_diameter_m - 0.003
    for k, (x, y) in enumerate(corners):
        # Rotors start at different angles, so that they never all show their ends at once.
        along = blade * np.array([math.cos(0.8 * k), math.sin(0.8 * k)])
        parts.append(
            Capsule(
                start_world_m=_point(x - along[0], y - along[1], 0.03),
                end_world_m=_point(x + along[0], y + along[1], 0.03),
                radius_m=0.003,
                reflectivity=dark,
            )
        )
    return Body.of(parts, spinning=range(first_blade, len(parts)))


def _point(x: float, y: float, z: float) -> tuple[float, float, float]:
    return float(x), float(y), float(z)


def rotor_turns(rotor_hz: FloatArray | float, t_s: float) -> FloatArray:
    """Return the angles (b,) of the blades, rad, after turning at a constant rate for `t_s`."""
    return np.asarray(2.0 * math.pi * np.mod(np.asarray(rotor_hz, np.float64) * t_s, 1.0))
