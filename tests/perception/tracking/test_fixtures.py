import numpy as np

from companion.perception.tracking.fixtures import MOST_FIXTURES, Fixtures


def test_a_fixed_thing_is_remembered_at_its_place_and_nowhere_else() -> None:
    known = Fixtures()
    assert known.evidence(np.zeros(3)) == 0.0
    known.remember(np.array([1.0, 2.0, 1.5]), -3.0)
    known.remember(np.array([4.0, 2.0, 1.5]), -5.0)
    assert known.evidence(np.array([1.1, 2.1, 1.5])) == -3.0
    assert known.evidence(np.array([4.0, 2.0, 1.3])) == -5.0
    assert known.evidence(np.array([2.5, 2.0, 1.5])) == 0.0


def test_newer_evidence_replaces_older_and_a_place_without_any_is_forgotten() -> None:
    known, place = Fixtures(), np.array([1.0, 2.0, 1.5])
    known.remember(place, -3.0)
    known.remember(place + 0.1, -6.0)
    assert known.evidence(place) == -6.0
    known.remember(place, 0.5)
    assert known.evidence(place) == 0.0


def test_memory_is_bounded_and_a_new_map_forgets_all() -> None:
    known = Fixtures()
    for k in range(MOST_FIXTURES + 10):
        known.remember(np.array([float(k), 0.0, 1.0]), -1.0)
    assert known.evidence(np.array([9.0, 0.0, 1.0])) == 0.0
    assert known.evidence(np.array([10.0, 0.0, 1.0])) == -1.0
    known.clear()
    assert known.evidence(np.array([10.0, 0.0, 1.0])) == 0.0
