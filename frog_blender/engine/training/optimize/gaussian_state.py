"""The Gaussians of a training: the one owner of everything that has a row for each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import nn

from ...model.canonical import ATTRIBUTES, CanonicalField
from ...model.interface import SceneModel
from ..recipe import Recipe
from .optimizer import SceneOptimizer
from .stateful import Tensors, Values, expect


@dataclass(frozen=True)
class Reindexing:
    """How Gaussians were put into another order, some left out, some new.

    Attributes:
        indices: (N',) the old index of the Gaussian in each place; the old count or more for a new one.
        dynamic: (M',) the same among the dynamic ones alone; the old number of them or more for one that was not.
        count, num_dynamic: the old ones, N and M.
        canonical: the canonical field as it is now.
        resample: samples of the Gaussians are to be drawn anew, rather than carried over.
    """

    indices: torch.Tensor
    dynamic: torch.Tensor
    count: int
    num_dynamic: int
    canonical: CanonicalField
    resample: bool


class RowFollower(Protocol):
    """Something that is kept by Gaussian, and follows when their rows change."""

    def reindex(self, change: Reindexing) -> None:
        """Called after every change of the rows."""
        ...


class GaussianState:
    """Parameters and optimizer moments by Gaussian, and whatever else has registered. Only ``reindex`` changes rows.

    Args:
        model: a method; its canonical field holds the Gaussians, dynamic ones first.
        recipe: the learning rates.
        scene_scale: world units.

    Attributes:
        model: the same.
        optimizer: of all the model's parameters.
    """

    def __init__(self, model: SceneModel, recipe: Recipe, scene_scale: float) -> None:
        self.model = model
        self._recipe, self._scene_scale = recipe, scene_scale
        self.optimizer = SceneOptimizer(model, recipe, scene_scale)
        self._followers: list[RowFollower] = []

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

    def register(self, follower: RowFollower) -> None:
        """From now on ``follower`` is told of every change of the rows."""
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
        dynamic = indices[:num_dynamic]
        fresh = dynamic >= before
        dynamic = torch.where(fresh, before - 1 + fresh.cumsum(0), dynamic)
        self.optimizer.reindex(indices, dynamic, new or {})
        change = Reindexing(indices, dynamic, count, before, self.canonical, resample)
        for follower in self._followers:
            follower.reindex(change)

    def keep(self, indices: torch.Tensor) -> None:
        """Removes all but some Gaussians (indices, ascending)."""
        self.reindex(indices, int((indices < self.num_dynamic).sum()))

    def replace(self, keep: torch.Tensor, new: Tensors) -> torch.Tensor:
        """Keeps the Gaussians ``keep`` (indices, ascending) and adds ``new`` ones, dynamic before static: in the places
        of those that leave, as far as there are any.

        Args:
            new: (n, ...) of each attribute; ``embeddings`` (m, E) of the first m of them, which are dynamic.

        Returns:
            (N',) for every place the old index of the Gaussian there, or the old count + the index of a new one.
        """
        count, before = self.count, self.num_dynamic
        arrivals = torch.arange(len(new["means"]), device=keep.device) + count
        m, places = len(new["embeddings"]), torch.full((count,), -1, device=keep.device)
        places[keep] = keep
        dynamic = _filled(places[:before], arrivals[:m])
        indices = torch.cat([dynamic, _filled(places[before:], arrivals[m:])])
        self.reindex(indices, len(dynamic), new, resample=False)
        return indices

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
        found = {name: tensors[f"model.canonical.{name}"] for name in ATTRIBUTES}
        count, num_dynamic = len(found["means"]), len(found["embeddings"])
        coefficients = found["sh"].shape[1]
        if coefficients not in [(degree + 1) ** 2 for degree in range(self._recipe.sh_degree + 1)]:
            raise ValueError(f"{coefficients} SH coefficients")
        if not 0 <= num_dynamic <= count > 0:
            raise ValueError(f"{num_dynamic} dynamic Gaussians of {count}")
        shapes = {"sh": (count, coefficients, 3), "embeddings": (num_dynamic, self.canonical.embeddings.shape[1])}
        shapes |= {"means": (count, 3), "log_scales": (count, 3), "quaternions": (count, 4), "opacity_logits": (count,)}
        return {name: expect(name, found[name], shapes[name]).to(self.device) for name in ATTRIBUTES}


def _filled(places: torch.Tensor, arrivals: torch.Tensor) -> torch.Tensor:
    """The index in each place when ``arrivals`` take the free ``places`` (-1): behind the others where they are more
    than that, and without what is free where they are fewer."""
    free = (places < 0).nonzero().squeeze(1)[: len(arrivals)]
    places = places.index_copy(0, free, arrivals[: len(free)])
    return torch.cat([places[places >= 0], arrivals[len(free) :]])
