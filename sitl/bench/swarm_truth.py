"""What is true of the neighbours of a UAV, and whether its sensor could see them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from sitl.kinematics import Kinematics
from sitl.worlds.primitives import World

FIELD_LOW_RAD = float(np.radians(-7.0))
FIELD_HIGH_RAD = float(np.radians(52.0))
TEST_RAYS = 5
_MOST_RANGE_M = 200.0


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourSights:
    """How n neighbours stood to the sensor during one scan.

    Attributes:
        t_sensor_ns: end of the scan.
        sequence: of the scan.
        p_world: (n, 3) positions at its end.
        v_world: (n, 3) velocities then.
        q_world_body: (n, 4) attitudes then.
        range_m: (n,) from the sensor to the body's centre then.
        in_field: (n,) the centre was in the tilted field of view at every check during the scan.
        clear_rays: (n,) of the rays to the centre and to four points of the rim, those that nothing else
            stopped; the fewest over all checks.
        slots: (n,) beams whose axis met the body.
        tape_returns: (n,) returns from its retro-reflective parts.
        diffuse_returns: (n,) returns from its other parts.
    """

    t_sensor_ns: int
    sequence: int
    p_world: FloatArray
    v_world: FloatArray
    q_world_body: FloatArray
    range_m: FloatArray
    in_field: NDArray[np.bool_]
    clear_rays: NDArray[np.int64]
    slots: NDArray[np.int64]
    tape_returns: NDArray[np.int64]
    diffuse_returns: NDArray[np.int64]

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Return which neighbours (n,) should be seen: in the field, and at least two rays clear."""
        return self.in_field & (self.clear_rays >= 2)


@dataclass(frozen=True, slots=True, eq=False)
class MapFrame:
    """The frame in which a companion that started here sees the world: its start, turned by its heading."""

    p_world: FloatArray
    q_map_world: FloatArray

    @classmethod
    def of(cls, start: Kinematics) -> "MapFrame":
        """Return the frame of a companion that starts at this motion."""
        return cls(start.p_world, rotation.from_yaw(-rotation.yaw_of(start.q_world_body)))

    def positions(self, p_world: FloatArray) -> FloatArray:
        """Return positions (..., 3) in the map."""
        return rotation.rotate(self.q_map_world, p_world - self.p_world)

    def velocities(self, v_world: FloatArray) -> FloatArray:
        """Return velocities (..., 3) in the map."""
        return rotation.rotate(self.q_map_world, v_world)

    def attitudes(self, q_world_body: FloatArray) -> FloatArray:
        """Return attitudes (..., 4) in the map."""
        return rotation.multiply(self.q_map_world, q_world_body)


def look(
    T_world_lidar: Pose, world: World, p_world: FloatArray, half_width_m: float, half_height_m: float
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return which of the first n bodies are in the field of view (n,) and how many test rays reach each.

    Args:
        T_world_lidar: the sensor's pose.
        world: with bodies; the first n of them are looked for.
        p_world: (n, 3) their centres.
        half_width_m: of a body, to its left and right rim points.
        half_height_m: of a body, to its upper and lower rim points.
    """
    away = p_world - T_world_lidar.p
    flat = np.linalg.norm(away[:, :2], axis=1)
    in_lidar = rotation.rotate(rotation.conjugate(T_world_lidar.q), away)
    elevation = np.arctan2(in_lidar[:, 2], np.hypot(in_lidar[:, 0], in_lidar[:, 1]))
    in_field = (elevation >= FIELD_LOW_RAD) & (elevation <= FIELD_HIGH_RAD)
    left = np.column_stack([-away[:, 1], away[:, 0], np.zeros(len(away))]) / np.maximum(flat, 1e-6)[:, None]
    up = np.cross(away, left) / np.maximum(np.linalg.norm(away, axis=1), 1e-6)[:, None]
    shifts = np.stack(
        [0.0 * left, half_width_m * left, -half_width_m * left, half_height_m * up, -half_height_m * up],
        axis=1,
    )
    rays = (away[:, None, :] + shifts).reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1)
    hits = world.cast(np.tile(T_world_lidar.p, (len(rays), 1)), rays / lengths[:, None], _MOST_RANGE_M)
    own = world.bodies_of(hits.indices) == np.repeat(np.arange(len(p_world)), TEST_RAYS)
    clear = own | (hits.ranges >= lengths)
    return in_field, clear.reshape(-1, TEST_RAYS).sum(axis=1)


class SightCounter:
    """Gathers the sights of one scan step by step."""

    def __init__(self, neighbours: int, half_width_m: float, half_height_m: float) -> None:
        """Begin with the first scan.

        Args:
            neighbours: number of bodies to watch, the first ones of the world.
            half_width_m: see `look`.
            half_height_m: see `look`.
        """
        self._n = neighbours
        self._half_m = half_width_m, half_height_m
        self._restart()

    def _restart(self) -> None:
        self._in_field = np.ones(self._n, np.bool_)
        self._clear = np.full(self._n, TEST_RAYS)
        self._counts = np.zeros((3, self._n), np.int64)

    def check(self, T_world_lidar: Pose, world: World, p_world: FloatArray) -> None:
        """Look for every neighbour at one instant; see `look`."""
        if self._n:
            in_field, clear = look(T_world_lidar, world, p_world, *self._half_m)
            self._in_field &= in_field
            self._clear = np.minimum(self._clear, clear)

    def count(self, world: World, aimed: NDArray[np.int32], sources: NDArray[np.int32]) -> None:
        """Count the beams and returns of one step (see `sitl.sensors.mid360.Observation`)."""
        tape = world.retro_reflective[sources] != 0
        groups = (aimed, sources[tape], sources[~tape])
        for row, primitives in zip(self._counts, groups, strict=True):
            bodies = world.bodies_of(primitives)
            row += np.bincount(bodies[(bodies >= 0) & (bodies < self._n)], minlength=self._n)

    def close(
        self, t_sensor_ns: int, sequence: int, p_lidar: FloatArray,
        p_world: FloatArray, v_world: FloatArray, q_world_body: FloatArray,
    ) -> NeighbourSights:  # fmt: skip
        """Return the sights of the scan that ends now and begin with the next one."""
        sights = NeighbourSights(
            t_sensor_ns, sequence, p_world, v_world, q_world_body,
            np.linalg.norm(p_world - p_lidar, axis=1), self._in_field, self._clear, *self._counts,
        )  # fmt: skip
        self._restart()
        return sights
