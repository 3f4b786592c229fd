"""Where the Mid-360's beams go, and the chances and deviations of their measurements.

Every random number is a hash of (seed, slot, purpose), so a slot's noise depends neither on how the
slots are divided into calls nor on the world around it.
"""

import math

import numpy as np

from companion.compiled import compiled, inlined
from companion.messages import FloatArray
from sitl.sensors.scan_kernels import FIRING_PERIOD_NS, LINES

# Order of the numbers in the parameter array; see `Mid360Settings.packed`.
RANGE_NOISE_SCALE = 0
ANGLE_NOISE_RAD = 1
RANGE_AT_TENTH_M = 2
RANGE_EXPONENT = 3
MIN_RANGE_M = 4
PULSE_LENGTH_M = 5
EDGE_GAP_M = 6
SPURIOUS_PROBABILITY = 7
TAG_SCALE = 8
BLANKING = 9
RETRO_HALF_RANGE_M = 10
RETRO_CUTOFF_RAD = 11
HALO_PROBABILITY = 12
HALO_SHARE = 13
GHOST_PROBABILITY = 14
FOOTPRINT_RAD = 15
HALO_RAD = 16
MIRROR_PROBABILITY = 17
MAX_RANGE_M = 18
N_PARAMETERS = 19

# Purposes of random numbers; a pair of normal deviates takes two.
_FOOTPRINT_RADIUS = 0
_FOOTPRINT_ANGLE = 1
POINTING = 2
RANGING = 4
DETECTION = 6
EDGE_SHARE = 7
TAG = 8
NEAR = 9
SPURIOUS = 10
SPURIOUS_RANGE = 11
_HALO = 12
GHOST = 13
MIRROR = 14

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MULTIPLIER_1 = np.uint64(0xBF58476D1CE4E5B9)
_MULTIPLIER_2 = np.uint64(0x94D049BB133111EB)
_PURPOSES = np.uint64(16)


@inlined
def uniform_of(seed: int, slot: int, purpose: int) -> float:
    """Return a number above 0 and below 1: SplitMix64's scrambling of a counter.

    Source: G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", 2014.
    """
    counter = np.uint64(slot) * _PURPOSES + np.uint64(purpose) + np.uint64(1)
    z = np.uint64(seed) + counter * _GOLDEN
    z = (z ^ (z >> np.uint64(30))) * _MULTIPLIER_1
    z = (z ^ (z >> np.uint64(27))) * _MULTIPLIER_2
    z = z ^ (z >> np.uint64(31))
    fraction: float = (float(z >> np.uint64(12)) + 0.5) / 4503599627370496.0
    return fraction


@inlined
def normals_of(seed: int, slot: int, purpose: int) -> tuple[float, float]:
    """Return two independent standard normal deviates (Box and Muller)."""
    radius = math.sqrt(-2.0 * math.log(uniform_of(seed, slot, purpose)))
    angle = 2.0 * math.pi * uniform_of(seed, slot, purpose + 1)
    return radius * math.cos(angle), radius * math.sin(angle)


@inlined
def in_halo(seed: int, slot: int, probability: float) -> bool:
    """Return whether a slot's second sample lies in the faint light around its beam."""
    return probability > 0.0 and uniform_of(seed, slot, _HALO) < probability


@inlined
def range_sigma(distance: float, cosine: float) -> float:
    """Return the standard deviation of a range, metres, by distance and cosine of incidence."""
    return math.hypot(0.0034, 0.00073 * distance) / math.pow(max(cosine, 0.05), 0.78)


@inlined
def incidence_probability(cosine: float) -> float:
    """Return the chance that a surface at this cosine of incidence sends enough light back."""
    if cosine >= 0.20791169:
        return 1.0
    angle = math.degrees(math.acos(cosine))
    if angle < 79.5:
        return 1.0 - (angle - 78.0) * (0.24 / 1.5)
    if angle < 82.5:
        return 0.76 - (angle - 79.5) * (0.26 / 3.0)
    if angle < 85.0:
        return 0.5 - (angle - 82.5) * (0.28 / 2.5)
    if angle < 88.0:
        return 0.22 - (angle - 85.0) * (0.14 / 3.0)
    return max(0.08 - (angle - 88.0) * 0.04, 0.0)


@inlined
def distance_probability(distance: float, reflectivity: float, at_tenth: float, exponent: float) -> float:
    """Return the chance to detect a surface of this effective reflectivity at this distance.

    One half at the nominal range ``at_tenth * (reflectivity / 0.1) ** exponent``, falling from 1 to 0
    between 90 % and 110 % of it.
    """
    if reflectivity <= 0.0:
        return 0.0
    # No root of a number below 1 is smaller than the number: most returns need none.
    if 0.0 <= exponent <= 1.0 and distance < 0.85 * at_tenth * min(10.0 * reflectivity, 1.0):
        return 1.0
    limit = at_tenth * math.pow(reflectivity * 10.0, exponent)
    return min(max((1.1 - distance / limit) * 5.0, 0.0), 1.0)


@inlined
def blanking_probability(distance: float) -> float:
    """Return the chance that a return from this near costs the line its next firing."""
    if distance < 0.55:
        return 1.0
    if distance < 0.66:
        return 1.0 - (distance - 0.55) * (0.57 / 0.11)
    if distance < 0.71:
        return 0.43 - (distance - 0.66) * (0.28 / 0.05)
    if distance < 0.76:
        return 0.15 - (distance - 0.71) * (0.09 / 0.05)
    if distance < 0.81:
        return 0.06 - (distance - 0.76) * (0.05 / 0.05)
    return max(0.01 - (distance - 0.81) * (0.01 / 0.08), 0.0)


@inlined
def clutter_tag(u: float, scale: float) -> int:
    """Return the tag of an ordinary return; the shares are those of an indoor recording, edges apart."""
    u = u / max(scale, 1e-12)
    if u < 0.0046:
        return 16
    if u < 0.0086:
        return 4
    if u < 0.0116:
        return 1
    if u < 0.0126:
        return 2
    if u < 0.0132:
        return 8
    return 32 if u < 0.0135 else 0


@compiled(
    "void(int64, int64, float64, float64, float64, int64[::1], float64[:, ::1], float64[:, ::1], "
    "float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])"
)
def place_beams(
    seed: int,
    first_slot: int,
    footprint_rad: float,
    halo_rad: float,
    halo_probability: float,
    times_ns: np.ndarray[tuple[int], np.dtype[np.int64]],
    p_world: FloatArray,
    q_world_lidar: FloatArray,
    directions_lidar: FloatArray,
    origins: FloatArray,
    directions: FloatArray,
    rims: FloatArray,
) -> None:
    """Move beams to where the sensor was at the instant of each firing.

    Args:
        seed: of the footprint's second sample.
        first_slot: index of the first slot.
        footprint_rad: half width of a beam.
        halo_rad: half width of the faint light around it.
        halo_probability: chance that the second sample of a beam lies in that faint light.
        times_ns: (k,) increasing times that cover all firings.
        p_world: (k, 3) positions of the sensor.
        q_world_lidar: (k, 4) its attitudes.
        directions_lidar: (n, 3) unit directions in the lidar frame.
        origins: (n, 3) out.
        directions: (n, 3) out, axis of each beam.
        rims: (n, 3) out, a random direction within the beam or around it.
    """
    k = 0
    last_firing = -1
    R = np.empty((3, 3))
    x, y, z = 0.0, 0.0, 0.0
    for i in range(directions_lidar.shape[0]):
        slot = first_slot + i
        firing = slot // LINES
        if firing != last_firing:
            last_firing = firing
            t = firing * FIRING_PERIOD_NS
            while k + 2 < times_ns.shape[0] and times_ns[k + 1] < t:
                k += 1
            f = (t - times_ns[k]) / (times_ns[k + 1] - times_ns[k])
            x = p_world[k, 0] + f * (p_world[k + 1, 0] - p_world[k, 0])
            y = p_world[k, 1] + f * (p_world[k + 1, 1] - p_world[k, 1])
            z = p_world[k, 2] + f * (p_world[k + 1, 2] - p_world[k, 2])
            agreement = 0.0
            for j in range(4):
                agreement += q_world_lidar[k, j] * q_world_lidar[k + 1, j]
            g = math.copysign(f, agreement)
            qw = (1.0 - f) * q_world_lidar[k, 0] + g * q_world_lidar[k + 1, 0]
            qx = (1.0 - f) * q_world_lidar[k, 1] + g * q_world_lidar[k + 1, 1]
            qy = (1.0 - f) * q_world_lidar[k, 2] + g * q_world_lidar[k + 1, 2]
            qz = (1.0 - f) * q_world_lidar[k, 3] + g * q_world_lidar[k + 1, 3]
            # Linear interpolation is straight enough: steps turn by a few hundredths of a radian.
            s = 2.0 / (qw * qw + qx * qx + qy * qy + qz * qz)
            R[0, 0], R[0, 1] = 1.0 - s * (qy * qy + qz * qz), s * (qx * qy - qw * qz)
            R[0, 2], R[1, 0] = s * (qx * qz + qw * qy), s * (qx * qy + qw * qz)
            R[1, 1], R[1, 2] = 1.0 - s * (qx * qx + qz * qz), s * (qy * qz - qw * qx)
            R[2, 0], R[2, 1] = s * (qx * qz - qw * qy), s * (qy * qz + qw * qx)
            R[2, 2] = 1.0 - s * (qx * qx + qy * qy)
        lx, ly, lz = directions_lidar[i, 0], directions_lidar[i, 1], directions_lidar[i, 2]
        radius = math.sqrt(uniform_of(seed, slot, _FOOTPRINT_RADIUS))
        radius *= halo_rad if in_halo(seed, slot, halo_probability) else footprint_rad
        angle = 2.0 * math.pi * uniform_of(seed, slot, _FOOTPRINT_ANGLE)
        tx, ty, tz = turned(lx, ly, lz, radius * math.cos(angle), radius * math.sin(angle))
        for j in range(3):
            directions[i, j] = R[j, 0] * lx + R[j, 1] * ly + R[j, 2] * lz
            rims[i, j] = R[j, 0] * tx + R[j, 1] * ty + R[j, 2] * tz
        origins[i, 0], origins[i, 1], origins[i, 2] = x, y, z


@inlined
def turned(x: float, y: float, z: float, left: float, up: float) -> tuple[float, float, float]:
    """Return a unit direction turned by small angles to the left and up."""
    flat = max(math.sqrt(x * x + y * y), 1e-9)
    tx = x - left * y / flat - up * z * x / flat
    ty = y + left * x / flat - up * z * y / flat
    tz = z + up * flat
    scale = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
    return tx * scale, ty * scale, tz * scale
