"""Which seeds of generators are for learning and tuning, and which are held out for testing.

Whatever is tuned or trained must never see a scene on which it is judged. Every scene comes from one seed, so
the seeds say it: below 1,000,000,000 for training, from there on for tests.
"""

HELD_OUT_FROM = 1_000_000_000


def is_held_out(seed: int) -> bool:
    """Return whether scenes of this seed are for tests only."""
    return seed >= HELD_OUT_FROM


def training_seed(number: int) -> int:
    """Return seed `number` of those that training and tuning may use.

    Raises:
        ValueError: if the number is negative or reaches into those held out.
    """
    if not 0 <= number < HELD_OUT_FROM:
        raise ValueError(f"training seeds are 0 to {HELD_OUT_FROM - 1}, got {number}")
    return number


def held_out_seed(number: int) -> int:
    """Return seed `number` of those held out for tests.

    Raises:
        ValueError: if the number is negative.
    """
    if number < 0:
        raise ValueError(f"held-out seeds are numbered from 0, got {number}")
    return HELD_OUT_FROM + number
