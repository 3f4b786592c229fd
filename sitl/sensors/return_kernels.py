"""What the Mid-360 reports of what its beams hit: strength, mixed points, misses, ghosts, tags, blanking.

Strengths are relative to white paper of 100 % that is met squarely. See `sitl.sensors.mid360_settings` for
the sources.
"""

import math

import numpy as np

from companion.compiled import compiled, inlined
from companion.messages import ByteArray, FloatArray
from sitl.sensors import ranging_kernels as ranging
from sitl.sensors.ranging_kernels import normals_of, uniform_of
from sitl.sensors.scan_kernels import LINES
from sitl.worlds.raycast_kernels import PLANE

MIRROR_COSINE_MAX = 0.5
_MIRROR_SHARE = 0.0025
"""Of the light, left after being mirrored on the way there and on the way back: 5 % each."""

_RETRO_DECADES = 3.0
_RETRO_FACE = 0.3
_SHARP_PER_RAD = 0.16 * 180.0 / math.pi
_MIXED_SHARE = 0.02
_HALO_STRENGTH_MIN = 0.02
"""Weaker stray light is lost in the noise: diffuse surfaces have no halo."""
_GHOST_STRENGTH_MIN = 10.0
_SPURIOUS_REACH_M = 10.0


@inlined
def strength_of(
    retro: int, reflectivity: float, cosine: float, distance: float, half_range: float, cutoff: float
) -> float:
    """Return how strongly a surface answers.

    A retro-reflector of reflectivity r has a gain of 1000 to the power of r when met squarely from near,
    and a white face below it.
    """
    if not retro:
        return reflectivity * cosine
    far = distance / half_range
    gain = math.pow(10.0, _RETRO_DECADES * reflectivity) * math.pow(cosine, 6.0) / (1.0 + far * far)
    beyond = math.acos(cosine) - cutoff
    if beyond > 0.0:
        gain *= math.pow(10.0, -_SHARP_PER_RAD * beyond)
    return gain + _RETRO_FACE * cosine


@inlined
def reported_reflectivity(strength: float, noise: float) -> int:
    """Return the number reported for a strength, with a standard normal deviate of noise."""
    if strength > 1.0:
        value = 150.0 + 105.0 / _RETRO_DECADES * math.log10(strength) + 5.0 * noise
        return int(min(max(value, 151.0), 255.0))
    return int(min(max(150.0 * strength + 3.0 * noise + 0.5, 0.0), 150.0))


@compiled(
    "int64(int64, int64, float64, float64[:, ::1], float64[:, ::1], int32[::1], float64[::1], int32[::1], "
    "float64[::1], float64[:, ::1], float64[:, ::1], int64[::1])"
)
def find_mirrors(
    seed: int,
    first_slot: int,
    probability: float,
    origins: FloatArray,
    axes: FloatArray,
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    ranges: FloatArray,
    indices: np.ndarray[tuple[int], np.dtype[np.int32]],
    cosines: FloatArray,
    points: FloatArray,
    directions: FloatArray,
    numbers: np.ndarray[tuple[int], np.dtype[np.int64]],
) -> int:
    """Write where and whither the ground mirrors beams that graze it, and which; return how many.

    Args:
        seed: of all noise.
        first_slot: index of the first slot.
        probability: that the ground mirrors.
        origins: (n, 3) of the beams.
        axes: (n, 3) their directions.
        kinds: (m,) of the primitives.
        ranges: (n,) of the beams' axes.
        indices: (n,) primitives they hit.
        cosines: (n,) cosines of incidence.
        points: (n, 3) out, on the ground.
        directions: (n, 3) out, mirrored.
        numbers: (n,) out, of the beams.
    """
    count = 0
    for i in range(ranges.shape[0]):
        if indices[i] < 0 or kinds[indices[i]] != PLANE or cosines[i] > MIRROR_COSINE_MAX:
            continue
        if uniform_of(seed, first_slot + i, ranging.MIRROR) >= probability:
            continue
        for j in range(3):
            points[count, j] = origins[i, j] + ranges[i] * axes[i, j]
            directions[count, j] = axes[i, j]
        directions[count, 2] = -axes[i, 2]
        numbers[count] = i
        count += 1
    return count


@compiled(
    "void(int64, int64, float64[::1], float64[:, ::1], float64[::1], int32[::1], float64[::1], "
    "float64[::1], int32[::1], float64[::1], float64[::1], int32[::1], float64[::1], float64[::1], "
    "uint8[::1], uint8[::1], float64[:, ::1], uint8[::1], uint8[::1], int32[::1])"
)
def form_returns(
    seed: int,
    first_slot: int,
    parameters: FloatArray,
    directions_lidar: FloatArray,
    ranges: FloatArray,
    indices: np.ndarray[tuple[int], np.dtype[np.int32]],
    cosines: FloatArray,
    mirrored_ranges: FloatArray,
    mirrored_indices: np.ndarray[tuple[int], np.dtype[np.int32]],
    mirrored_cosines: FloatArray,
    rim_ranges: FloatArray,
    rim_indices: np.ndarray[tuple[int], np.dtype[np.int32]],
    rim_cosines: FloatArray,
    reflectivities: FloatArray,
    retro_reflective: ByteArray,
    blanked: ByteArray,
    points_lidar: FloatArray,
    reflectivity: ByteArray,
    tags: ByteArray,
    sources: np.ndarray[tuple[int], np.dtype[np.int32]],
) -> None:
    """Turn hits into reported slots.

    Args:
        seed: of all noise.
        first_slot: index of the first slot.
        parameters: (N_PARAMETERS,) of the model.
        directions_lidar: (n, 3) nominal directions.
        ranges: (n,) of the beams' axes, infinity without a hit.
        indices: (n,) primitives they hit.
        cosines: (n,) cosines of incidence.
        mirrored_ranges: (n,) of what the ground mirrors, along the whole way.
        mirrored_indices: (n,) primitives hit after mirroring, -1 for none.
        mirrored_cosines: (n,) cosines of incidence there.
        rim_ranges: (n,) of the second sample of each beam.
        rim_indices: (n,) primitives it hit.
        rim_cosines: (n,) cosines of incidence there.
        reflectivities: (m,) of the primitives.
        retro_reflective: (m,) 1 for retro-reflectors.
        blanked: (4,) in and out, lines whose next firing is lost.
        points_lidar: (n, 3) out, zero without a return.
        reflectivity: (n,) out.
        tags: (n,) out.
        sources: (n,) out, primitive that each return came from, -1 without one and for ghosts.
    """
    half_range, cutoff = parameters[ranging.RETRO_HALF_RANGE_M], parameters[ranging.RETRO_CUTOFF_RAD]
    edge_gap = parameters[ranging.EDGE_GAP_M]
    for i in range(ranges.shape[0]):
        slot = first_slot + i
        line = slot % LINES
        points_lidar[i, 0], points_lidar[i, 1], points_lidar[i, 2] = 0.0, 0.0, 0.0
        reflectivity[i], tags[i], sources[i] = 0, 0, -1
        if blanked[line]:
            blanked[line] = 0
            continue
        distance, hit, cosine, strength, tag = ranges[i], indices[i], cosines[i], 0.0, 0
        if hit >= 0:
            strength = strength_of(
                retro_reflective[hit], reflectivities[hit], cosine, distance, half_range, cutoff
            )
        rim = rim_indices[i]
        if rim != hit:
            # The beam straddles an edge: part of its light goes to the other surface, or to none.
            u = uniform_of(seed, slot, ranging.EDGE_SHARE)
            share = u if hit >= 0 and rim >= 0 else 0.5 * u
            other = 0.0
            if rim >= 0:
                other = strength_of(
                    retro_reflective[rim],
                    reflectivities[rim],
                    rim_cosines[i],
                    rim_ranges[i],
                    half_range,
                    cutoff,
                )
            if ranging.in_halo(seed, slot, parameters[ranging.HALO_PROBABILITY]):
                share = u * parameters[ranging.HALO_SHARE]
                if share * other < _HALO_STRENGTH_MIN:
                    other = 0.0
            strength, other = (1.0 - share) * strength, share * other
            gap = abs(rim_ranges[i] - ranges[i])
            nearest = ranges[i]
            if other > strength:
                distance, hit, cosine = rim_ranges[i], rim, rim_cosines[i]
            if gap <= edge_gap:
                distance, strength = nearest, strength + other
            elif gap < parameters[ranging.PULSE_LENGTH_M]:
                weight = other / max(strength + other, 1e-12)
                distance = (1.0 - weight) * ranges[i] + weight * rim_ranges[i]
                strength += other
                if weight > _MIXED_SHARE and weight < 1.0 - _MIXED_SHARE:
                    tag = 2 if weight > 0.25 and weight < 0.75 else 1
            else:
                strength = max(strength, other)
        ghost = False
        image = mirrored_indices[i]
        if image >= 0 and retro_reflective[image]:
            mirrored = _MIRROR_SHARE * strength_of(
                1, reflectivities[image], mirrored_cosines[i], mirrored_ranges[i], half_range, cutoff
            )
            if mirrored > strength:
                distance, strength, cosine, ghost = mirrored_ranges[i], mirrored, mirrored_cosines[i], True
        detected = hit >= 0
        if detected:
            p = ranging.incidence_probability(cosine) * ranging.distance_probability(
                distance, strength, parameters[ranging.RANGE_AT_TENTH_M], parameters[ranging.RANGE_EXPONENT]
            )
            detected = uniform_of(seed, slot, ranging.DETECTION) < p
            if parameters[ranging.BLANKING] > 0.0 and distance < 0.9 and detected:
                blanked[line] = uniform_of(seed, slot, ranging.NEAR) < ranging.blanking_probability(distance)
            detected = detected and distance >= parameters[ranging.MIN_RANGE_M]
        spurious = uniform_of(seed, slot, ranging.SPURIOUS) < parameters[ranging.SPURIOUS_PROBABILITY]
        if spurious:
            reach = min(distance, _SPURIOUS_REACH_M)
            low = parameters[ranging.MIN_RANGE_M]
            distance = low + max(reach - low, 0.0) * uniform_of(seed, slot, ranging.SPURIOUS_RANGE)
        elif not detected:
            continue
        elif strength > _GHOST_STRENGTH_MIN and not ghost:
            u = uniform_of(seed, slot, ranging.GHOST)
            if u < parameters[ranging.GHOST_PROBABILITY]:
                distance, ghost = 2.0 * distance, True
                strength = 0.3 * u / parameters[ranging.GHOST_PROBABILITY]
        left, up = normals_of(seed, slot, ranging.POINTING)
        pointing = parameters[ranging.ANGLE_NOISE_RAD]
        tx, ty, tz = ranging.turned(
            directions_lidar[i, 0],
            directions_lidar[i, 1],
            directions_lidar[i, 2],
            pointing * left,
            pointing * up,
        )
        along, shade = normals_of(seed, slot, ranging.RANGING)
        if spurious:
            tags[i], reflectivity[i] = 32, int(min(abs(3.0 * shade) + 1.0, 20.0))
        else:
            sigma = ranging.range_sigma(distance, cosine)
            distance += parameters[ranging.RANGE_NOISE_SCALE] * sigma * along
            distance = max(distance, parameters[ranging.MIN_RANGE_M])
            if tag == 0:
                tag = ranging.clutter_tag(uniform_of(seed, slot, ranging.TAG), parameters[ranging.TAG_SCALE])
            tags[i] = tag
            reflectivity[i] = reported_reflectivity(strength, shade)
            if not ghost:
                sources[i] = hit
        points_lidar[i, 0], points_lidar[i, 1], points_lidar[i, 2] = (
            distance * tx,
            distance * ty,
            distance * tz,
        )
