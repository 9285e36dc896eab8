"""A pretended GPU: tensors that are computed on the CPU and say that they are elsewhere.

What would fail on a GPU fails here: devices mixed in one operation, and numpy views of what is elsewhere. What would
make the host wait for a GPU is counted, and so is what is made without saying where.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

ELSEWHERE = torch.device("lazy", 0)  # a device that torch knows and has no kernels for
aten = torch.ops.aten
_COPIES = {aten._to_copy.default, aten.copy_.default}
# The sizes of their results depend on values, or they are values: the host waits for them.
_WAITING = {aten.nonzero.default, aten.masked_select.default, aten._local_scalar_dense.default, aten.equal.default}
_INDEXING = {aten.index.Tensor, aten.index_put_.default, aten._index_put_impl_.default}
_FACTORIES = {
    *(torch.tensor, torch.as_tensor, torch.zeros, torch.ones, torch.empty, torch.full, torch.arange, torch.linspace),
    *(torch.eye, torch.rand, torch.randn, torch.randint, torch.randperm),
}
_PRODUCTS = {torch.matmul, torch.Tensor.matmul, torch.Tensor.__matmul__}


class Remote(torch.Tensor):
    """A tensor on ELSEWHERE; ``here`` holds its numbers."""

    here: torch.Tensor

    @staticmethod
    def __new__(cls, here: torch.Tensor) -> Remote:
        layout = here.shape, here.stride(), here.storage_offset()
        remote = torch.Tensor._make_wrapper_subclass(cls, *layout, dtype=here.dtype, device=ELSEWHERE)
        remote.here = here
        return remote

    def data_ptr(self) -> int:
        """Where an emulated kernel finds the numbers."""
        return self.here.data_ptr()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise AssertionError(f"{func}: a tensor elsewhere is used where there is no machine")


class Machine:
    """ELSEWHERE exists inside ``with machine:``.

    Attributes:
        waits: how often the host waited for values or for a copy, by operation ("fetch", "upload").
        fetches: copies from ELSEWHERE that nobody waited for.
        work: operations that torch does there, copies among them, by name: each is a launch at least.
        homeless: where in ``watched`` folders tensors were made without a device.
    """

    def __init__(self, *watched: Path) -> None:
        self.waits: Counter[str] = Counter()
        self.fetches = 0
        self.work: Counter[str] = Counter()
        self.homeless: set[str] = set()
        self.watched = [str(folder) for folder in watched]
        self.counting = True
        self._entered = ExitStack()

    def __enter__(self) -> Machine:
        self._entered.enter_context(_Makers(self))
        self._entered.enter_context(_Operations(self))
        return self

    def __exit__(self, *_: object) -> None:
        self._entered.close()

    @contextmanager
    def uncounted(self) -> Iterator[None]:
        """For what is not what a GPU would do, such as the reference rasterizer."""
        before, self.counting = self.counting, False
        yield
        self.counting = before

    def wait(self, name: str) -> None:
        if self.counting:
            self.waits[name] += 1


class _Makers(TorchFunctionMode):
    """Says who makes tensors without a device, and makes those for ELSEWHERE that come from Python's numbers."""

    def __init__(self, machine: Machine) -> None:
        super().__init__()
        self._machine = machine

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func in _PRODUCTS and isinstance(args[1], Remote) and (args[0].dim(), args[1].dim()) == (1, 2):
            return torch.mm(args[0][None], args[1])[0]  # torch's own way changes a shape in place, unseen from here
        if func not in _FACTORIES:
            return func(*args, **kwargs)
        device = kwargs.get("device")
        if device is None and kwargs.get("generator") is None:  # a generator's numbers are made where it is
            caller = sys._getframe(1)
            if any(caller.f_code.co_filename.startswith(folder) for folder in self._machine.watched):
                self._machine.homeless.add(f"{caller.f_code.co_filename}:{caller.f_lineno}")
        if func not in (torch.tensor, torch.as_tensor) or device is None or torch.device(device) != ELSEWHERE:
            return func(*args, **kwargs)
        requires_grad = kwargs.pop("requires_grad", False)
        made = func(*args, **{**kwargs, "device": "cpu"}).to(ELSEWHERE)
        return made.requires_grad_() if requires_grad else made


class _Operations(TorchDispatchMode):
    """Runs on the CPU what is asked for elsewhere."""

    def __init__(self, machine: Machine) -> None:
        super().__init__()
        self._machine = machine

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
        remote = [tensor for tensor in tensors if isinstance(tensor, Remote)]
        device = kwargs.get("device")
        there = bool(remote) if device is None else torch.device(device) == ELSEWHERE
        if func in _COPIES:
            there = there if func is aten._to_copy.default else isinstance(args[0], Remote)
            self._copies(func, there, args, kwargs)
        elif remote:
            self._refuse_mixtures(func, tensors, there)
            masked = func in _INDEXING and any(i is not None and i.dtype == torch.bool for i in args[1])
            if func in _WAITING or masked:
                self._machine.wait(func.overloadpacket.__name__)
        if (there or remote) and self._machine.counting and _computes(func):
            self._machine.work[func.overloadpacket.__name__] += 1
        if there and device is not None:
            kwargs["device"] = torch.device("cpu")
        own = {id(tensor.here): tensor for tensor in remote}  # what an operation in place gives back
        result = func(*tree_map(_here, args), **tree_map(_here, kwargs))

        def named(value: Any) -> Any:
            if not there or not isinstance(value, torch.Tensor):
                return value
            return own[id(value)] if id(value) in own else Remote(value)

        return tree_map(named, result)

    def _copies(self, func: Any, there: bool, args: Any, kwargs: Any) -> None:
        in_place = func is aten.copy_.default
        from_there = isinstance(args[int(in_place)], Remote)
        if from_there == there:
            return
        if not (kwargs.get("non_blocking") or (in_place and len(args) > 2 and args[2])):
            self._machine.wait("fetch" if from_there else "upload")
        elif from_there and self._machine.counting:
            self._machine.fetches += 1

    @staticmethod
    def _refuse_mixtures(func: Any, tensors: list[torch.Tensor], there: bool) -> None:
        strangers = [tuple(t.shape) for t in tensors if not isinstance(t, Remote) and t.dim()]  # numbers may travel
        if strangers:
            raise AssertionError(f"{func}: tensors of shape {strangers} on the CPU together with others elsewhere")
        if not there:
            raise AssertionError(f"{func}: something on the CPU is made of what is elsewhere")


def _computes(func: Any) -> bool:
    """Whether an operation does more than look at numbers in another way, or make room for some."""
    views = all(result.alias_info is not None and not result.alias_info.is_write for result in func._schema.returns)
    return not views and "empty" not in func.overloadpacket.__name__ and func.overloadpacket != aten._unsafe_view


def _here(value: Any) -> Any:
    return value.here if isinstance(value, Remote) else value
