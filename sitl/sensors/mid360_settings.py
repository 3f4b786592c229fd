"""Imperfections of a Livox Mid-360 and their sources.

Sources of the figures: datasheet (40 m at 10 %, 70 m at 80 % reflectivity; range deviation at most 2 cm
at 10 m; angle deviation below 0.15 degrees) and published measurements on real units for noise and
misses against incidence, the blanking after near returns and the shares of tags. Of the two noise
figures the measured one is the default: 8 mm at 10 m and normal incidence, which the datasheet's bound
admits; `range_noise_scale` 2.5 is the bound itself. The width of a beam, the share of spurious points
and the fall of reflectivity with incidence (Lambert's cosine) are assumptions.

Retro-reflectors rest on few facts. Livox's manuals give 0-150 to diffuse surfaces of 0-100 % and 151-255
to retro-reflectors; how a gain becomes one of the upper numbers is not published. Here it is a logarithm:
three decades of gain over white paper on 105 counts. A gain falls with the sixth power of the cosine of
the angle of entrance, somewhat faster than typical white tape (3M product bulletin 983 of 2009: 460 at
4 degrees, 215 at 30, 85 at 45 cd/(lx m^2), at 0.5 degrees of observation; slower at 0.2 degrees), and
sharply beyond 45 degrees, as flights with a Mid-360 and taped vehicles reported of intensity. How sharply,
the fall with range (a footprint that outgrows the tape), size and number of halos (known of LiDARs in
general, not measured on this one), ghosts and mirrored images are assumptions; the last three can be
switched off one by one.
"""

import math

import numpy as np
from pydantic import Field

from companion.messages import FloatArray
from companion.settings import Settings
from sitl.sensors import ranging_kernels as kernels


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
    retro_half_range_m: float = Field(default=8.0, gt=0.0, le=1e6)
    """Distance at which a retro-reflector's gain has fallen to half."""
    retro_cutoff_deg: float = Field(default=45.0, ge=0.0, le=90.0)
    """Angle of entrance beyond which a retro-reflector's gain falls sharply."""
    halo_probability: float = Field(default=0.15, ge=0.0, le=1.0)
    """Share of beams whose faint outer light is looked at for strong reflectors; 0 switches halos off."""
    halo_half_width_deg: float = Field(default=0.5, ge=0.0, le=5.0)
    """Half width of that faint light."""
    halo_share: float = Field(default=0.003, ge=0.0, le=1.0)
    """Its strength by that of the beam."""
    ghost_probability: float = Field(default=0.002, ge=0.0, le=1.0)
    """Chance that a return from a strong retro-reflector is reported weak at twice its distance."""
    mirror_probability: float = Field(default=0.02, ge=0.0, le=1.0)
    """Chance that the ground, met at a grazing angle, is smooth there and mirrors a strong reflector."""
    tag_scale: float = Field(default=1.0, ge=0.0, le=70.0)
    """Multiplies the share of ordinary returns tagged as doubtful (1.35 %)."""
    near_range_blanking: bool = True
    """A return from nearer than 0.55 m (less often up to 0.89 m) costs its line the next firing."""

    @classmethod
    def ideal(cls) -> "Mid360Settings":
        """Return a unit without noise, doubt or blanking; only misses by incidence and range remain."""
        return cls(
            range_noise_scale=0.0, angle_noise_deg=0.0, beam_half_width_deg=0.0, spurious_probability=0.0,
            tag_scale=0.0, near_range_blanking=False, halo_probability=0.0, ghost_probability=0.0,
            mirror_probability=0.0,
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
        parameters[kernels.RETRO_HALF_RANGE_M] = self.retro_half_range_m
        parameters[kernels.RETRO_CUTOFF_RAD] = math.radians(self.retro_cutoff_deg)
        parameters[kernels.HALO_PROBABILITY] = self.halo_probability
        parameters[kernels.HALO_SHARE] = self.halo_share
        parameters[kernels.GHOST_PROBABILITY] = self.ghost_probability
        parameters[kernels.FOOTPRINT_RAD] = math.radians(self.beam_half_width_deg)
        parameters[kernels.HALO_RAD] = math.radians(self.halo_half_width_deg)
        parameters[kernels.MIRROR_PROBABILITY] = self.mirror_probability
        parameters[kernels.MAX_RANGE_M] = self.max_range_m
        return parameters
