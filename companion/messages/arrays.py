"""Arrays by what they hold."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
PointArray = NDArray[np.float32]
ByteArray = NDArray[np.uint8]
