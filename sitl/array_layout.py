"""The one array layout that kernels are compiled for."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def laid_out(values: ArrayLike, kind: type = np.float64) -> NDArray[Any]:
    """Return an array of one type, in C order and writeable; one that is so already comes back as it is.

    Args:
        values: any numbers.
        kind: the element type.
    """
    if isinstance(values, np.ndarray) and values.dtype == kind:
        flags = values.flags
        if flags.c_contiguous and flags.writeable:
            return values
    return np.require(values, kind, ["C", "W"])
