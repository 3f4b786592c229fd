"""Places of bright things that were found to be fixed: signs, tape on poles.

They come into sight again and again, each time with another chance to be taken for a UAV; who remembers
them gives them that chance once.
"""

import numpy as np

from companion.messages import FloatArray

MOST_FIXTURES = 256
"""Beyond this number the oldest are forgotten."""

_SAME_M = 0.35


class Fixtures:
    """Places in the map, with the evidence against each."""

    def __init__(self) -> None:
        """Begin without any."""
        self._places: list[tuple[FloatArray, float]] = []

    def clear(self) -> None:
        """Forget all: the map is another one."""
        self._places.clear()

    def remember(self, p_map: FloatArray, evidence: float) -> None:
        """Add a place, or let what is known of it be replaced.

        Args:
            p_map: (3,) m.
            evidence: that something flies there, below 0; what is not is no reason to remember a place.
        """
        self._places = [place for place in self._places if np.linalg.norm(place[0] - p_map) > _SAME_M]
        if evidence < 0.0:
            self._places.append((np.array(p_map, np.float64), evidence))
            del self._places[:-MOST_FIXTURES]

    def evidence(self, p_map: FloatArray) -> float:
        """Return the evidence at a place (3,), or 0 where nothing is known."""
        if not self._places:
            return 0.0
        away = np.linalg.norm(np.array([place for place, _ in self._places]) - p_map, axis=1)
        nearest = int(np.argmin(away))
        return self._places[nearest][1] if away[nearest] <= _SAME_M else 0.0
