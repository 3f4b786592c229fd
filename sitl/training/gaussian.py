"""Independent normal distributions: density, entropy and divergence, as functions without state.

The library's distribution remembers its last input, which threads would overwrite for each other.
"""

import math

import torch

_LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


def log_density_of(actions: torch.Tensor, mean: torch.Tensor, log_sigma: torch.Tensor) -> torch.Tensor:
    """Return the logarithm of the density (batch,) of actions (batch, k)."""
    deviation = (actions - mean) * torch.exp(-log_sigma)
    return (-0.5 * deviation.square() - log_sigma - _LOG_ROOT_2PI).sum(-1)


def entropy_of(log_sigma: torch.Tensor) -> torch.Tensor:
    """Return the entropy for logarithms of standard deviations (..., k)."""
    return (log_sigma + 0.5 + _LOG_ROOT_2PI).sum(-1)


def kl_of(
    old_mean: torch.Tensor, old_log_sigma: torch.Tensor, mean: torch.Tensor, log_sigma: torch.Tensor
) -> torch.Tensor:
    """Return the Kullback-Leibler divergence (batch,) of the new distribution from the old one."""
    variances = torch.exp(2.0 * (old_log_sigma - log_sigma))
    shift = (old_mean - mean).square() * torch.exp(-2.0 * log_sigma)
    return (log_sigma - old_log_sigma + 0.5 * (variances + shift - 1.0)).sum(-1)
