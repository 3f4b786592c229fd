"""What the vehicles of a swarm see: their LiDARs, apart from them.

A beam depends on nothing but where everybody is, so the LiDAR of a vehicle may be simulated in another
process than the vehicle itself, which evens out the processes' work.
"""

import struct
from collections.abc import Sequence

import numpy as np

from companion.messages import FloatArray
from sitl.dynamics import STEP_NS
from sitl.kinematics import Kinematics
from sitl.scenario import Stage
from sitl.sensor_rig import Scanner
from sitl.slots import PointSlots
from sitl.swarm.table import Table
from sitl.vehicle import build_lidar
from sitl.worlds.bodies import Bodies, poses_midway
from sitl.worlds.uav_body import UavBodySettings, uav_body

_HEAD = struct.Struct("<qq")
_LENT = 1
_UNUSED = np.zeros(3)

Midway = tuple[FloatArray, FloatArray]


def midway_of(before: Table, now: Table) -> Midway:
    """Return positions (n, 3) and attitudes (n, 4) of everybody in the middle of a step."""
    return poses_midway(before.p_world, before.q_world_body, now.p_world, now.q_world_body)


class Eye:
    """The LiDAR of one vehicle among others."""

    def __init__(self, stage: Stage, number: int, vehicles: int) -> None:
        """Power on.

        Args:
            stage: of this vehicle.
            number: which of them it is.
            vehicles: how many there are.
        """
        self._number = number
        self._others = np.array([other for other in range(vehicles) if other != number], np.intp)
        self._bodies = Bodies(stage.world, [uav_body(UavBodySettings())] * (vehicles - 1))
        self._scanner = Scanner(build_lidar(stage))

    def look(self, before: Table, now: Table, midway: Midway) -> PointSlots:
        """Return what it measures during one step.

        Args:
            before: everybody at its beginning.
            now: everybody at its end.
            midway: everybody in its middle, where the others are seen.
        """
        others = self._others
        world = self._bodies.at(midway[0].take(others, 0), midway[1].take(others, 0), now.turns.take(others))
        return self._scanner.step(self._pose(before), self._pose(now), STEP_NS, world)

    def _pose(self, table: Table) -> Kinematics:
        k = self._number
        return Kinematics(table.p_world[k], _UNUSED, table.q_world_body[k], _UNUSED)


def lent_eyes(shares: Sequence[Sequence[int]]) -> dict[int, tuple[int, ...]]:
    """Return for which vehicles the first share simulates the LiDAR, by the number of their own share.

    Where one share alone has a vehicle more than the first, it lends a LiDAR, about a quarter of a vehicle's
    work. A second would make the sums even, but not most steps, and its points have to be handed over too.
    """
    larger = [index for index, share in enumerate(shares) if len(share) > len(shares[0])]
    if len(larger) != 1 or len(shares[larger[0]]) < _LENT:
        return {}
    return {larger[0]: tuple(shares[larger[0]][-_LENT:])}


def slots_as_bytes(slots: PointSlots) -> bytes:
    """Return a LiDAR's slots as bytes."""
    head = _HEAD.pack(slots.first_slot, len(slots.points_lidar))
    return b"".join([head, slots.points_lidar.tobytes(), slots.reflectivity.tobytes(), slots.tags.tobytes()])


def slots_from_bytes(data: bytes) -> PointSlots:
    """Return the slots that `slots_as_bytes` packed."""
    first, count = _HEAD.unpack_from(data)
    points = np.frombuffer(data, np.float64, 3 * count, _HEAD.size).reshape(-1, 3)
    rest = np.frombuffer(data, np.uint8, 2 * count, _HEAD.size + points.nbytes)
    return PointSlots(first, points, rest[:count], rest[count:])
