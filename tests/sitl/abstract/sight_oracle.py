"""Who sees whom, the slow and readable way: every ray against the whole world."""

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.abstract.settings import PerceptionSettings
from sitl.worlds.primitives import Sphere, World


def is_seen(world: World, p: FloatArray, q: FloatArray, i: int, j: int, settings: PerceptionSettings) -> bool:
    """Return whether vehicle i sees vehicle j among vehicles at p (n, 3) with attitudes q (n, 4)."""
    line = p[j] - p[i]
    distance = float(np.linalg.norm(line))
    if distance > settings.range_m:
        return False
    line_body = rotation.rotate(rotation.conjugate(q[i]), line)
    elevation = np.degrees(np.arcsin(line_body[2] / distance))
    if not settings.lowest_elevation_deg <= elevation <= settings.highest_elevation_deg:
        return False
    across = np.cross([0.0, 0.0, 1.0], line)
    across /= np.linalg.norm(across)
    above = np.cross(line, across) / distance
    radius = settings.body_radius_m
    targets = p[j] + radius * np.array([0 * line, across, -across, above, -above])
    others = [k for k in range(len(p)) if k not in (i, j)]
    balls = World.of([Sphere(centre_world_m=(p[k, 0], p[k, 1], p[k, 2]), radius_m=radius) for k in others])
    everything = world.obstacles().joined(balls)
    rays = targets - p[i]
    lengths = np.linalg.norm(rays, axis=1)
    hits = everything.cast(np.broadcast_to(p[i], (5, 3)), rays / lengths[:, None], 1e3).ranges
    return int(np.sum(hits >= lengths)) >= settings.free_rays
