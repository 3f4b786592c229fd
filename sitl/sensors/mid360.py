"""Livox Mid-360: from a body's motion through a world to measured slots."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from companion.geometry.pose import Pose
from companion.messages import FloatArray
from sitl.array_layout import laid_out
from sitl.kinematics import BodyTrajectory
from sitl.sensors import measuring_kernels as kernels
from sitl.sensors.measuring_kernels import measure_slots
from sitl.sensors.mid360_settings import Mid360Settings as Mid360Settings
from sitl.sensors.scan_kernels import FIRING_PERIOD_NS, LINES
from sitl.sensors.scan_pattern import usual_pattern
from sitl.slots import PointSlots
from sitl.worlds.primitives import World

_Memory = tuple[FloatArray, FloatArray, NDArray[np.int32], NDArray[np.int64]]


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
        self._mount = np.concatenate([T_body_lidar.p, T_body_lidar.q])
        self._parameters = settings.packed()
        self._pattern = usual_pattern()
        self._blanked = np.zeros(LINES, np.uint8)
        self._next_slot = 0
        self._kept: _Memory | None = None

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
        points = np.empty((count, 3))
        reflectivity, tags = np.empty(count, np.uint8), np.empty(count, np.uint8)
        aimed, sources = np.empty(count, np.int32), np.empty(count, np.int32)
        measure_slots(
            self._seed, first_slot, self._parameters, self._mount,
            laid_out(trajectory.t_sensor_ns, np.int64),
            laid_out(trajectory.p_world),
            laid_out(trajectory.q_world_body),
            self._pattern.directions_lidar(first_slot, count),
            world.kinds, world.rows, world.discs, world.bodies, world.poses,
            world.reflectivity, world.retro_reflective, self._blanked, *self._memory(count),
            points, reflectivity, tags, aimed, sources,
        )  # fmt: skip
        return Observation(PointSlots(first_slot, points, reflectivity, tags), aimed, sources)

    def _memory(self, count: int) -> _Memory:
        """Return the kernel's working memory for `count` slots; kept, since most calls are alike."""
        if self._kept is None or self._kept[0].shape[1] != count:
            self._kept = (
                np.empty((kernels.VECTORS, count, 3)),
                np.empty((kernels.NUMBERS, count)),
                np.empty((kernels.MARKS, count), np.int32),
                np.empty(count, np.int64),
            )
        return self._kept

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
