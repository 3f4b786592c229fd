"""A Mid-360's measurement of many slots in one go: beams, what they hit, what is reported."""

import math

import numpy as np

from companion.compiled import compiled, inlined
from companion.messages import ByteArray, FloatArray
from sitl.sensors import ranging_kernels as ranging
from sitl.sensors.ranging_kernels import place_beams
from sitl.sensors.return_kernels import find_mirrors, form_returns
from sitl.worlds.casting_kernels import RAYS_PER_BATCH, cast_rays, list_candidates, nearest_hit

# Places in the working memory: vectors (VECTORS, n, 3), numbers (NUMBERS, n), marks (MARKS, n).
_ORIGIN, _AXIS, _RIM, _MIRROR_POINT, _MIRROR_AXIS = range(5)
VECTORS = 5
_RANGE, _COSINE, _RIM_RANGE, _RIM_COSINE, _IMAGE_RANGE, _IMAGE_COSINE, _BEYOND_RANGE, _BEYOND_COSINE = range(
    8
)
NUMBERS = 8
_RIM_INDEX, _IMAGE_INDEX, _BEYOND_INDEX = range(3)
MARKS = 3


@inlined
def _mounted(
    p_body: FloatArray,
    q_body: FloatArray,
    mount: FloatArray,
    p_sensor: FloatArray,
    q_sensor: FloatArray,
) -> None:
    """Write poses (k, 3), (k, 4) of the sensor that sits on a body at `mount`, position and attitude (7,)."""
    vx, vy, vz = mount[0], mount[1], mount[2]
    bw, bx, by, bz = mount[3], mount[4], mount[5], mount[6]
    for k in range(p_body.shape[0]):
        w, x, y, z = q_body[k, 0], q_body[k, 1], q_body[k, 2], q_body[k, 3]
        cx, cy, cz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
        p_sensor[k, 0] = p_body[k, 0] + (vx + w * cx + (y * cz - z * cy))
        p_sensor[k, 1] = p_body[k, 1] + (vy + w * cy + (z * cx - x * cz))
        p_sensor[k, 2] = p_body[k, 2] + (vz + w * cz + (x * cy - y * cx))
        q_sensor[k, 0] = w * bw - x * bx - y * by - z * bz
        q_sensor[k, 1] = w * bx + x * bw + y * bz - z * by
        q_sensor[k, 2] = w * by - x * bz + y * bw + z * bx
        q_sensor[k, 3] = w * bz + x * by - y * bx + z * bw


@compiled(
    "void(int64, int64, float64[::1], float64[::1], int64[::1], float64[:, ::1], float64[:, ::1], "
    "float64[:, ::1], int32[::1], float64[:, ::1], float64[:, ::1], int32[:, ::1], float64[:, ::1], "
    "float64[::1], uint8[::1], uint8[::1], float64[:, :, ::1], float64[:, ::1], int32[:, ::1], int64[::1], "
    "float64[:, ::1], uint8[::1], uint8[::1], int32[::1], int32[::1])"
)
def measure_slots(
    seed: int,
    first_slot: int,
    parameters: FloatArray,
    mount: FloatArray,
    times_ns: np.ndarray[tuple[int], np.dtype[np.int64]],
    p_body: FloatArray,
    q_body: FloatArray,
    directions_lidar: FloatArray,
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    rows: FloatArray,
    discs: FloatArray,
    bodies: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    poses: FloatArray,
    reflectivities: FloatArray,
    retro_reflective: ByteArray,
    blanked: ByteArray,
    vectors: FloatArray,
    numbers: FloatArray,
    marks: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    mirrors: np.ndarray[tuple[int], np.dtype[np.int64]],
    points_lidar: FloatArray,
    reflectivity: ByteArray,
    tags: ByteArray,
    aimed: np.ndarray[tuple[int], np.dtype[np.int32]],
    sources: np.ndarray[tuple[int], np.dtype[np.int32]],
) -> None:
    """Measure consecutive slots while a body moves.

    Args:
        seed: of all noise.
        first_slot: index of the first slot.
        parameters: (N_PARAMETERS,) of the model.
        mount: (7,) position and attitude of the sensor on the body.
        times_ns: (k,) increasing times that cover all firings.
        p_body: (k, 3) positions of the body, world.
        q_body: (k, 4) its attitudes.
        directions_lidar: (n, 3) unit directions in the lidar frame.
        kinds: of the world, as for `cast_rays`; so are the next four.
        rows: shapes of its primitives.
        discs: around its fixed ones.
        bodies: parts of those that move.
        poses: where they are.
        reflectivities: (m,) of its primitives.
        retro_reflective: (m,) 1 for retro-reflectors.
        blanked: (4,) in and out, lines whose next firing is lost.
        vectors: (VECTORS, n, 3) working memory.
        numbers: (NUMBERS, n) working memory.
        marks: (MARKS, n) working memory.
        mirrors: (n,) working memory.
        points_lidar: (n, 3) out, zero without a return.
        reflectivity: (n,) out.
        tags: (n,) out.
        aimed: (n,) out, primitive in the axis of each beam, -1 for none.
        sources: (n,) out, primitive that each return came from, -1 without one and for ghosts.
    """
    n, reach = directions_lidar.shape[0], parameters[ranging.MAX_RANGE_M]
    footprint, halo = parameters[ranging.FOOTPRINT_RAD], parameters[ranging.HALO_PROBABILITY]
    p_sensor, q_sensor = np.empty(p_body.shape), np.empty(q_body.shape)
    _mounted(p_body, q_body, mount, p_sensor, q_sensor)
    origins, axes, rims = vectors[_ORIGIN], vectors[_AXIS], vectors[_RIM]
    place_beams(
        seed, first_slot, footprint, parameters[ranging.HALO_RAD], halo, times_ns, p_sensor, q_sensor,
        directions_lidar, origins, axes, rims,
    )  # fmt: skip
    ranges, cosines = numbers[_RANGE], numbers[_COSINE]
    rim_ranges, rim_cosines, rim_indices = numbers[_RIM_RANGE], numbers[_RIM_COSINE], marks[_RIM_INDEX]
    has_width = footprint > 0.0 or halo > 0.0
    for start in range(0, n, RAYS_PER_BATCH):
        end = min(start + RAYS_PER_BATCH, n)
        gaps, offsets, candidates = list_candidates(origins, start, end, discs, poses, reach)
        for i in range(start, end):
            ranges[i], aimed[i], cosines[i] = nearest_hit(
                origins[i, 0], origins[i, 1], origins[i, 2], axes[i, 0], axes[i, 1], axes[i, 2],
                gaps, offsets, candidates, discs.shape[0], kinds, rows, bodies, poses, reach,
            )  # fmt: skip
            if has_width:
                rim_ranges[i], rim_indices[i], rim_cosines[i] = nearest_hit(
                    origins[i, 0], origins[i, 1], origins[i, 2], rims[i, 0], rims[i, 1], rims[i, 2],
                    gaps, offsets, candidates, discs.shape[0], kinds, rows, bodies, poses, reach,
                )  # fmt: skip
            else:
                rim_ranges[i], rim_indices[i], rim_cosines[i] = ranges[i], aimed[i], cosines[i]
    image_ranges, image_cosines, images = numbers[_IMAGE_RANGE], numbers[_IMAGE_COSINE], marks[_IMAGE_INDEX]
    image_ranges[:] = math.inf
    images[:] = -1
    image_cosines[:] = 0.0
    if parameters[ranging.MIRROR_PROBABILITY] > 0.0:
        points, directions = vectors[_MIRROR_POINT], vectors[_MIRROR_AXIS]
        count = find_mirrors(
            seed, first_slot, parameters[ranging.MIRROR_PROBABILITY], origins, axes,
            kinds, ranges, aimed, cosines, points, directions, mirrors,
        )  # fmt: skip
        if count > 0:
            beyond, slopes, things = numbers[_BEYOND_RANGE], numbers[_BEYOND_COSINE], marks[_BEYOND_INDEX]
            cast_rays(
                points[:count], directions[:count], kinds, rows, discs, bodies, poses, reach,
                beyond[:count], things[:count], slopes[:count],
            )  # fmt: skip
            for j in range(count):
                i = mirrors[j]
                image_ranges[i] = ranges[i] + beyond[j]
                images[i], image_cosines[i] = things[j], slopes[j]
    form_returns(
        seed, first_slot, parameters, directions_lidar, ranges, aimed, cosines,
        image_ranges, images, image_cosines, rim_ranges, rim_indices, rim_cosines,
        reflectivities, retro_reflective, blanked, points_lidar, reflectivity, tags, sources,
    )  # fmt: skip
