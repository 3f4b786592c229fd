"""Livox Mid-360: from a body's motion through a world to measured slots.

Sources of the figures: datasheet (40 m at 10 %, 70 m at 80 % reflectivity; range deviation at most 2 cm
at 10 m; angle deviation below 0.15 degrees) and published measurements on real units for noise and
misses against incidence, the blanking after near returns and the shares of tags. Of the two noise
figures the measured one is the default: 8 mm at 10 m and normal incidence, which the datasheet's bound
admits; `range_noise_scale` 2.5 is the bound itself. The width of a beam, the share of spurious points
and the fall of reflectivity with incidence (Lambert's cosine) are assumptions.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pydantic import Field

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from companion.settings import Settings
from sitl.kinematics import BodyTrajectory
from sitl.sensors import ranging_kernels as kernels
from sitl.sensors.scan_kernels import FIRING_PERIOD_NS, LINES
from sitl.sensors.scan_pattern import ScanPattern
from sitl.slots import PointSlots
from sitl.worlds.primitives import World


class Mid360Settings(Settings):
    """Imperfections of one unit."""

    range_noise_scale: float = Field(default=1.0, ge=0.0, le=100.0)
    """Multiplies the measured range deviation; 0 switches range noise off."""
    angle_noise_deg: float = Field(default=0.05, ge=0.0, le=5.0)
    """Standard deviation of the reported azimuth and elevation."""
    beam_half_width_deg: float = Field(default=0.12, ge=0.0, le=2.0)
    """Half width of a beam; it makes mixed points at edges."""
    range_at_10_percent_m: float = Field(default=40.0, gt=0.0, le=500.0)
    """Distance at which a surface of 10 % reflectivity returns every second time."""
    range_at_80_percent_m: float = Field(default=70.0, gt=0.0, le=500.0)
    """The same at 80 %."""
    max_range_m: float = Field(default=100.0, gt=0.0, le=500.0)
    """Nothing is seen beyond, not even a retro-reflector."""
    min_range_m: float = Field(default=0.1, ge=0.0, le=5.0)
    """Nothing is reported from nearer."""
    pulse_length_m: float = Field(default=0.75, ge=0.0, le=10.0)
    """Two surfaces in one beam nearer to each other than this merge into one point between them."""
    edge_gap_m: float = Field(default=0.1, ge=0.0, le=10.0)
    """Two surfaces nearer to each other than this do not count as an edge."""
    spurious_probability: float = Field(default=1e-4, ge=0.0, le=1.0)
    """Chance of a slot to report a point where nothing is."""
    tag_scale: float = Field(default=1.0, ge=0.0, le=70.0)
    """Multiplies the share of ordinary returns tagged as doubtful (1.35 %)."""
    near_range_blanking: bool = True
    """A return from nearer than 0.55 m (less often up to 0.89 m) costs its line the next firing."""

    @classmethod
    def ideal(cls) -> "Mid360Settings":
        """Return a unit without noise, doubt or blanking; only misses by incidence and range remain."""
        return cls(
            range_noise_scale=0.0, angle_noise_deg=0.0, beam_half_width_deg=0.0, spurious_probability=0.0,
            tag_scale=0.0, near_range_blanking=False,
        )  # fmt: skip

    def packed(self) -> FloatArray:
        """Return the numbers in the order of the kernels' parameter array."""
        parameters = np.zeros(kernels.N_PARAMETERS)
        parameters[kernels.RANGE_NOISE_SCALE] = self.range_noise_scale
        parameters[kernels.ANGLE_NOISE_RAD] = math.radians(self.angle_noise_deg)
        parameters[kernels.RANGE_AT_TENTH_M] = self.range_at_10_percent_m
        ratio = self.range_at_80_percent_m / self.range_at_10_percent_m
        parameters[kernels.RANGE_EXPONENT] = math.log(ratio) / math.log(8.0)
        parameters[kernels.MIN_RANGE_M] = self.min_range_m
        parameters[kernels.PULSE_LENGTH_M] = self.pulse_length_m
        parameters[kernels.EDGE_GAP_M] = self.edge_gap_m
        parameters[kernels.SPURIOUS_PROBABILITY] = self.spurious_probability
        parameters[kernels.TAG_SCALE] = self.tag_scale
        parameters[kernels.BLANKING] = float(self.near_range_blanking)
        return parameters


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
        self._pattern = ScanPattern()
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
            np.require(trajectory.t_sensor_ns, np.int64, ["C", "W"]),
            np.ascontiguousarray(trajectory.p_world + rotation.rotate(q_world_body, self._T_body_lidar.p)),
            rotation.multiply(q_world_body, self._T_body_lidar.q),
            directions_lidar,
            origins,
            axes,
            rims,
        )
        hits = world.cast(origins, axes, self._settings.max_range_m)
        rim_hits = (
            world.cast(origins, rims, self._settings.max_range_m)
            if self._settings.beam_half_width_deg > 0.0
            else hits
        )
        slots = PointSlots(
            first_slot, np.empty((count, 3)), np.empty(count, np.uint8), np.empty(count, np.uint8)
        )
        sources = np.empty(count, np.int32)
        kernels.form_returns(
            self._seed, first_slot, self._parameters, directions_lidar,
            hits.ranges, hits.indices, hits.cosines, rim_hits.ranges, rim_hits.indices, rim_hits.cosines,
            world.reflectivity, world.retro_reflective, self._blanked,
            slots.points_lidar, slots.reflectivity, slots.tags, sources,
        )  # fmt: skip
        return Observation(slots, hits.indices, sources)

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
