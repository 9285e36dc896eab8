"""Deformable-3DGS (arXiv 2309.13101): one network from a Gaussian's place and the time to its changes.

The place is the canonical mean, cut off from the gradient; place and time go in as sines and cosines. Positions,
rotations and scales change, colours and opacities do not.

Two things differ from the original for every capture's sake: places are measured from the scene's middle in units of
its scale (the original takes world units as they come), and scale changes are added before the exponential.
"""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import torch
from torch import nn
from torch.nn import functional

from ...engine import MOTION_UNIT, CanonicalField, ModelInit, Recipe, plain
from .networks import NetworkBaseline, bounds_of
from .playback import Playable

_PAPER_WIDTH = 128  # hidden widths from here on ask for the original's network


@dataclass(frozen=True)
class D3dgsSettings:
    """The shape of the network; written into the scene file.

    Attributes:
        depth, width: hidden layers, and units of each.
        space_frequencies, time_frequencies: octaves of the encodings.
        motion_unit: world units that an output of one moves a Gaussian by.
    """

    depth: int
    width: int
    space_frequencies: int
    time_frequencies: int
    motion_unit: float
    sizes: ClassVar = {"means": 3, "quaternions": 4, "log_scales": 3}  # of what the network puts out, in this order
    changing: ClassVar = frozenset({"means", "quaternions", "scales"})

    def __post_init__(self) -> None:
        if not 1 <= self.depth <= 64:
            raise ValueError(f"{self.depth} layers, expected 1 to 64")

    @property
    def skip(self) -> int:
        """The hidden layer that is given the encodings again (the sixth of eight)."""
        return self.depth // 2 + 1


def encode(values: torch.Tensor, frequencies: int) -> torch.Tensor:
    """(N, D) to (N, D + 2 D frequencies): the values, then sines and cosines of 1, 2, 4, ... times them."""
    octaves = 2.0 ** torch.arange(frequencies, device=values.device)
    angles = (values[:, :, None] * octaves).flatten(1)
    return torch.cat([values, angles.sin(), angles.cos()], dim=1)


class D3dgsNetwork(nn.Module):
    """Hidden layers with one skip connection. Weights' columns: encoded place, encoded time, previous layer.

    Args:
        settings: its shape.
        points: (N, 3) seeds, for the middle of the scene.
        unit: world units.

    Attributes:
        origin, extent: (3,) where the encoding's zero lies, and what it calls one.
    """

    origin: torch.Tensor
    extent: torch.Tensor

    def __init__(self, settings: D3dgsSettings, points: torch.Tensor, unit: float) -> None:
        super().__init__()
        self.settings = settings
        low, high = bounds_of(points)
        self.register_buffer("origin", (low + high) / 2)
        self.register_buffer("extent", torch.full((3,), unit))
        self.space_size = 3 + 6 * settings.space_frequencies
        self.time_size = 1 + 2 * settings.time_frequencies
        layers = []
        for index in range(settings.depth):
            encoded = self.space_size + self.time_size if index in (0, settings.skip) else 0
            inputs = encoded + (settings.width if index else 0)
            layers.append(nn.Linear(inputs, settings.width))
        self.layers = nn.ModuleList(layers)
        self.output = nn.Linear(settings.width, sum(settings.sizes.values()))
        # Zero outputs: training starts from the undeformed scene.
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def forward(self, means: torch.Tensor, time: float) -> torch.Tensor:
        """(N, 10) of means (N, 3); what time adds to a layer is one vector, the same for all Gaussians."""
        s = self.settings
        position = encode((means - self.origin) / self.extent, s.space_frequencies)
        encoded_time = encode(torch.full((1, 1), time, device=means.device), s.time_frequencies)[0]
        hidden = position.new_empty(len(position), 0)
        for index, layer in enumerate(self.layers):
            assert isinstance(layer, nn.Linear)
            if index not in (0, s.skip):
                hidden = functional.linear(hidden, layer.weight, layer.bias).relu()
                continue
            by_position, by_time, by_hidden = layer.weight.split(
                [self.space_size, self.time_size, layer.in_features - self.space_size - self.time_size], dim=1
            )
            sums = torch.addmm(layer.bias + by_time @ encoded_time, position, by_position.T)
            hidden = (torch.addmm(sums, hidden, by_hidden.T) if index else sums).relu()
        result: torch.Tensor = self.output(hidden)
        return result


class D3dgs(NetworkBaseline):
    """See the module."""

    def __init__(self, canonical: CanonicalField, settings: D3dgsSettings, unit: float = 1.0) -> None:
        """``unit``: world units that the encoding calls one."""
        super().__init__(canonical, settings)
        self.deformation = D3dgsNetwork(settings, canonical.means, unit)

    def places(self) -> torch.Tensor:
        return self.canonical.means.detach()

    def rate_groups(self) -> dict[str, list[nn.Parameter]]:
        return {"network": list(self.deformation.parameters())}


def adapted(recipe: Recipe) -> Recipe:
    """Its deep network learns best at three times the rate of FRoG's one layer (docs/experiments/baselines.md)."""
    return replace(plain(recipe), network_rate=3 * recipe.network_rate)


def model_of(begin: ModelInit) -> D3dgs:
    """Before its first step.

    The original's eight layers of 256 for recipes as wide as the papers', a network for two cores for others. Time has
    as many octaves as the frames can tell apart (the original's ten at 300 frames). Finer ones only let neighbouring
    frames disagree.
    """
    width, unit = begin.recipe.hidden_width, MOTION_UNIT * begin.scene_scale
    intervals = max(2, begin.frame_count) - 1
    octaves = max(2, min(10, 1 + round(math.log2(math.pi * intervals))))
    if width >= _PAPER_WIDTH:
        settings = D3dgsSettings(8, 2 * width, 10, octaves, unit)
    else:
        settings = D3dgsSettings(4, width, 8, octaves, unit)
    with torch.device("cpu"):
        return D3dgs(begin.canonical, settings, begin.scene_scale)


playable = partial(Playable, D3dgs, D3dgsSettings)
