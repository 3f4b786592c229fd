"""A smooth flight with known derivatives, for measuring what follows it."""

import math

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.vehicle_truth import VehicleTruth

_GRAVITY = 9.81
_H = 1e-3


def truth_at(t_ns: int) -> VehicleTruth:
    """A tilted figure of eight at up to 2 m/s that begins smoothly after two seconds of standing."""
    t = t_ns * 1e-9 - 2.0
    p, before, after = _path(t), _path(t - _H), _path(t + _H)
    v, a = (after - before) / (2 * _H), (after - 2 * p + before) / (_H * _H)
    turn = rotation.multiply(rotation.conjugate(_attitude(t - _H)), _attitude(t + _H))
    return VehicleTruth(t_ns, p, v, _attitude(t), rotation.log(turn) / (2 * _H), a, bool(p[2] < 0.01))


def _path(t: float) -> FloatArray:
    swell = 1.0 / (1.0 + math.exp(-(t - 5.0) / 0.7)) if t > -30.0 else 0.0
    phase = 0.45 * t
    return swell * np.array(
        [4.0 * math.sin(phase), 1.9 * math.sin(2.0 * phase), 2.0 + 0.3 * math.sin(0.7 * t)]
    )


def _attitude(t: float) -> FloatArray:
    h = 1e-2
    accel = (_path(t + h) - 2.0 * _path(t) + _path(t - h)) / (h * h)
    up = accel + np.array([0.0, 0.0, _GRAVITY])
    up /= np.linalg.norm(up)
    tilt = np.array([1.0 + up[2], -up[1], up[0], 0.0])
    return rotation.multiply(rotation.normalize(tilt), rotation.from_yaw(0.4 * math.sin(0.3 * t)))
