"""What running rotors add to an inertial chip: broadband shaking and rotor harmonics."""

import math

import numpy as np
from numpy.random import Generator
from pydantic import Field

from companion.messages import FloatArray
from companion.settings import Settings
from sitl.sensors.imu_kernels import shake, turn_rotors

_ROTORS = 4
_HARMONIC_AMPLITUDES = np.array([1.0, 0.5])
_HOVER_THRUST = 9.81


class VibrationSettings(Settings):
    """Vibration in hover; it grows with the thrust."""

    accel_rms_mps2: float = Field(default=0.5, ge=0.0, le=50.0)
    """Root mean square of each acceleration component in hover."""
    gyro_rms_radps: float = Field(default=0.01, ge=0.0, le=5.0)
    """Root mean square of each rate component in hover."""
    harmonic_share: float = Field(default=0.5, ge=0.0, le=1.0)
    """Share of the power in rotor harmonics; the rest is broadband."""
    rotor_hover_hz: float = Field(default=95.0, gt=0.0, le=1000.0)
    """Turns of a rotor per second in hover."""
    rotor_spread: float = Field(default=0.03, ge=0.0, le=0.5)
    """Rotors differ in speed by up to plus or minus this share."""


class Vibration:
    """Vibration of one vehicle at its inertial chip.

    Each rotor shakes the chip in a direction of its own at its speed and at twice that. Sampling at
    200 Hz folds these tones to low frequencies, as it does on a real chip without a steep filter.
    """

    def __init__(self, rng: Generator, settings: VibrationSettings) -> None:
        """Draw the rotors' speeds, phases and directions."""
        self._rng = rng
        self._settings = settings
        self._speed_ratio = 1.0 + settings.rotor_spread * rng.uniform(-1.0, 1.0, _ROTORS)
        self._turns = rng.uniform(0.0, 1.0, _ROTORS)
        self._offsets = rng.uniform(0.0, 1.0, (_ROTORS, 2))
        mixing = rng.standard_normal((6, _ROTORS, 2)) * _HARMONIC_AMPLITUDES
        # A sine of amplitude a has the power a^2 / 2; every component gets unit power in total.
        power = 0.5 * np.sum(mixing**2, axis=(1, 2), keepdims=True)
        self._mixing = (mixing / np.sqrt(power)).reshape(6, -1)
        self._phases = np.empty((_ROTORS, 2))
        self._rms = np.repeat([settings.gyro_rms_radps, settings.accel_rms_mps2], 3)

    def step(self, step_s: float, thrust: float) -> FloatArray:
        """Return the vibration (6,), rates in rad/s, then accelerations in m/s^2, after `step_s`.

        Args:
            step_s: time since the last call, s.
            thrust: of all rotors by vehicle mass, m/s^2. Rotor speed goes with its root, vibration with
                the thrust itself.
        """
        level = max(thrust, 0.0) / _HOVER_THRUST
        settings = self._settings
        rotor_hz = settings.rotor_hover_hz * math.sqrt(level) * self._speed_ratio
        turn_rotors(float(step_s), rotor_hz, self._turns, self._offsets, self._phases)
        vibration = np.empty(6)
        shake(
            level, settings.harmonic_share, self._mixing, np.sin(self._phases), self._rms,
            self._rng.standard_normal(6), vibration,
        )  # fmt: skip
        return vibration
