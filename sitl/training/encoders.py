"""Parts of the networks that turn observations into features.

Azimuths are a circle: every convolution over them wraps around, so that there is no seam behind the vehicle.
"""

import torch
from torch import nn
from torch.nn import functional

AZIMUTHS = 72
ELEVATIONS = 12


class CircularConvolution(nn.Module):
    """A convolution over a circle of azimuths, (batch, azimuths, channels), channels last.

    It is one matrix product over neighbouring columns, which small channels need to be fast on a CPU.
    """

    def __init__(self, inputs: int, outputs: int, width: int, stride: int) -> None:
        """Make a layer.

        Args:
            inputs: channels that come in.
            outputs: channels that go out.
            width: azimuths that one output sees; odd.
            stride: azimuths from one output to the next.
        """
        super().__init__()
        self.width = width
        self.stride = stride
        self.product = nn.Linear(inputs * width, outputs)

    def forward(self, columns: torch.Tensor) -> torch.Tensor:
        """Return (batch, azimuths / stride, outputs)."""
        half, count = self.width // 2, columns.shape[1]
        ring = torch.cat([columns[:, count - half :], columns, columns[:, :half]], 1)
        taps = [ring[:, tap : tap + count : self.stride] for tap in range(self.width)]
        product: torch.Tensor = self.product(torch.cat(taps, -1))
        return product


class AzimuthEncoder(nn.Module):
    """Features of what lies around: (batch, azimuths, channels) becomes (batch, features)."""

    def __init__(self, inputs: int, channels: tuple[int, ...], activation: nn.Module) -> None:
        """Make one layer of width 3 and stride 2 for each entry of `channels`."""
        super().__init__()
        sizes = (inputs, *channels)
        self.layers = nn.ModuleList(
            CircularConvolution(sizes[i], sizes[i + 1], 3, 2) for i in range(len(channels))
        )
        self.activation = activation
        self.features = AZIMUTHS // 2 ** len(channels) * channels[-1]

    def forward(self, columns: torch.Tensor) -> torch.Tensor:
        """Return (batch, features)."""
        for layer in self.layers:
            columns = self.activation(layer(columns))
        return columns.flatten(1)


class NeighbourEncoder(nn.Module):
    """Features of a set of neighbours, the same in whatever order they come.

    Every row goes through the same two layers; the mean and the largest value over those that are present
    are the features, so that any number of neighbours fits.
    """

    def __init__(self, inputs: int, width: int, present: int, activation: nn.Module) -> None:
        """Make an encoder.

        Args:
            inputs: numbers a row.
            width: of both layers.
            present: index of the flag that says whether a row holds a neighbour.
            activation: after each layer.
        """
        super().__init__()
        self.first = nn.Linear(inputs, width)
        self.second = nn.Linear(width, width)
        self.present = present
        self.activation = activation
        self.features = 2 * width

    def forward(self, neighbours: torch.Tensor) -> torch.Tensor:
        """Return (batch, features) of (batch, rows, inputs)."""
        present = (neighbours[:, :, self.present : self.present + 1] > 0.5).to(neighbours.dtype)
        encoded = self.activation(self.second(self.activation(self.first(neighbours)))) * present
        mean = encoded.sum(1) / present.sum(1).clamp(min=1.0)
        # Rows that are absent are zeros here: with an activation that may be negative a lone neighbour's
        # largest value is at least zero, which costs nothing and keeps the set's maximum defined when empty.
        return torch.cat([mean, encoded.amax(1)], -1)


def columns_of(grid: torch.Tensor, memory: torch.Tensor | None) -> torch.Tensor:
    """Return nearness in the grid (batch, channels, azimuths, elevations) and memory as columns.

    The second channel, whether anything was hit, says no more than whether nearness is above zero: it is left
    out, and so may be whoever stores grids. Returns (batch, azimuths, elevations or one more).
    """
    nearness = grid[:, 0]
    return nearness if memory is None else torch.cat([nearness, memory.unsqueeze(-1)], -1)


class PaperEncoder(nn.Module):
    """The encoder of the paper: a small CNN over the grid, 256 features of it, then 512 of everything.

    Source: section III-B of the paper; channels, kernels and strides, which it does not say, are those of its
    framework: 4, 16, 16 channels, 5 x 3, strides (1, 1), (2, 1), (2, 2), ELU, layer normalisation.
    """

    def __init__(self, ego: int, neighbours: int) -> None:
        """Make an encoder for `ego` numbers of one's own and `neighbours` numbers of all rows together."""
        super().__init__()
        self.convolutions = nn.ModuleList(
            [
                nn.Conv2d(2, 4, (5, 3), (1, 1)),
                nn.Conv2d(4, 16, (5, 3), (2, 1)),
                nn.Conv2d(16, 16, (5, 3), (2, 2)),
            ]
        )
        self.flat = nn.Linear(16 * (AZIMUTHS // 4) * (ELEVATIONS // 2), 256)
        self.norm = nn.LayerNorm(256)
        self.together = nn.Linear(256 + ego + neighbours, 512)
        self.features = 512

    def forward(self, ego: torch.Tensor, neighbours: torch.Tensor, grid: torch.Tensor) -> torch.Tensor:
        """Return (batch, 512)."""
        image = grid
        for layer in self.convolutions:
            ring = torch.cat([image[:, :, -2:], image, image[:, :, :2]], 2)
            image = functional.elu(layer(functional.pad(ring, (1, 1, 0, 0))))
        seen = functional.elu(self.norm(self.flat(image.flatten(1))))
        return functional.elu(self.together(torch.cat([seen, ego, neighbours.flatten(1)], -1)))
