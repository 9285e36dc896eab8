"""Adam over all parameters in one call of the native library, on all its threads."""

from __future__ import annotations

import ctypes
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

import torch

from ...native import structs
from ...native.binding import library

_EPSILON = 1e-15  # 3DGS's: gradients of means are tiny

ParameterGroup: TypeAlias = dict[str, Any]
"""As torch's optimizers have them: parameters under "params", settings of any type beside them."""


class NativeAdam:
    """``torch.optim.Adam`` for float32 parameters on the CPU, with the same ``param_groups`` and the same memory in
    ``state`` ("step" is an int).

    Half of the time of torch's fused one: that works on one thread in a training's step, and is called for each group.
    The library's threads write a denormal as zero, so old moments end there.

    It does not derive from torch's: making one of those imports torch's compiler, which takes seconds, and where Triton
    is installed that library's LLVM besides, which crashes a Blender that has loaded its own.

    Args:
        groups: dicts with "params" and settings that differ from the others.
        lr, betas, eps: of groups that say nothing else.
    """

    def __init__(
        self,
        groups: Iterable[ParameterGroup],
        lr: float = 1e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        defaults = {"lr": lr, "betas": betas, "eps": eps}
        self.param_groups: list[ParameterGroup] = [
            {**defaults, **group, "params": list(group["params"])} for group in groups
        ]
        self.state: defaultdict[torch.Tensor, ParameterGroup] = defaultdict(dict)

    @torch.no_grad()
    def step(self) -> None:
        """One step for every parameter that has a gradient; TypeError for other parameters than those."""
        entries, kept = [], []  # gradients made contiguous live until the call is over
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    gradient = parameter.grad.contiguous()
                    kept.append(gradient)
                    entries.append(self._entry(parameter, gradient, group))
        if library().frog_adam((structs.Adam * len(entries))(*entries), len(entries)):
            raise MemoryError("the optimiser ran out of memory")

    def _entry(self, parameter: torch.Tensor, gradient: torch.Tensor, group: ParameterGroup) -> ctypes.Structure:
        for array in (parameter, gradient):  # native code only sees addresses
            if not (array.dtype is torch.float32 and array.is_cpu and array.is_contiguous()):
                raise TypeError(f"expected contiguous float32 on the CPU, found {array.dtype} on {array.device}")
        if gradient.numel() != parameter.numel():
            raise TypeError(f"expected a gradient of {parameter.numel()} numbers, found {gradient.numel()}")
        state = self.state[parameter]
        if not state:  # steps are a plain number: counting in tensors took a tenth as long as the step itself
            state.update(step=0, exp_avg=torch.zeros_like(parameter), exp_avg_sq=torch.zeros_like(parameter))
        state["step"] += 1
        count, (first, second) = state["step"], group["betas"]
        return structs.Adam(
            *(parameter.data_ptr(), gradient.data_ptr(), state["exp_avg"].data_ptr(), state["exp_avg_sq"].data_ptr()),
            parameter.numel(),
            *(1 - first, 1 - second, group["lr"] / (1 - first**count), (1 - second**count) ** -0.5, group["eps"]),
        )


def adam_on(device: torch.device, groups: list[ParameterGroup]) -> NativeAdam | torch.optim.Adam:
    """The fastest for parameters that lie on ``device``."""
    if device.type == "cpu":
        return NativeAdam(groups, eps=_EPSILON)
    with _without_triton():
        return torch.optim.Adam(groups, eps=_EPSILON, fused=True)


@contextmanager
def _without_triton() -> Iterator[None]:
    """Keeps Triton out of a Blender that has not loaded it: making torch's optimizer imports torch's compiler, which
    imports Triton where it is installed, and the LLVM of that and Blender's own in one process end in a crash.

    Afterwards whoever else wants Triton can import it.
    """
    if "bpy" not in sys.modules or "triton" in sys.modules:
        yield
        return
    sys.modules["triton"] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules["triton"]
