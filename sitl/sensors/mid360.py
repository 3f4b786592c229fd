"""Livox Mid-360: from a body's motion through a world to measured slots."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from sitl.kinematics import BodyTrajectory
from sitl.sensors import ranging_kernels as kernels
from sitl.sensors.mid360_settings import Mid360Settings as Mid360Settings
from sitl.sensors.return_kernels import find_mirrors, form_returns
from sitl.sensors.scan_kernels import FIRING_PERIOD_NS, LINES
from sitl.sensors.scan_pattern import usual_pattern
from sitl.slots import PointSlots
from sitl.worlds.primitives import Hits, World


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What the sensor reported, and what only a simulation knows about it.

    Attributes:
        slots: the report.
        aimed: (n,) primitive in the axis of each beam, -1 for none.
        sources: (n,) primitive that each return came from, -1 without a true return.
    """

    slots: PointSlots
    aimed: NDArray[np.int32]
    sources: NDArray[np.int32]


class Mid360Model:
    """One simulated unit, mounted on a body."""

    def __init__(self, rng: Generator, T_body_lidar: Pose, settings: Mid360Settings) -> None:
        """Draw this unit's noise seed from `rng`."""
        self._seed = int(rng.integers(2**62))
        self._T_body_lidar = T_body_lidar
        self._settings = settings
        self._parameters = settings.packed()
        self._pattern = usual_pattern()
        self._blanked = np.zeros(LINES, np.uint8)
        self._next_slot = 0

    def measure(self, first_slot: int, count: int, trajectory: BodyTrajectory, world: World) -> PointSlots:
        """Return the report alone; see `observe`."""
        return self.observe(first_slot, count, trajectory, world).slots

    def observe(self, first_slot: int, count: int, trajectory: BodyTrajectory, world: World) -> Observation:
        """Measure consecutive slots while the body moves.

        The four slots of a firing are taken at its instant, ``(slot // 4) * 20 us`` of sensor time. What
        moves in the world stands still during one call, so call once a step if anything does.

        Args:
            first_slot: index since power-on; consecutive calls should continue where the last one ended
                (after a gap no line is blanked).
            count: number of slots.
            trajectory: the body's motion over all firings, in sensor time.
            world: what the beams can hit, the other vehicles included.

        Raises:
            ValueError: if the trajectory does not cover the slots.
        """
        self._check_covered(first_slot, count, trajectory)
        if first_slot != self._next_slot:
            self._blanked[:] = 0
        self._next_slot = first_slot + count
        directions_lidar = self._pattern.directions_lidar(first_slot, count)
        origins, axes, rims = (np.empty((count, 3)) for _ in range(3))
        q_world_body = trajectory.q_world_body
        kernels.place_beams(
            self._seed,
            first_slot,
            math.radians(self._settings.beam_half_width_deg),
            math.radians(self._settings.halo_half_width_deg),
            self._settings.halo_probability,
            np.require(trajectory.t_sensor_ns, np.int64, ["C", "W"]),
            np.ascontiguousarray(trajectory.p_world + rotation.rotate(q_world_body, self._T_body_lidar.p)),
            rotation.multiply(q_world_body, self._T_body_lidar.q),
            directions_lidar,
            origins,
            axes,
            rims,
        )
        hits = world.cast(origins, axes, self._settings.max_range_m)
        has_width = self._settings.beam_half_width_deg > 0.0 or self._settings.halo_probability > 0.0
        rim_hits = world.cast(origins, rims, self._settings.max_range_m) if has_width else hits
        mirrored = self._mirrored(first_slot, origins, axes, hits, world)
        slots = PointSlots(
            first_slot, np.empty((count, 3)), np.empty(count, np.uint8), np.empty(count, np.uint8)
        )
        sources = np.empty(count, np.int32)
        form_returns(
            self._seed, first_slot, self._parameters, directions_lidar,
            hits.ranges, hits.indices, hits.cosines,
            mirrored.ranges, mirrored.indices, mirrored.cosines,
            rim_hits.ranges, rim_hits.indices, rim_hits.cosines,
            world.reflectivity, world.retro_reflective, self._blanked,
            slots.points_lidar, slots.reflectivity, slots.tags, sources,
        )  # fmt: skip
        return Observation(slots, hits.indices, sources)

    def _mirrored(
        self, first_slot: int, origins: FloatArray, axes: FloatArray, hits: Hits, world: World
    ) -> Hits:
        """Return what beams see mirrored by the ground, with ranges along the whole way."""
        n = len(origins)
        mirrored = Hits(np.full(n, math.inf), np.full(n, -1, np.int32), np.zeros(n))
        if self._settings.mirror_probability > 0.0:
            points, directions, numbers = np.empty((n, 3)), np.empty((n, 3)), np.empty(n, np.int64)
            count = find_mirrors(
                self._seed, first_slot, self._settings.mirror_probability, origins, axes,
                world.kinds, hits.ranges, hits.indices, hits.cosines, points, directions, numbers,
            )  # fmt: skip
            if count:
                numbers = numbers[:count]
                beyond = world.cast(points[:count], directions[:count], self._settings.max_range_m)
                mirrored.ranges[numbers] = hits.ranges[numbers] + beyond.ranges
                mirrored.indices[numbers] = beyond.indices
                mirrored.cosines[numbers] = beyond.cosines
        return mirrored

    def _check_covered(self, first_slot: int, count: int, trajectory: BodyTrajectory) -> None:
        if first_slot < 0 or count < 1:
            raise ValueError(f"slots must exist: first {first_slot}, count {count}")
        first_ns = first_slot // LINES * FIRING_PERIOD_NS
        last_ns = (first_slot + count - 1) // LINES * FIRING_PERIOD_NS
        if first_ns < trajectory.t_sensor_ns[0] or last_ns > trajectory.t_sensor_ns[-1]:
            raise ValueError(
                f"slots fired from {first_ns} to {last_ns} ns lie outside the trajectory "
                f"({trajectory.t_sensor_ns[0]} to {trajectory.t_sensor_ns[-1]} ns)"
            )
