"""Where the Mid-360 looks: its non-repetitive pattern in closed form, for any slot since power-on."""

from functools import lru_cache
from importlib import resources

import numpy as np

from companion.messages import FloatArray
from sitl.sensors.scan_kernels import LINES, evaluate_directions

_DATA_FILE = "mid360_pattern.npz"


class ScanPattern:
    """Directions of all slots of one unit.

    A fast rotor and a slow nod of the mirror turn four emitters that fire together every 20 us. Each
    emitter's direction is a Fourier series in both phases; the origin of its coefficients is told in
    ``NOTICE.md``. Azimuth increases counter-clockwise seen from above.
    """

    def __init__(self) -> None:
        """Read the coefficients shipped with the package."""
        with (
            resources.files("sitl.sensors").joinpath(_DATA_FILE).open("rb") as stream,
            np.load(stream, allow_pickle=False) as archive,
        ):
            self._rotor_hz = float(archive["rotor_hz"])
            self._nod_hz = float(archive["nod_hz"])
            self._rotor_order = int(archive["rotor_order"])
            self._nod_order = int(archive["nod_order"])
            coefficients = np.asarray(archive["coefficients"], dtype=np.float64)
        terms = (2 * self._rotor_order + 1) * (2 * self._nod_order + 1)
        if coefficients.shape != (LINES, terms, 3):
            raise ValueError(f"{_DATA_FILE}: coefficients {coefficients.shape} do not fit the orders")
        # One row a term, so that the kernel meets the terms of all lines next to each other.
        self._coefficients = np.ascontiguousarray(coefficients.transpose(1, 0, 2).reshape(terms, 3 * LINES))

    @property
    def rotor_hz(self) -> float:
        """Return the turns of the rotor per second."""
        return self._rotor_hz

    @property
    def nod_hz(self) -> float:
        """Return the nods of the mirror per second."""
        return self._nod_hz

    @lru_cache(maxsize=4)  # noqa: B019  # one pattern serves all units, each for as long as the process
    def directions_lidar(self, first_slot: int, count: int) -> FloatArray:
        """Return the unit directions (count, 3) of consecutive slots in the lidar frame.

        Sensors that were switched on together look the same way: the array is shared by all who ask for
        the same slots, and must not be changed.

        Args:
            first_slot: index since power-on, at least 0; slot n belongs to line n % 4 and is fired at
                (n // 4) * 20 us.
            count: number of slots.

        Raises:
            ValueError: if either is negative.
        """
        if first_slot < 0 or count < 0:
            raise ValueError(f"slots must not be negative: first {first_slot}, count {count}")
        directions = np.empty((count, 3))
        evaluate_directions(
            first_slot, self._rotor_hz, self._nod_hz, self._rotor_order, self._nod_order,
            self._coefficients, directions,
        )  # fmt: skip
        return directions


@lru_cache(maxsize=1)
def usual_pattern() -> ScanPattern:
    """Return the pattern that all units of the type share."""
    return ScanPattern()
