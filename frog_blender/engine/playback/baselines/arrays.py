"""Playback of all baselines: arrays checked for their shapes, and changes added to the canonical Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from ...arrays import Array, SceneArrays
from ...errors import FrogError, brief
from ...gaussians import GaussianArrays, NumpyGaussians
from ...io.plain_values import JsonMapping

BLOCK = 4096
"""Gaussians that go through a network together: few enough for their layers to stay in the cache."""


@contextmanager
def readable(what: str) -> Iterator[None]:
    """Turns what goes wrong with arrays and settings of a file into one sentence; ``what`` names the part."""
    try:
        yield
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise FrogError(f"The scene's {what} cannot be used ({brief(error)}); train it again.") from error


def take(arrays: SceneArrays, name: str, *shape: int) -> Array:
    """An array as contiguous float32; KeyError or ValueError unless it has that shape and no number is missing."""
    array = arrays[name]
    if array.shape != shape or 0 in shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    array = np.ascontiguousarray(array, np.float32)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds numbers that are not finite")
    return array


def whole(model: JsonMapping, name: str, least: int, most: int) -> int:
    """A setting that is a whole number; ValueError outside ``least`` to ``most``."""
    value = int(model[name])
    if not least <= value <= most:
        raise ValueError(f"{name} is {value}, expected {least} to {most}")
    return value


def number(model: JsonMapping, name: str) -> float:
    """A setting that is a finite number above zero; ValueError otherwise."""
    value = float(model[name])
    if not 0 < value < np.inf:
        raise ValueError(f"{name} is {value}, expected a number above 0")
    return value


def scales_of(logs: Array) -> Array:
    """Standard deviations, finite for any logarithms, as those of static Gaussians."""
    result: Array = np.exp(np.clip(logs, -80, 80))
    return result


def sigmoid(logits: Array) -> Array:
    result: Array = 1 / (1 + np.exp(-np.clip(logits, -80, 80)))
    return result


class StaticGaussians:
    """The canonical Gaussians, and what becomes of them when changes are added before activation."""

    def __init__(self, arrays: SceneArrays) -> None:
        names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
        self._values = {name: np.ascontiguousarray(arrays[name], np.float32) for name in names}

    def __len__(self) -> int:
        return len(self._values["means"])

    @property
    def means(self) -> Array:
        """(N, 3)."""
        return self._values["means"]

    @property
    def sh_count(self) -> int:
        """SH coefficients a channel."""
        return self._values["sh"].shape[1]

    def changed(self, sizes: dict[str, int], output: Array, motion_unit: float) -> NumpyGaussians:
        """Activated, quaternions not normalised.

        Args:
            sizes: columns of ``output`` by attribute, in their order.
            output: (N, sum of sizes); means in motion units.
        """
        v, start = dict(self._values), 0
        for name, size in sizes.items():
            change = output[:, start : start + size]
            start += size
            if name == "means":
                change = change * np.float32(motion_unit)
            if name == "sh":
                v["sh"] = v["sh"].copy()
                v["sh"][:, : size // 3] += change.reshape(len(self), -1, 3)
            else:
                v[name] = v[name] + change.reshape(v[name].shape)
        return GaussianArrays(
            v["means"], v["quaternions"], scales_of(v["log_scales"]), sigmoid(v["opacity_logits"]), v["sh"]
        )


def in_blocks(count: int, outputs: int, network: Callable[[slice], Array]) -> Array:
    """(count, outputs) of a network that answers for the Gaussians of a slice."""
    result = np.empty((count, outputs), np.float32)
    for start in range(0, count, BLOCK):
        part = slice(start, min(start + BLOCK, count))
        result[part] = network(part)
    return result
