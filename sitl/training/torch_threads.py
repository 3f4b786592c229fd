"""One thread for each operation of the networks, which are small; shards are what runs side by side."""

import torch


def calm_threads() -> None:
    """Let every operation keep to its caller's thread: sums do not depend on the number of cores."""
    torch.set_num_threads(1)
