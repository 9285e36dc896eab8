"""Nearest neighbours among Gaussians, and the embedding smoothness (FRoG, section on optimisation).

Neighbours are found by a tree of OpenCV on the CPU, and by all distances, in pieces, on a GPU. Dynamic neighbours have
similar embeddings.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...cuda import launch
from ...cuda.sources import kernel
from ...recipes import Recipe
from .gaussian_state import GaussianState, Reindexing
from .stateful import Tensors, Values, expect

GPU_PIECE = 16_000_000  # distances held at once: what keeps a GPU busy
_LEAF = 10  # points of a leaf of the tree


def nearest(
    points: torch.Tensor, among: torch.Tensor, count: int, skip_self: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """Distances (P, count) ascending, and indices (P, count) into ``among``; exact, on the points' device.

    Args:
        points: (P, 3) float32.
        among: (M, 3) float32 with M > count.
        count: neighbours asked for; fewer come back when there are fewer.
        skip_self: leave out the nearest, which is the point itself.
    """
    extra = int(skip_self)
    most = min(count + extra, len(among))
    search = by_tree if points.device.type == "cpu" and len(points) and most else by_distances
    squares, indices = search(points.detach(), among.detach(), most)
    return squares[:, extra:].sqrt(), indices[:, extra:].contiguous()


def by_tree(points: torch.Tensor, among: torch.Tensor, most: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Squares of distances and indices, both (P, most); at 40,000 points 20 to 80 times faster than all distances."""
    import cv2

    exact_tree = {"algorithm": 4, "leaf_max_size": _LEAF}  # FLANN_INDEX_KDTREE_SINGLE, which OpenCV has no name for
    index = cv2.flann.Index(among.contiguous().numpy(), exact_tree)
    indices, squares = index.knnSearch(points.contiguous().numpy(), most, params={"checks": -1, "eps": 0.0})
    # A point that is not finite has no neighbours: its places are left as they were in memory.
    return torch.from_numpy(squares), torch.from_numpy(indices).long().clamp_(0, len(among) - 1)


def by_distances(
    points: torch.Tensor, among: torch.Tensor, most: int, piece_size: int = GPU_PIECE
) -> tuple[torch.Tensor, torch.Tensor]:
    """What ``by_tree`` finds, on any device, with ``piece_size`` distances held at once."""
    columns = among.T.contiguous()
    rows = max(1, min(len(points), piece_size // max(1, len(among))))
    squares = points.new_empty(len(points), most)
    indices = torch.empty(len(points), most, dtype=torch.int64, device=points.device)
    for start in range(0, len(points), rows):
        piece = points[start : start + rows]
        # From differences: a matrix product would lose small distances far from the origin.
        square = points.new_zeros(len(piece), len(among))
        for own, other in zip(piece.T, columns, strict=True):
            difference = own[:, None] - other
            square.addcmul_(difference, difference)
        results = squares[start : start + rows], indices[start : start + rows]
        torch.topk(square, most, largest=False, out=results)
    return squares, indices


def spacings(points: torch.Tensor, among: torch.Tensor | None = None) -> torch.Tensor:
    """(P,) root mean square distance to the three nearest neighbours: the size of a fresh Gaussian."""
    own = among is None
    distances, _ = nearest(points, points if among is None else among, 3, skip_self=own)
    if distances.shape[1] == 0:
        return torch.full((len(points),), 0.01, device=points.device)
    return distances.square().mean(1).sqrt().clamp(min=1e-6)


SMOOTHED_EVERY = 4  # steps between two that regularise, each for as many; their dozens of small operations cost time
_BATCH = 64  # anchors of such a step
_PARTS = ("anchors", "neighbours", "weights")


@dataclass(frozen=True)
class NeighbourGraph:
    """A sample of the dynamic Gaussians: anchors (A,), neighbours (A, k), weights (A, k)."""

    anchors: torch.Tensor
    neighbours: torch.Tensor
    weights: torch.Tensor

    @classmethod
    @torch.no_grad()
    def sample(cls, means: torch.Tensor, recipe: Recipe, generator: torch.Generator) -> NeighbourGraph | None:
        """A new sample among ``means`` (M, 3); None where none has a neighbour."""
        if len(means) < 2:
            return None
        chosen = torch.randperm(len(means), generator=generator)[: recipe.smoothness_sample].to(means.device)
        distances, neighbours = nearest(means[chosen], means, recipe.smoothness_neighbours, skip_self=True)
        return cls(chosen, neighbours, neighbour_weights(distances, recipe.smoothness_falloff))

    def reindexed(self, indices: torch.Tensor) -> NeighbourGraph | None:
        """The same sample without the Gaussians that were removed; None without anchors.

        Args:
            indices: (M',) for each place an old index, or a larger one for a new Gaussian.
        """
        if not len(indices):
            return None
        last = int(max(indices.max(), self.neighbours.max(), self.anchors.max()))
        places = torch.full((last + 1,), -1, device=indices.device)
        places[indices] = torch.arange(len(indices), device=indices.device)
        left = places[self.anchors] >= 0
        neighbours = places[self.neighbours[left]]
        weights = torch.where(neighbours >= 0, self.weights[left], 0.0)
        return (
            NeighbourGraph(places[self.anchors[left]], neighbours.clamp(min=0), weights) if bool(left.any()) else None
        )

    @torch.no_grad()
    def add_gradient(self, embeddings: torch.Tensor, step: int, weight: float, size: int | None = None) -> None:
        """Regularises the first ``size`` columns of ``embeddings`` (M, E), or all, for SMOOTHED_EVERY steps at once;
        another part of the sample each time.

        Adds to ``embeddings.grad`` the gradient of the mean over (i, j) of w_ij |e_i - e_j| (the paper's L_emb-reg).
        Written out, because only the few drawn rows have a gradient; automatic differentiation would make one of all
        rows for each of the two look-ups.
        """
        assert embeddings.grad is not None
        start = (step // SMOOTHED_EVERY * _BATCH) % max(1, len(self.anchors))
        part = slice(start, start + _BATCH)
        anchors, neighbours, weights = self.anchors[part], self.neighbours[part], self.weights[part]
        compared, gradients = embeddings[:, :size], embeddings.grad[:, :size]
        scale = SMOOTHED_EVERY * weight / weights.numel()
        if launch.on_gpu(embeddings):
            sizes, graph = (*weights.shape, compared.shape[1], embeddings.shape[1]), (anchors, neighbours, weights)
            launcher, blocks = launch.launcher_for(embeddings.device), launch.blocks_for(32 * (1 + sizes[1]) * sizes[0])
            launcher.launch(kernel("smooth"), blocks, *sizes, embeddings, *graph, scale, embeddings.grad)
            return
        differences = compared[anchors][:, None] - compared[neighbours]
        lengths = (differences.square().sum(-1) + 1e-12).sqrt()
        gradient = differences * (scale * weights / lengths)[..., None]
        gradients.index_add_(0, anchors, gradient.sum(1))
        gradients.index_add_(0, neighbours.flatten(), gradient.flatten(0, 1), alpha=-1)


class EmbeddingSmoothness:
    """The regularization of one training.

    Args:
        gaussians: to follow.
        recipe: sample size, falloff and weight.
        generator: that samples are drawn with.

    Attributes:
        graph: the sample; None before the first one is drawn, and where none has a neighbour.
    """

    def __init__(self, gaussians: GaussianState, recipe: Recipe, generator: torch.Generator) -> None:
        self._recipe, self._generator, self._canonical = recipe, generator, gaussians.canonical
        self.graph: NeighbourGraph | None = None
        gaussians.register(self.reindex)

    def resample(self) -> None:
        """Draws the sample anew."""
        means = self._canonical.means.detach()[: self._canonical.num_dynamic]
        self.graph = NeighbourGraph.sample(means, self._recipe, self._generator)

    def reindex(self, change: Reindexing) -> None:
        """See ``GaussianState.register``."""
        if self.graph is None:
            return
        if change.resample:
            self.resample()
        else:
            self.graph = self.graph.reindexed(change.dynamic)

    def add_gradient(self, step: int) -> None:
        """Regularises the embeddings for SMOOTHED_EVERY steps at once."""
        if self.graph is not None and self._recipe.smoothness_weight:
            size = self._recipe.embedding_size  # what follows are time windows: neighbours may have others
            self.graph.add_gradient(self._canonical.embeddings, step, self._recipe.smoothness_weight, size)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return {f"neighbourhood.{name}": getattr(self.graph, name) for name in _PARTS if self.graph}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        self.graph = None
        if "neighbourhood.anchors" not in tensors:
            return
        anchors, neighbours, weights = (tensors[f"neighbourhood.{name}"] for name in _PARTS)
        dynamic = (0, self._canonical.num_dynamic - 1)
        expect("anchors", anchors, (len(anchors),), torch.int64, dynamic)
        expect("neighbours", neighbours, (len(anchors), *neighbours.shape[1:2]), torch.int64, dynamic)
        expect("weights", weights, tuple(neighbours.shape))
        if not neighbours.numel():
            raise ValueError("no neighbours")
        self.graph = NeighbourGraph(*(part.to(self._canonical.means.device) for part in (anchors, neighbours, weights)))


def neighbour_weights(distances: torch.Tensor, falloff: float) -> torch.Tensor:
    """exp(-falloff d^2) with d in units of the median nearest-neighbour distance, which makes it free of scene units.

    Args:
        distances: (A, k) ascending along k, world units.
    """
    unit = distances[:, 0].median().clamp(min=1e-12)
    return torch.exp(-falloff * (distances / unit).square())
