"""A triangle mesh as a world: cut into cubes where its surface is, and the cubes merged into boxes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.errors import ProfileError
from sitl.worlds.primitives import World
from sitl.worlds.surfaces import boxes, ground, together

MAX_BYTES = 256 * 1024 * 1024
MAX_CUBES = 2_000_000
MAX_BOXES = 50_000
FORMATS = (".ply", ".stl", ".obj", ".off", ".gltf", ".glb")
_CUBES_PER_FACE = 3.0
"""A tilted surface passes through this many cubes for each square of a cube's side, at most."""
_LOW_M = 0.3
"""What reaches no higher over the ground plane counts as ground."""


def mesh_world(path: Path, voxel_m: float, ground_m: float | None, reflectivity: float) -> World:
    """Read a mesh (z up, metres) as a world of boxes.

    Surfaces become as thick as the cubes they pass through. Walls stand where they stood, to within one
    cube; what is enclosed by them stays hollow.

    Args:
        path: PLY, STL, OBJ, OFF or glTF file.
        voxel_m: side of the cubes.
        ground_m: height of an endless ground plane that replaces what lies at most 0.3 m above it; without
            it, the mesh's own floor counts as an obstacle.
        reflectivity: of every surface.

    Raises:
        ProfileError: if the file is no mesh of reasonable size.
    """
    cubes, corner = _cubes(path, voxel_m)
    if ground_m is not None:
        tops = corner[2] + voxel_m * (cubes[:, 2] + 1)
        cubes = cubes[tops > ground_m + max(_LOW_M, voxel_m)]
    merged = merge_cubes(cubes)
    if len(merged) > MAX_BOXES:
        raise ProfileError(
            f"{path}: {len(merged)} boxes at a resolution of {voxel_m:g} m, at most {MAX_BOXES} are allowed; "
            "use larger cubes"
        )
    low, high = corner + voxel_m * merged[:, :3], corner + voxel_m * merged[:, 3:]
    solid = boxes(0.5 * (low + high), high - low, np.zeros(len(merged)), reflectivity)
    return solid if ground_m is None else together(ground(reflectivity, ground_m), solid)


def merge_cubes(cubes: ArrayLike) -> NDArray[np.int64]:
    """Merge unit cubes into fewer boxes that fill the same space without overlap.

    Runs along x first; then equal runs side by side along y; then equal sheets along z.

    Args:
        cubes: (n, 3) lowest corner of each, all different.

    Returns:
        (m, 6) lowest and highest corner of each box.
    """
    low = np.asarray(cubes, np.int64).reshape(-1, 3)
    merged = np.concatenate([low, low + 1], axis=1)
    for axis in range(3):
        others = [column for column in range(6) if column % 3 != axis]
        order = np.lexsort([merged[:, axis], *(merged[:, column] for column in others)])
        merged = merged[order]
        joins = np.all(merged[1:][:, others] == merged[:-1][:, others], axis=1)
        joins &= merged[1:, axis] == merged[:-1, axis + 3]
        first = np.concatenate([[True], ~joins]) if len(merged) else np.zeros(0, bool)
        ends = merged[np.concatenate([first[1:], [True]]) if len(merged) else first, axis + 3]
        merged = merged[first]
        merged[:, axis + 3] = ends
    return merged


def _cubes(path: Path, voxel_m: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cubes (n, 3) through which the surface passes, and the corner (3,) of the grid, m."""
    mesh = _read(path)
    extent = np.asarray(mesh.get_max_bound()) - np.asarray(mesh.get_min_bound())
    if not np.all(np.isfinite(extent)):
        raise ProfileError(f"{path}: the mesh has corners that are not finite")
    expected = _CUBES_PER_FACE * float(mesh.get_surface_area()) / voxel_m**2
    if expected > MAX_CUBES:
        raise ProfileError(
            f"{path}: a mesh of {extent[0]:.0f} x {extent[1]:.0f} x {extent[2]:.0f} m needs about "
            f"{expected:.0f} cubes of {voxel_m:g} m, at most {MAX_CUBES} are allowed; use larger cubes"
        )
    import open3d

    grid = open3d.geometry.VoxelGrid.create_from_triangle_mesh(mesh, voxel_m)
    cubes = np.array([voxel.grid_index for voxel in grid.get_voxels()], np.int64).reshape(-1, 3)
    return cubes[np.lexsort(cubes.T)], np.array(grid.origin, np.float64)


def _read(path: Path) -> Any:
    if path.suffix.lower() not in FORMATS:
        raise ProfileError(
            f"{path}: found a mesh called {path.suffix or 'nothing'}, allowed: {', '.join(FORMATS)}"
        )
    if not path.is_file():
        raise ProfileError(f"{path}: no such file")
    if path.stat().st_size > MAX_BYTES:
        raise ProfileError(f"{path}: {path.stat().st_size} bytes, at most {MAX_BYTES} are read")
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        mesh = open3d.io.read_triangle_mesh(path)
    if len(mesh.triangles) == 0:
        raise ProfileError(f"{path}: no triangles found in it")
    return mesh
