"""Held-out seeds and training seeds never meet."""

import pytest

from sitl.worlds.seeds import HELD_OUT_FROM, held_out_seed, is_held_out, training_seed


def test_training_seeds_end_where_held_out_seeds_begin() -> None:
    assert not is_held_out(training_seed(0))
    assert not is_held_out(training_seed(HELD_OUT_FROM - 1))
    assert is_held_out(held_out_seed(0))
    assert held_out_seed(0) == HELD_OUT_FROM


def test_numbers_that_would_cross_the_border_are_refused() -> None:
    for wrong in (-1, HELD_OUT_FROM):
        with pytest.raises(ValueError, match="training seeds are"):
            training_seed(wrong)
    with pytest.raises(ValueError, match="numbered from 0"):
        held_out_seed(-1)
