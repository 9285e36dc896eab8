"""What of each Gaussian can be seen: its motion, what it adds to images, and how it views on average.

Everything is measured in a sample of training views at jittered times: what no image shows counts as nothing, and the
times of training images are not over-fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...gaussians import ATTRIBUTES, TorchGaussians
from ...rasterizer import Image, RasterizeOptions, rasterize
from ...spherical_harmonics import SH_DC
from ..optimize.mattes import Mattes
from ..optimize.transfers import bytes_on

PIXELS_OF_A_CHANGE = 64.0
"""A change of the whole display range counts as motion by so many pixels: one pixel of motion across an edge of a fifth
of the range changes about as much as a whole Gaussian by a hundredth of it."""


@dataclass(frozen=True)
class SampledView:
    """A camera, by index, at a time in [0, 1], which is jittered by up to half a frame, near a shot."""

    camera: int
    time: float
    shot: int = 0


def sample_views(capture: Capture, shots: Sequence[int], count: int, generator: torch.Generator) -> list[SampledView]:
    """``count`` views near ``shots`` in order of time (some twice where there are fewer shots), one from each of as
    many intervals with equally many shots: what shows for a few frames only must not be missed."""
    shuffled = [shots[int(k)] for k in torch.randperm(len(shots), generator=generator, device="cpu")]
    in_time = sorted(shuffled, key=lambda index: capture.shots[index].frame)
    choice, jitter = torch.rand(2, count, generator=generator, device="cpu").tolist()
    views = []
    for k in range(count):
        index = in_time[int((k + choice[k]) / count * len(in_time))]
        shot = capture.shots[index]
        time = capture.time_at(shot.frame + shot.offset + jitter[k] - 0.5)
        views.append(SampledView(shot.camera, time, index))
    return views


@dataclass(frozen=True)
class Motion:
    """Of the dynamic Gaussians.

    Attributes:
        score: (M,) pixels that they move, grow or rotate by at most, and PIXELS_OF_A_CHANGE times their change of
            colour and opacity, each times their blending weight in the view where that is most.
        rest_energy: (M,) the mean over the views of the sum of squares over pixels and channels by which an image
            would change, to first order, if this Gaussian alone were in its mean state.
    """

    score: torch.Tensor
    rest_energy: torch.Tensor

    def select(self, rows: torch.Tensor) -> Motion:
        """Of some of the Gaussians (indices, or a mask) alone."""
        return Motion(*(values[rows] for values in vars(self).values()))


@dataclass(frozen=True)
class Sensitivity:
    """What views show of Gaussians.

    Attributes:
        motion: of the dynamic ones.
        contribution: (N,) by how much an image would change if this Gaussian alone were removed: root of the sum of
            squares over its pixels and channels, of the display range, in the view where that is most.
        energy: (N,) the mean of that sum of squares over the views: what all images together would lose.
        state: how the dynamic ones look on average over the views, as the canonical field's attributes but embeddings.
    """

    motion: Motion
    contribution: torch.Tensor
    energy: torch.Tensor
    state: dict[str, torch.Tensor]


class _Range:
    """Least, largest and mean of tensors that come one after the other."""

    def __init__(self) -> None:
        self.sum = torch.zeros((), device="cpu")
        self.least, self.largest, self.count = self.sum + torch.inf, self.sum - torch.inf, 0

    def add(self, value: torch.Tensor) -> None:
        self.least, self.largest = torch.minimum(self.least, value), torch.maximum(self.largest, value)
        self.sum = self.sum + value
        self.count += 1

    @property
    def mean(self) -> torch.Tensor:
        return self.sum / self.count

    @property
    def half(self) -> torch.Tensor:
        return (self.largest - self.least) / 2


def measure(
    gaussians_at: Callable[[float], TorchGaussians],
    num_dynamic: int,
    capture: Capture,
    views: Sequence[SampledView],
    generator: torch.Generator,
    mattes: Mattes | None = None,
) -> Sensitivity:
    """Draws every view, at least one.

    Args:
        gaussians_at: all Gaussians at a time, dynamic ones first.
        num_dynamic: of them, M.
        mattes: where images have masks: what is ignored shows nothing, and views have backgrounds of their own.
    """
    ranges = ranges_of(gaussians_at, views, num_dynamic)
    contribution, energy, rest_energy, weight, reach = (_Range() for _ in range(5))
    mean = {name: values.mean for name, values in ranges.items()}
    for index, view in enumerate(views):
        camera = capture.cameras[view.camera]
        with torch.no_grad():
            gaussians = gaussians_at(view.time)
        background = mattes.background_of(index) if mattes else capture.background
        counted = mattes.counted(view.shot) if mattes else None
        image, slopes = view_gradients(gaussians, camera, background, generator, counted)
        assert image.max_weights is not None
        change = (slopes["opacities"] * gaussians.opacities).abs()
        contribution.add(change)
        energy.add(change.square())
        rest_energy.add(_squares(gaussians, slopes, mean))
        weight.add(image.max_weights[:num_dynamic])
        reach.add((image.max_weights * _pixels_per_unit(gaussians, image, camera))[:num_dynamic])
    score = _score(ranges, weight.largest, reach.largest)
    motion = Motion(score, rest_energy.mean)
    return Sensitivity(motion, contribution.largest, energy.mean, canonical_state(mean))


@torch.no_grad()
def peak_weights(
    gaussians_at: Callable[[float], TorchGaussians], capture: Capture, shots: Sequence[int]
) -> torch.Tensor:
    """(N,) each Gaussian's largest blending weight in the images of ``shots``, at least one (as
    ``playback.importance.largest_weights``)."""
    peaks = torch.zeros((), device="cpu")
    for index in shots:
        shot = capture.shots[index]
        gaussians = gaussians_at(capture.time_of(shot))
        image = rasterize(gaussians, capture.cameras[shot.camera], options=RasterizeOptions(weights=True))
        assert image.max_weights is not None
        peaks = torch.maximum(peaks.to(image.max_weights), image.max_weights)
    return peaks


@torch.no_grad()
def ranges_of(
    gaussians_at: Callable[[float], TorchGaussians], views: Sequence[SampledView], num_dynamic: int
) -> dict[str, _Range]:
    """Of the first ``num_dynamic`` Gaussians over the views, by attribute."""
    ranges = {name: _Range() for name in ATTRIBUTES}
    for view in views:
        gaussians = gaussians_at(view.time)
        for name, values in ranges.items():
            values.add(getattr(gaussians, name)[:num_dynamic])
    return ranges


def canonical_state(drawn: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The canonical field's attributes but embeddings, of Gaussians as they are drawn (GaussianArrays, by name)."""
    return {
        "means": drawn["means"],
        "quaternions": drawn["quaternions"],
        "log_scales": drawn["scales"].clamp(min=1e-12).log(),
        "opacity_logits": drawn["opacities"].clamp(1e-6, 1 - 1e-6).logit(),
        "sh": drawn["sh"],  # of the degrees that have begun
    }


def _score(ranges: dict[str, _Range], weight: torch.Tensor, reach: torch.Tensor) -> torch.Tensor:
    """See Motion; ``reach`` (M,) is the largest product of blending weight and pixels of a world unit."""
    means, quaternions, scales, opacities, sh = (ranges[name] for name in ATTRIBUTES)
    length = quaternions.mean.norm(dim=1).clamp(min=1e-12)
    turn = 2 * quaternions.half.norm(dim=1) / length * scales.largest.amax(1)
    fade = opacities.half / opacities.largest.clamp(min=1e-6)
    tint = SH_DC * sh.half[:, 0].amax(1)
    moved = means.half.norm(dim=1) + scales.half.amax(1) + turn
    score: torch.Tensor = reach * moved + PIXELS_OF_A_CHANGE * weight * (fade + tint)
    return score


def _squares(
    gaussians: TorchGaussians, slopes: dict[str, torch.Tensor], state: dict[str, torch.Tensor]
) -> torch.Tensor:
    """(M,) by how much a view's image changes when dynamic Gaussians are as in ``state``, see ``view_gradients``."""
    change = torch.zeros((), device=gaussians.means.device)
    for name, values in state.items():
        product = (values - getattr(gaussians, name)[: len(values)]) * slopes[name][: len(values)]
        change = change + (product.flatten(1).sum(1) if product.dim() > 1 else product)
    return change.square()


def in_state(gaussians: TorchGaussians, chosen: torch.Tensor, state: dict[str, torch.Tensor]) -> TorchGaussians:
    """The Gaussians, of which the first are as in ``state`` (GaussianArrays, by name) where ``chosen`` (M,) is true."""
    changed, count = {}, len(chosen)
    for name, values in state.items():
        now = getattr(gaussians, name)
        mask = chosen.view(-1, *[1] * (now.dim() - 1))
        changed[name] = torch.cat([torch.where(mask, values[:count], now[:count]), now[count:]])
    return gaussians.changed(changed)


def view_gradients(
    gaussians: TorchGaussians,
    camera: Camera,
    background: tuple[float, float, float],
    generator: torch.Generator,
    counted: NDArray[np.bool_] | None = None,
) -> tuple[Image, dict[str, torch.Tensor]]:
    """A camera's image, and gradients by attribute, of the pixels that are ``counted`` (H, W), or of all.

    Such a gradient times a change of one Gaussian's attributes, squared, is in the mean the sum of squares by which the
    image changes, since the backward pass has random signs at the pixels (Hutchinson's estimator): to first order, and
    exactly for opacities, in each of which it is affine.
    """
    drawn = gaussians.mapped(lambda value: value.detach().clone().requires_grad_())
    image = rasterize(drawn, camera, background, RasterizeOptions(weights=True))
    bits = torch.randint(2, image.rgb.shape, generator=generator, dtype=torch.uint8, device="cpu")
    signs = bytes_on(image.rgb.device, bits.numpy()).to(image.rgb.dtype).mul_(2).sub_(1)
    if counted is not None:
        signs *= bytes_on(signs.device, counted.view(np.uint8))[..., None]
    image.rgb.backward(signs)
    return image, {name: value.grad for name, value in drawn.arrays.items() if value.grad is not None}


def _pixels_per_unit(gaussians: TorchGaussians, image: Image, camera: Camera) -> torch.Tensor:
    """(N,) pixels that a world unit takes at each Gaussian's depth, 0 where it is not drawn."""
    row = torch.from_numpy(camera.world_to_camera[2]).to(gaussians.means)
    depth = gaussians.means @ row[:3] + row[3]
    return torch.where(image.radii > 0, float(camera.intrinsics[0, 0]) / depth.clamp(min=1e-6), 0.0)
