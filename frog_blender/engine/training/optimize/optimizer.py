"""Adam over parameters that change their shapes as Gaussians come and go, in one call of native code or one launch."""

import ctypes
from collections import defaultdict
from collections.abc import Iterable
from typing import Any, TypeAlias

import torch
from torch import nn

from ...cuda import adam, launch
from ...errors import FrogError
from ...model.canonical import ATTRIBUTES
from ...model.frog import Frog
from ...model.interface import SceneModel
from ...model.time_windows import has_windows, keep_apart
from ...native import structs
from ...native.binding import library
from ...recipes import Recipe
from .stateful import Tensors, expect

_EPSILON = 1e-15  # 3DGS's: gradients of means are tiny

ParameterGroup: TypeAlias = dict[str, Any]
"""As torch's optimizers have them: parameters under "params", settings of any type beside them."""


class NativeAdam:
    """``torch.optim.Adam`` for float32 parameters on the CPU or an NVIDIA GPU, with the same ``param_groups`` and the
    same memory in ``state`` ("step" is an int).

    Half of the time of torch's fused one on the CPU: that works on one thread in a training's step, and is called for
    each group. The library's threads write a denormal as zero, so old moments end there.

    It does not derive from torch's: making one of those imports torch's compiler, which takes seconds, and where Triton
    is installed that library's LLVM besides, which crashes a Blender that has loaded its own.

    Args:
        groups: dicts with "params" and settings that differ from the others.
        lr, eps: of groups that say nothing else.
    """

    def __init__(self, groups: Iterable[ParameterGroup], lr: float = 1e-3, eps: float = 1e-8) -> None:
        defaults = {"lr": lr, "betas": (0.9, 0.999), "eps": eps}
        self.param_groups: list[ParameterGroup] = [defaults | group for group in groups]
        self.state: defaultdict[torch.Tensor, ParameterGroup] = defaultdict(dict)

    @torch.no_grad()
    def step(self, state: torch.Tensor | None = None, again: bool = False) -> None:
        """One step for every parameter that has a gradient; TypeError for other parameters than those.

        Args:
            state: of the drawing that the gradients come from, see ``cuda.adam``; on a GPU alone.
            again: the last step was not made, for its drawing had no room: this one is in its place.
        """
        entries, kept = [], []  # gradients made contiguous live until the call is over
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    gradient = parameter.grad.contiguous()
                    kept.append(gradient)
                    entries.append(self._entry(parameter, gradient, group, again))
        if kept and launch.on_gpu(kept[0]):
            adam.step(kept[0].device, entries, state)
        elif library().frog_adam((structs.Adam * len(entries))(*entries), len(entries)):
            raise MemoryError("the optimiser ran out of memory")

    def _entry(
        self, parameter: torch.Tensor, gradient: torch.Tensor, group: ParameterGroup, again: bool
    ) -> ctypes.Structure:
        for array in (parameter, gradient):  # native code and kernels only see addresses
            here = array.is_cpu or launch.on_gpu(array)
            if not (array.dtype is torch.float32 and here and array.is_contiguous()):
                raise TypeError(
                    f"expected contiguous float32 on the CPU or a GPU, found {array.dtype} on {array.device}"
                )
        if gradient.numel() != parameter.numel():
            raise TypeError(f"expected a gradient of {parameter.numel()} numbers, found {gradient.numel()}")
        state = self.state[parameter]
        if not state:  # steps are a plain number: counting in tensors took a tenth as long as the step itself
            state.update(step=0, exp_avg=torch.zeros_like(parameter), exp_avg_sq=torch.zeros_like(parameter))
        state["step"] += not again
        count, (first, second) = state["step"], group["betas"]
        return structs.Adam(
            *(parameter.data_ptr(), gradient.data_ptr(), state["exp_avg"].data_ptr(), state["exp_avg_sq"].data_ptr()),
            parameter.numel(),
            *(1 - first, 1 - second, group["lr"] / (1 - first**count), (1 - second**count) ** -0.5, group["eps"]),
        )


_MOMENTS = ("exp_avg", "exp_avg_sq")


class SceneOptimizer:
    """One parameter group for each canonical attribute, and one for each of the model's own (``rate_groups``).

    Args:
        model: a method.
        recipe: the rates.
        scene_scale: world units; multiplies the rate of the means.

    Attributes:
        rate_factor: multiplies every rate, see session.recovery.
    """

    def __init__(self, model: SceneModel, recipe: Recipe, scene_scale: float) -> None:
        self._canonical = model.canonical
        self._with_windows = model if isinstance(model, Frog) and has_windows(model) else None
        decay, attribute_decay = recipe.rate_decay, recipe.attribute_decay
        rates = {
            "means": (recipe.mean_rate * scene_scale, recipe.mean_decay or decay),
            "log_scales": (recipe.scale_rate, attribute_decay),
            "quaternions": (recipe.rotation_rate, attribute_decay),
            "opacity_logits": (recipe.opacity_rate, attribute_decay),
            "sh": (recipe.color_rate, attribute_decay),
            "embeddings": (recipe.embedding_rate, decay),
            "temporal": (recipe.temporal_rate, decay),
            "network": (recipe.network_rate, decay),
            "grid": (recipe.grid_rate, decay),
        }
        groups: list[ParameterGroup] = [
            {"params": [getattr(self._canonical, name)], "name": name}
            for name in ATTRIBUTES
            if getattr(self._canonical, name).shape[1:].numel()  # methods without embeddings have some of no length
        ]
        groups += [{"params": parameters, "name": name} for name, parameters in model.rate_groups().items()]
        _expect_rates(model, groups, rates)
        self._rates, self._cool_down, self.rate_factor = rates, recipe.cool_down, 1.0
        self.adam = NativeAdam(groups, eps=_EPSILON)
        self.schedule(0.0)

    def schedule(self, progress: float) -> None:
        """Sets the rates for ``progress`` in [0, 1]: exponential decay, and the cool-down at the end."""
        left = 1.0 - progress
        factor = self.rate_factor * (left / self._cool_down if left < self._cool_down else 1.0)
        for group in self.adam.param_groups:
            start, decay = self._rates[group["name"]]
            group["lr"] = factor * start * decay**progress

    def step(self, state: torch.Tensor | None = None, again: bool = False) -> None:
        """See NativeAdam; clears the gradients."""
        self.adam.step(state, again)
        if self._with_windows is not None:
            keep_apart(self._with_windows)
        for group in self.adam.param_groups:  # torch's own zero_grad takes ten times as long
            for parameter in group["params"]:
                parameter.grad = None

    def reindex(self, indices: torch.Tensor, dynamic: torch.Tensor, new: Tensors) -> None:
        """Puts the rows of the Gaussians into another order, their moments with them; for ``GaussianState`` alone.

        Args:
            indices: (N',) for each place a row of the old ones with the ``new`` ones after them.
            dynamic: (M',) the same for the rows of the embeddings.
            new: (n, ...) by attribute; none where one is missing.
        """
        for name in ATTRIBUTES:
            self._replace(name, dynamic if name == "embeddings" else indices, new.get(name))

    def _replace(self, name: str, kept: torch.Tensor, new: torch.Tensor | None) -> None:
        """An attribute becomes the rows ``kept`` of its own with the ``new`` ones after them, whose moments are zero.
        Where few change, they alone are written."""
        old = getattr(self._canonical, name)
        fresh = old.detach()[:0] if new is None else new
        no_moments = torch.zeros_like(fresh)
        if len(kept) == len(old):
            changed = (kept != torch.arange(len(old), device=kept.device)).nonzero().squeeze(1)
            if len(changed) <= len(old) // 4:
                state = self.adam.state.get(old, {})
                for array, added in ((old.detach(), fresh), *((state[key], no_moments) for key in _MOMENTS if state)):
                    array[changed] = _rows(array, added, kept[changed])
                return
        parameter = nn.Parameter(_rows(old.detach(), fresh, kept))
        setattr(self._canonical, name, parameter)
        for group in self.adam.param_groups:
            group["params"] = [parameter if other is old else other for other in group["params"]]
        if state := self.adam.state.pop(old, {}):
            moments = {key: _rows(state[key], no_moments, kept) for key in _MOMENTS}
            self.adam.state[parameter] = {"step": state["step"], **moments}

    def state_arrays(self) -> Tensors:
        """Adam's moments and step counts by name, for a checkpoint."""
        arrays = {}
        for group in self.adam.param_groups:
            for index, parameter in enumerate(group["params"]):
                for key, value in self.adam.state.get(parameter, {}).items():
                    if isinstance(value, int):
                        value = torch.tensor(float(value), device="cpu")
                    arrays[f"adam.{group['name']}.{index}.{key}"] = value
        return arrays

    def resume(self, arrays: Tensors, rate_factor: float) -> None:
        """Goes on with what ``state_arrays`` gave; ValueError or KeyError for what does not fit the parameters."""
        if not 0 < rate_factor <= 1:
            raise ValueError(f"rates times {rate_factor}")
        self.rate_factor = rate_factor
        for group in self.adam.param_groups:
            for index, parameter in enumerate(group["params"]):
                prefix = f"adam.{group['name']}.{index}."
                if any(name.startswith(prefix) for name in arrays):
                    self.adam.state[parameter] = self._moments(arrays, prefix, parameter)

    def _moments(self, arrays: Tensors, prefix: str, parameter: nn.Parameter) -> dict[str, torch.Tensor | int]:
        device = parameter.device
        moments = {name: expect(prefix + name, arrays[prefix + name], parameter.shape).to(device) for name in _MOMENTS}
        step = expect(f"{prefix}step", arrays[f"{prefix}step"], ())
        if not (step >= 0 and float(step).is_integer()):
            raise ValueError(f"{prefix}step is {float(step)}")
        return {"step": int(step), **moments}


def _expect_rates(model: SceneModel, groups: Iterable[ParameterGroup], rates: Iterable[str]) -> None:
    """FrogError for a model's parameter that no rate drives, which would silently stay as it is."""
    if unknown := {group["name"] for group in groups} - {*rates}:
        raise FrogError(
            f"The method's rate_groups has {', '.join(sorted(unknown))}, expected some of {', '.join(rates)}."
        )
    driven = {id(parameter) for group in groups for parameter in group["params"]}
    left = [name for name, each in model.named_parameters() if each.numel() and id(each) not in driven]
    if left:
        raise FrogError(f"The method's rate_groups lacks {', '.join(left)}: nothing would train what it leaves out.")


def _rows(old: torch.Tensor, new: torch.Tensor, which: torch.Tensor) -> torch.Tensor:
    """Rows ``which`` of the old ones with the new ones after them."""
    if not len(new):
        return old[which]
    if not len(old):
        return new[which]
    rows = old[which.clamp(max=len(old) - 1)]
    added = which >= len(old)
    rows[added] = new[which[added] - len(old)]
    return rows
