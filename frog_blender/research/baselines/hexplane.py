"""4DGaussians (arXiv 2310.08528): features from six planes of space and time, and a small network after them.

A Gaussian's feature is the product of what it reads from the planes xy, xz, yz, xt, yt and zt at its canonical mean
and the time, for each resolution of space; the features of all resolutions, one after the other, go through a network
with a head for each attribute.
"""

import math
from dataclasses import dataclass
from functools import partial, reduce

import torch
from torch import nn
from torch.nn import functional

from ...engine import MOTION_UNIT, CanonicalField, ModelInit, output_sizes, plain
from .networks import NetworkBaseline, bounds_of
from .playback import Playable

AXES = ((0, 1), (0, 2), (1, 2))
"""Columns and rows of the planes of space."""

_PAPER_WIDTH = 128  # hidden widths from here on ask for the original's planes


@dataclass(frozen=True)
class HexPlaneSettings:
    """The shape of planes and network; written into the scene file.

    Attributes:
        channels: features of a plane.
        resolutions: cells a side of the planes of space, one entry for each scale.
        time_rows: rows of the planes of time, the same at each scale.
        hidden_width: first layer.
        head_width: second layer of each head; 0 for one second layer of ``hidden_width`` that all heads share.
        deformed_sh: SH coefficients that deform.
        deformed_opacity: whether opacities do.
        motion_unit: world units that an output of one moves a Gaussian by.
    """

    channels: int
    resolutions: tuple[int, ...]
    time_rows: int
    hidden_width: int
    head_width: int
    deformed_sh: int
    deformed_opacity: bool
    motion_unit: float

    @property
    def sizes(self) -> dict[str, int]:
        """Numbers that come out by attribute."""
        sizes = output_sizes(self.deformed_sh)
        return {name: size for name, size in sizes.items() if name != "opacity_logits" or self.deformed_opacity}

    @property
    def changing(self) -> frozenset[str]:
        """The columns of Gaussians that change in time."""
        colors = {f"sh_{index}" for index in range(1, self.deformed_sh)}
        base = {"base"} if self.deformed_opacity or self.deformed_sh else set()
        return frozenset({"means", "scales", "quaternions", *base, *colors})


# Weights of the planes' own losses, with the original's values for N3DV.
SPACE_WEIGHT = 2e-4  # of the mean square difference of neighbouring cells of the planes of space
TIME_WEIGHT = 1e-3  # of the mean square second difference along time
STILLNESS_WEIGHT = 1e-4  # of the mean distance of the planes of time from one, where nothing changes


class HexPlaneField(nn.Module):
    """Planes and network.

    Args:
        settings: their shape.
        points: (N, 3) seeds; the planes span the box around them. What lies outside reads their rims.

    Attributes:
        origin, extent: (3,) the box's lower corner and its sides.
    """

    origin: torch.Tensor
    extent: torch.Tensor

    def __init__(self, settings: HexPlaneSettings, points: torch.Tensor) -> None:
        super().__init__()
        self.settings = s = settings
        low, high = bounds_of(points)
        self.register_buffer("origin", low)
        self.register_buffer("extent", high - low)
        # (3, C, rows, columns): space from 0.1 to 0.5, time one, so that nothing moves before it has learned to.
        self.space_planes = nn.ParameterList(
            torch.empty(3, s.channels, size, size).uniform_(0.1, 0.5) for size in s.resolutions
        )
        self.time_planes = nn.ParameterList(torch.ones(3, s.channels, s.time_rows, size) for size in s.resolutions)
        heads = len(s.sizes)
        self.first = nn.Linear(s.channels * len(s.resolutions), s.hidden_width)
        self.second = nn.Linear(s.hidden_width, heads * s.head_width or s.hidden_width)
        nn.init.xavier_uniform_(self.first.weight)
        nn.init.xavier_uniform_(self.second.weight)
        # Zero outputs: training starts from the undeformed scene.
        outputs = sum(s.sizes.values())
        self.output_weight = nn.Parameter(torch.zeros(outputs, s.head_width or s.hidden_width))
        self.output_bias = nn.Parameter(torch.zeros(outputs))

    def features(self, means: torch.Tensor, time: float) -> torch.Tensor:
        """(N, channels * scales) at means (N, 3) and a time in [0, 1]."""
        places = (means - self.origin) / self.extent * 2 - 1
        on_planes = torch.stack([places[:, axes] for axes in AXES])[:, None]  # (3, 1, N, 2)
        on_lines = torch.stack([places.T, torch.zeros_like(places.T)], dim=2)[:, None]
        features = []
        for space, over_time in zip(self.space_planes, self.time_planes, strict=True):
            at = min(max(time, 0.0), 1.0) * (over_time.shape[2] - 1)
            row = min(int(at), over_time.shape[2] - 2)
            line = torch.lerp(over_time[:, :, row : row + 1], over_time[:, :, row + 1 : row + 2], at - row)
            parts = [*_read(space, on_planes), *_read(line, on_lines)]  # six of (C, 1, N)
            features.append(reduce(torch.mul, parts))
        return torch.cat(features)[:, 0].T

    def forward(self, means: torch.Tensor, time: float) -> torch.Tensor:
        """(N, sum of sizes) changes, means in motion units."""
        s = self.settings
        hidden = self.second(self.first(self.features(means, time)).relu()).relu()
        if not s.head_width:
            return functional.linear(hidden, self.output_weight, self.output_bias)
        sizes = list(s.sizes.values())
        parts = zip(
            hidden.split(s.head_width, dim=1),
            self.output_weight.split(sizes),
            self.output_bias.split(sizes),
            strict=True,
        )
        return torch.cat([functional.linear(part, weight, bias) for part, weight, bias in parts], dim=1)


def _read(planes: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
    """(3, C, 1, N) bilinear, the rims going on outside."""
    return functional.grid_sample(planes, places, mode="bilinear", padding_mode="border", align_corners=True)


class HexPlane(NetworkBaseline):
    """See the module."""

    deformation: HexPlaneField

    def __init__(self, canonical: CanonicalField, settings: HexPlaneSettings) -> None:
        super().__init__(canonical, settings)
        self.deformation = HexPlaneField(settings, canonical.means)

    def rate_groups(self) -> dict[str, list[nn.Parameter]]:
        field = self.deformation
        grid = [*field.space_planes, *field.time_planes]
        network = [*field.first.parameters(), *field.second.parameters(), field.output_weight, field.output_bias]
        return {"grid": grid, "network": network}

    def regularization(self) -> torch.Tensor:
        """The planes' smoothness and stillness."""
        field = self.deformation
        total = field.output_bias.new_zeros(())
        for space, over_time in zip(field.space_planes, field.time_planes, strict=True):
            for axis in (2, 3):
                total = total + SPACE_WEIGHT * space.diff(dim=axis).square().mean()
            if over_time.shape[2] > 2:
                total = total + TIME_WEIGHT * over_time.diff(n=2, dim=2).square().mean()
            total = total + STILLNESS_WEIGHT * (over_time - 1).abs().mean()
        return total


def model_of(begin: ModelInit) -> HexPlane:
    """Before its first step.

    The original's planes for recipes as wide as the papers', and fewer cells for others; a row of time for every two
    frames, as the original advises.
    """
    recipe = begin.recipe
    settings = HexPlaneSettings(
        channels=16,
        resolutions=(64, 128) if recipe.hidden_width >= _PAPER_WIDTH else (32, 64),
        time_rows=max(2, math.ceil(begin.frame_count / 2)),
        hidden_width=recipe.hidden_width,
        head_width=recipe.head_width,
        deformed_sh=min(recipe.deformed_sh, begin.canonical.sh.shape[1]),
        deformed_opacity=recipe.deformed_opacity,
        motion_unit=MOTION_UNIT * begin.scene_scale,
    )
    with torch.device("cpu"):
        return HexPlane(begin.canonical, settings)


adapted = plain
playable = partial(Playable, HexPlane, HexPlaneSettings)
