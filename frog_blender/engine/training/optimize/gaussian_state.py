"""The Gaussians of a training: the one owner of what has a row for each, their order, and how large they may be.

An image says how wide a Gaussian is, not how deep: what reaches behind an edge that no training image looks behind
shows as a fringe from the next side (the size regularization of 3DGS-MCMC, Kheradmand 2024, keeps it small). And what
is so large that it wraps the cameras backs all walls with one colour, which is a fog from anywhere else. What is
thinner than a pixel is seen by the low-pass alone, and thins out before a camera that comes nearer (Mip-Splatting, Yu
2024).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from ...arrays import Float32s
from ...capture.camera import Camera, evenly_chosen
from ...capture.capture import Capture
from ...cuda import launch
from ...model.canonical import ATTRIBUTES, CanonicalField
from ...model.interface import SceneModel
from ...recipes import Recipe
from .optimizer import SceneOptimizer
from .stateful import Tensors, Values, expect


@dataclass(frozen=True)
class Reindexing:
    """How Gaussians were put into another order, some left out, some new.

    Attributes:
        indices: (N',) the old index of the Gaussian in each place; the old count or more for a new one.
        dynamic: (M',) the same among the dynamic ones alone; the old number of them or more for one that was not.
        count, num_dynamic: the old ones, N and M.
        resample: samples of the Gaussians are to be drawn anew, rather than carried over.
    """

    indices: torch.Tensor
    dynamic: torch.Tensor
    count: int
    num_dynamic: int
    resample: bool


class GaussianState:
    """Parameters and optimizer moments by Gaussian, and whatever else has registered. Only ``reindex`` changes rows.

    Args:
        model: a method; its canonical field holds the Gaussians, dynamic ones first.
        recipe: the learning rates.
        scene_scale: world units.

    Attributes:
        model: the same.
        optimizer: of all the model's parameters.
        added, removed: Gaussians that changes of the rows brought and took, since this object was made.
    """

    def __init__(self, model: SceneModel, recipe: Recipe, scene_scale: float) -> None:
        self.model = model
        self._recipe, self._scene_scale = recipe, scene_scale
        self.optimizer = SceneOptimizer(model, recipe, scene_scale)
        self._followers: list[Callable[[Reindexing], None]] = []
        self.added = self.removed = 0

    @property
    def canonical(self) -> CanonicalField:
        """The canonical field."""
        return self.model.canonical

    @property
    def count(self) -> int:
        """Gaussians, N."""
        return len(self.canonical)

    @property
    def num_dynamic(self) -> int:
        """Gaussians that are deformed, M."""
        return self.canonical.num_dynamic

    @property
    def device(self) -> torch.device:
        """Where they lie."""
        return self.canonical.means.device

    def register(self, follower: Callable[[Reindexing], None]) -> None:
        """From now on ``follower`` is told of every change of the rows: something is kept by Gaussian there."""
        self._followers.append(follower)

    def reindex(
        self, indices: torch.Tensor, num_dynamic: int, new: Tensors | None = None, *, resample: bool = True
    ) -> None:
        """Puts Gaussians into another order, some left out, some new, with everything that is kept by Gaussian.

        Args:
            indices: (N',) for each place a row of the old ones with the ``new`` ones after them.
            num_dynamic: the first M' places are dynamic.
            new: (n, ...) by attribute, which can be left out where nothing is new; ``embeddings`` (m, E) of the places
                whose Gaussians were not dynamic, in their order.
            resample: see ``Reindexing``.
        """
        count, before = self.count, self.num_dynamic
        added = int((indices >= count).sum())
        self.added, self.removed = self.added + added, self.removed + count + added - len(indices)
        dynamic = indices[:num_dynamic]
        fresh = dynamic >= before
        dynamic = torch.where(fresh, before - 1 + fresh.cumsum(0), dynamic)
        self.optimizer.reindex(indices, dynamic, new or {})
        change = Reindexing(indices, dynamic, count, before, resample)
        for follower in self._followers:
            follower(change)

    def keep(self, indices: torch.Tensor) -> None:
        """Removes all but some Gaussians (indices, ascending)."""
        self.reindex(indices, int((indices < self.num_dynamic).sum()))

    def replace(self, keep: torch.Tensor, new: Tensors) -> None:
        """Keeps the Gaussians ``keep`` (indices, ascending) and adds ``new`` ones, dynamic before static: in the places
        of those that leave, as far as there are any.

        Args:
            new: (n, ...) of each attribute; ``embeddings`` (m, E) of the first m of them, which are dynamic.
        """
        count, before = self.count, self.num_dynamic
        arrivals = torch.arange(len(new["means"]), device=keep.device) + count
        m, places = len(new["embeddings"]), torch.full((count,), -1, device=keep.device)
        places[keep] = keep
        dynamic = _filled(places[:before], arrivals[:m])
        indices = torch.cat([dynamic, _filled(places[before:], arrivals[m:])])
        self.reindex(indices, len(dynamic), new, resample=False)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        values = {"rate_factor": self.optimizer.rate_factor}
        return tensors | self.optimizer.state_arrays(), values

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful. Followers are not told: they take their own out of the same checkpoint."""
        model = self.model
        for name, attribute in self._checked(tensors).items():
            setattr(model.canonical, name, nn.Parameter(attribute))
        model.load_state_dict({name[6:]: value for name, value in tensors.items() if name.startswith("model.")})
        model.zero_grad(set_to_none=True)
        self.optimizer = SceneOptimizer(model, self._recipe, self._scene_scale)
        self.optimizer.resume(tensors, float(values["rate_factor"]))

    def _checked(self, tensors: Tensors) -> Tensors:
        """The canonical attributes on the device; ValueError unless there is a row for every Gaussian."""
        attributes = {name: tensors[f"model.canonical.{name}"] for name in ATTRIBUTES}
        count, num_dynamic = len(attributes["means"]), len(attributes["embeddings"])
        if not 0 <= num_dynamic <= count > 0:
            raise ValueError(f"{num_dynamic} dynamic Gaussians of {count}")
        for name, values in attributes.items():
            rows = num_dynamic if name == "embeddings" else count
            expect(name, values, (rows, *getattr(self.canonical, name).shape[1:]))
        return {name: values.to(self.device) for name, values in attributes.items()}


def _filled(places: torch.Tensor, arrivals: torch.Tensor) -> torch.Tensor:
    """The index in each place when ``arrivals`` take the free ``places`` (-1): behind the others where they are more
    than that, and without what is free where they are fewer."""
    free = (places < 0).nonzero().squeeze(1)[: len(arrivals)]
    places = places.index_copy(0, free, arrivals[: len(free)])
    return torch.cat([places[places >= 0], arrivals[len(free) :]])


def mask_excluding(indices: torch.Tensor, count: int) -> torch.Tensor:
    """(count,) true but for ``indices``."""
    keep = torch.ones(count, dtype=torch.bool, device=indices.device)
    keep[indices] = False
    return keep


def sort_by_morton_code(gaussians: GaussianState) -> None:
    """Makes steps faster, those on crops most: what they draw lies together (docs/experiments)."""
    means, first = gaussians.canonical.means.detach(), gaussians.num_dynamic
    order = torch.cat([morton_order(means[:first]), first + morton_order(means[first:])])
    gaussians.reindex(order, first, resample=False)


def morton_order(means: torch.Tensor) -> torch.Tensor:
    """``scene.quantization.morton_order`` of ``means`` (N, 3), the same order, where they lie."""
    ordered = means.T.sort().values.T if len(means) else means.new_zeros(1, 3)

    def quantile(share: float) -> torch.Tensor:
        place = share * (len(ordered) - 1)
        below, above = ordered[int(place)], ordered[math.ceil(place)]
        step, rest = (above - below).double(), place - int(place)
        return below + rest * step if rest < 0.5 else above - (1 - rest) * step

    least, largest = quantile(0.01), quantile(0.99)
    shares = (means.clamp(least, largest) - least) / (largest - least).clamp(min=1e-12)
    cells = (shares * (2**16 - 1)).long()
    for shift, mask in ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249)):
        cells = (cells | cells << shift) & mask  # two places between its bits, for those of the other axes
    x, y, z = cells.unbind(1)
    return (x | y << 1 | z << 2).argsort(stable=True)


def freeze_motion(gaussians: GaussianState, indices: torch.Tensor, state: Tensors) -> None:
    """Makes dynamic Gaussians static.

    Args:
        indices: of dynamic ones, ascending.
        state: how all dynamic ones look from now on, see ``Sensitivity.state``.
    """
    for name, values in state.items():
        parameter = getattr(gaussians.canonical, name).data
        if name == "sh":  # without degrees that have not begun
            count = min(parameter.shape[1], values.shape[1])
            parameter, values = parameter[:, :count], values[:, :count]
        parameter[indices] = values[indices]
    dynamic = mask_excluding(indices, gaussians.num_dynamic).nonzero().squeeze(1)
    static = torch.arange(gaussians.num_dynamic, gaussians.count, device=indices.device)
    gaussians.reindex(torch.cat([dynamic, indices, static]), len(dynamic))


@torch.no_grad()
def add_size_gradient(canonical: CanonicalField, weight: float, unit: float) -> None:
    """Adds to the log scales' gradient that of ``weight`` times the mean standard deviation over all Gaussians and
    axes; nothing where a step has seen none of them.

    Args:
        unit: world units, which the standard deviations are divided by.
    """
    log_scales = canonical.log_scales
    if log_scales.grad is not None and log_scales.numel():
        log_scales.grad.add_(log_scales.exp(), alpha=weight / (unit * log_scales.numel()))


@torch.no_grad()
def limit_sizes(canonical: CanonicalField, capture: Capture, share: float, nearest: float) -> None:
    """Shrinks what has a standard deviation of more than ``share`` of its distance to the nearest training camera.

    Args:
        nearest: world units, which every distance is taken for at least.
    """
    means, log_scales = canonical.means, canonical.log_scales
    distances = torch.full((len(means),), torch.inf, dtype=means.dtype, device=means.device)
    places = np.array([capture.cameras[index].center for index in capture.train_cameras], np.float32)
    for center in launch.sent(torch.from_numpy(places), means.device):
        torch.minimum(distances, (means - center).norm(dim=1), out=distances)
    most = (share * distances.clamp(min=nearest)).log()[:, None]
    log_scales.copy_(torch.minimum(log_scales, most))


def look_through(camera: Camera, points: torch.Tensor, beside: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Depths (N,) of points (N, 3) float32, world units, and which of them (N,) are in the camera's image.

    Args:
        beside: share of the image's sides by which a point may lie beside it.
    """
    rows: Float32s = (camera.intrinsics @ camera.world_to_camera[:3]).astype(np.float32)
    if launch.on_gpu(points):
        there = launch.sent(torch.from_numpy(rows), points.device)
        x, y, depth = there[:, :3] @ points.T + there[:, 3:]
    else:  # by numpy, whose product is rounded once
        x, y, depth = torch.from_numpy(rows[:, :3] @ points.cpu().numpy().T + rows[:, 3:]).to(points.device)
    reach = (1 + 2 * beside) * depth
    inside = ((2 * x - camera.width * depth).abs() <= camera.width * reach) & (depth > 0)
    inside &= (2 * y - camera.height * depth).abs() <= camera.height * reach
    return depth, inside


def pixel_sizes(means: torch.Tensor, cameras: Sequence[Camera]) -> torch.Tensor:
    """(N,) world units that a pixel takes at places (N, 3) float32: in the camera that sees each finest, or in the
    nearest one where none sees it."""
    sizes = torch.full_like(means[:, 0], torch.inf)
    some = [(camera, 1 / float(camera.intrinsics.diagonal()[:2].max())) for camera in evenly_chosen(cameras)]
    for camera, unit in some:
        depth, inside = look_through(camera, means)
        sizes = torch.where(inside, torch.minimum(sizes, unit * depth), sizes)
    unseen = sizes.isinf().nonzero().squeeze(1)
    for camera, unit in some:
        sizes[unseen] = torch.minimum(sizes[unseen], unit * distances(means[unseen], camera))
    return sizes.clamp(min=1e-12)


def distances(points: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(N,) of points (N, 3) float32 from where the camera stands."""
    center = launch.sent(torch.from_numpy(camera.center.astype(np.float32)), points.device)
    x, y, z = (points - center).square().unbind(1)
    return (x + y + z).double().sqrt().float()  # a root of float32 is not always rounded right on the CPU


class LeastSizes:
    """Keeps every Gaussian as wide as a share of a pixel of the training camera that sees it finest.

    Args:
        pixels: that share, a standard deviation.
    """

    def __init__(self, gaussians: GaussianState, capture: Capture, pixels: float) -> None:
        self._canonical, self._pixels = gaussians.canonical, pixels
        self._cameras = [capture.cameras[index] for index in capture.train_cameras]
        self._logarithms: torch.Tensor | None = None
        gaussians.register(lambda _: self.measure_again())

    def measure_again(self) -> None:
        """Before the next step: Gaussians have moved, or are others."""
        self._logarithms = None

    @torch.no_grad()
    def apply(self) -> None:
        """Widens what is thinner."""
        if self._logarithms is None:
            self._logarithms = (self._pixels * pixel_sizes(self._canonical.means, self._cameras)).log()[:, None]
        log_scales = self._canonical.log_scales
        torch.maximum(log_scales, self._logarithms, out=log_scales)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return {} if self._logarithms is None else {"least_sizes": self._logarithms}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        self._logarithms = None
        if "least_sizes" in tensors:
            shape = (len(self._canonical), 1)
            self._logarithms = expect("least_sizes", tensors["least_sizes"], shape).to(self._canonical.means.device)
