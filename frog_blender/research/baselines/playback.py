"""The baselines at playback, as their training computes them: numpy alone.

Each is made of the scene file's arrays and the model settings of its header, and moves the Gaussians in ``at(time)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from ...engine import Array, FrogError, GaussianArrays, JsonMapping, NumpyGaussians, SceneArrays, brief, output_sizes

BLOCK = 4096
"""Gaussians that go through a network together: few enough for their layers to stay in the cache."""


@contextmanager
def _readable(what: str) -> Iterator[None]:
    """Turns what goes wrong with arrays and settings of a file into one sentence; ``what`` names the part."""
    try:
        yield
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise FrogError(f"The scene's {what} cannot be used ({brief(error)}); train it again.") from error


class _Stored:
    """Arrays and settings of a scene file, checked as they are asked for: ValueError for what does not fit."""

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        self.arrays, self.model = arrays, model

    def array(self, name: str, *shape: int) -> Array:
        """An array as contiguous float32, of that shape, in which no number is missing."""
        array = self.arrays[name]
        if array.shape != shape or 0 in shape:
            raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
        array = np.ascontiguousarray(array, np.float32)
        if not np.isfinite(array).all():
            raise ValueError(f"{name} holds numbers that are not finite")
        return array

    def whole(self, name: str, least: int, most: int = 4096) -> int:
        """A setting that is a whole number."""
        value = int(self.model[name])
        if not least <= value <= most:
            raise ValueError(f"{name} is {value}, expected {least} to {most}")
        return value

    def number(self, name: str) -> np.float32:
        """A setting that is a finite number above zero."""
        value = float(self.model[name])
        if not 0 < value < np.inf:
            raise ValueError(f"{name} is {value}, expected a number above 0")
        return np.float32(value)


def _scales_of(logs: Array) -> Array:
    """Standard deviations, finite for any logarithms, as those of static Gaussians."""
    result: Array = np.exp(np.clip(logs, -80, 80))
    return result


def _sigmoid(logits: Array) -> Array:
    result: Array = 1 / (1 + np.exp(-np.clip(logits, -80, 80)))
    return result


class _Still:
    """The canonical Gaussians, and what becomes of them when changes are added before activation."""

    def __init__(self, arrays: SceneArrays) -> None:
        names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
        self.values = {name: np.ascontiguousarray(arrays[name], np.float32) for name in names}
        self.means = self.values["means"]

    def __len__(self) -> int:
        return len(self.means)

    def changed(self, sizes: dict[str, int], output: Array, motion_unit: np.float32) -> NumpyGaussians:
        """Activated, quaternions not normalised.

        Args:
            sizes: columns of ``output`` by attribute, in their order.
            output: (N, sum of sizes); means in motion units.
        """
        v = dict(self.values)
        for (name, size), end in zip(sizes.items(), np.cumsum(list(sizes.values())), strict=True):
            change = output[:, end - size : end]
            if name == "sh":
                v["sh"] = v["sh"].copy()
                v["sh"][:, : size // 3] += change.reshape(len(self), -1, 3)
            else:
                change = change * motion_unit if name == "means" else change
                v[name] = v[name] + change.reshape(v[name].shape)
        return GaussianArrays(
            v["means"], v["quaternions"], _scales_of(v["log_scales"]), _sigmoid(v["opacity_logits"]), v["sh"]
        )


def _in_blocks(count: int, outputs: int, network: Callable[[slice], Array]) -> Array:
    """(count, outputs) of a network that answers for the Gaussians of a slice."""
    result = np.empty((count, outputs), np.float32)
    for start in range(0, count, BLOCK):
        part = slice(start, min(start + BLOCK, count))
        result[part] = network(part)
    return result


_NUMBERS = 15


class PlayableCurves:
    """The Gaussians on their curves, as the training path computes them.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.
    """

    changing = frozenset({"means", "quaternions", "base"})

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        with _readable("curves"):
            still, stored = _Still(arrays), _Stored(arrays, model)
            self.num_dynamic = len(still)
            embeddings = stored.array("embeddings", len(still), _NUMBERS)
            units = [_Stored(arrays, {"motion_units": unit}).number("motion_units") for unit in model["motion_units"]]
            if len(units) != 3:
                raise ValueError(f"there are {len(units)} motion units, expected 3")
            self._curve = [embeddings[:, 3 * i : 3 * i + 3] * unit for i, unit in enumerate(units)]
            self._spin = embeddings[:, 9:13] * stored.number("rotation_unit")
            self._centres = embeddings[:, 13:14] * stored.number("centre_unit")
            widths = np.clip(-stored.number("width_unit") * embeddings[:, 14:15], -40, 40)
            self._sharpness = np.exp(widths) / stored.number("first_width")
            self._still = still.changed({}, embeddings, np.float32(1))

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        since = np.float32(time - 0.5) - self._centres
        (first, second, third), still = self._curve, self._still
        means = still.means + since * (first + since * (second + since * third))
        presence = np.exp(-np.square(since * self._sharpness))[:, 0]
        quaternions = still.quaternions + since * self._spin
        return GaussianArrays(means, quaternions, still.scales, still.opacities * presence, still.sh)


_SIZES = {"means": 3, "quaternions": 4, "log_scales": 3}


def _encode(values: Array, frequencies: int) -> Array:
    """(N, D) to (N, D + 2 D frequencies): values, sines, cosines."""
    octaves = (2.0 ** np.arange(frequencies)).astype(np.float32)
    angles = (values[:, :, None] * octaves).reshape(len(values), -1)
    return np.concatenate([values, np.sin(angles), np.cos(angles)], axis=1)


class PlayableD3dgs:
    """Deformed Gaussians at a time, as the training path computes them.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.
    """

    changing = frozenset(name.removeprefix("log_") for name in _SIZES)

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        with _readable("deformation network"):
            self._still, stored = _Still(arrays), _Stored(arrays, model)
            self.num_dynamic = len(self._still)
            depth, width = stored.whole("depth", 1, 64), stored.whole("width", 1)
            space_frequencies = stored.whole("space_frequencies", 0, 24)
            self._frequencies = stored.whole("time_frequencies", 0, 24)
            self._unit = stored.number("motion_unit")
            space, encoded_time = 3 + 6 * space_frequencies, 1 + 2 * self._frequencies
            self._layers = []
            for layer in range(depth):
                skips = layer in (0, depth // 2 + 1)
                inputs = (space + encoded_time) * skips + width * (layer > 0)
                weight = stored.array(f"network.layers.{layer}.weight", width, inputs)
                bias = stored.array(f"network.layers.{layer}.bias", width)
                self._layers.append(
                    (*np.split(weight, [space, space + encoded_time] if skips else [0, 0], axis=1), bias)
                )
            outputs = sum(_SIZES.values())
            self._output = stored.array("network.output.weight", outputs, width)
            self._output_bias = stored.array("network.output.bias", outputs)
            centre, unit = (stored.array(f"network.{name}", 3) for name in ("centre", "unit"))
            if not (unit > 0).all():
                raise ValueError("its unit of length is not above 0")
            self._places = _encode((self._still.means - centre) / unit, space_frequencies)

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        encoded_time = _encode(np.full((1, 1), time, np.float32), self._frequencies)[0]
        constants = [bias + by_time @ encoded_time if by_time.size else bias for _, by_time, _, bias in self._layers]

        def network(part: slice) -> Array:
            places, hidden = self._places[part], None
            for (by_place, _, by_hidden, _), constant in zip(self._layers, constants, strict=True):
                sums = places @ by_place.T if by_place.size else 0
                if hidden is not None:
                    sums += hidden @ by_hidden.T
                sums += constant
                hidden = np.maximum(sums, 0, out=sums)
            return hidden @ self._output.T + self._output_bias

        output = _in_blocks(len(self._still), len(self._output), network)
        return self._still.changed(_SIZES, output, self._unit)


_AXES = ((0, 1), (0, 2), (1, 2))  # columns and rows of the planes of space


def _cells(places: Array, size: int) -> tuple[Array, Array]:
    """Lower neighbours (N, 3) and shares of the upper ones of places in [0, 1], held at the rims, on ``size`` cells."""
    at = np.clip(places, 0, 1) * np.float32(size - 1)
    cell = np.minimum(at.astype(np.int32), size - 2)
    return cell, (at - cell).astype(np.float32)


class _Scale:
    """The planes of one resolution."""

    def __init__(self, space: Array, over_time: Array, places: Array) -> None:
        self.over_time = over_time
        cells, shares = _cells(places, space.shape[-1])
        self.cells, self.shares = cells.T.copy(), shares.T[:, :, None].copy()  # (3, N), (3, N, 1)
        self.space = np.ones((len(places), space.shape[1]), np.float32)
        for plane, (column, row) in zip(space, _AXES, strict=True):
            table = plane.transpose(1, 2, 0)  # rows, columns, channels
            c, r = self.cells[column], self.cells[row]
            across, down = self.shares[column], self.shares[row]
            upper = table[r, c] * (1 - across) + table[r, c + 1] * across
            lower = table[r + 1, c] * (1 - across) + table[r + 1, c + 1] * across
            self.space *= upper * (1 - down) + lower * down

    def lines_at(self, time: float) -> Array:
        """(3, cells, channels) for x, y and z."""
        rows = self.over_time.shape[2]
        at = min(max(time, 0.0), 1.0) * (rows - 1)
        row = min(int(at), rows - 2)
        share = np.float32(at - row)
        first, second = self.over_time[:, :, row], self.over_time[:, :, row + 1]
        return np.ascontiguousarray((first + (second - first) * share).transpose(0, 2, 1))

    def features(self, lines: Array, part: slice) -> Array:
        """(n, channels) of the Gaussians in ``part``."""
        product = self.space[part].copy()
        for line, all_cells, all_shares in zip(lines, self.cells, self.shares, strict=True):
            cells, shares = all_cells[part], all_shares[part]
            lower = line[cells]
            product *= lower + (line[cells + 1] - lower) * shares
        return product


class PlayableHexPlane:
    """Deformed Gaussians at a time, as the training path computes them.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.
    """

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        with _readable("planes or network"):
            self._still, stored = _Still(arrays), _Stored(arrays, model)
            self.num_dynamic = len(self._still)
            channels, rows = stored.whole("channels", 1), stored.whole("time_rows", 2, 1 << 20)
            hidden, self._head = stored.whole("hidden_width", 1), stored.whole("head_width", 0)
            deformed_sh = stored.whole("deformed_sh", 0, self._still.values["sh"].shape[1])
            self._unit = stored.number("motion_unit")
            self._sizes = output_sizes(deformed_sh)
            if not model["deformed_opacity"]:
                del self._sizes["opacity_logits"]
            base = {"base"} if self._sizes.keys() & {"opacity_logits", "sh"} else set()
            self.changing = frozenset(
                {"means", "scales", "quaternions", *base, *(f"sh_{k}" for k in range(1, deformed_sh))}
            )
            low, high = (stored.array(f"network.{name}", 3) for name in ("low", "high"))
            if not (high > low).all():
                raise ValueError("its box has no room")
            places = (self._still.means - low) / (high - low)
            resolutions = [int(size) for size in model["resolutions"]]
            if not 1 <= len(resolutions) <= 16 or not all(2 <= size <= 4096 for size in resolutions):
                raise ValueError(f"the resolutions are {resolutions}")
            self._scales = [
                _Scale(
                    stored.array(f"network.space_planes.{index}", 3, channels, size, size),
                    stored.array(f"network.time_planes.{index}", 3, channels, rows, size),
                    places,
                )
                for index, size in enumerate(resolutions)
            ]
            second, outputs = len(self._sizes) * self._head or hidden, sum(self._sizes.values())
            shapes = {
                "first.weight": (hidden, channels * len(resolutions)),
                "first.bias": (hidden,),
                "second.weight": (second, hidden),
                "second.bias": (second,),
                "output_weight": (outputs, self._head or hidden),
                "output_bias": (outputs,),
            }
            self._network = {name: stored.array(f"network.{name}", *shape) for name, shape in shapes.items()}

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        lines, n = [scale.lines_at(time) for scale in self._scales], self._network
        sizes = list(self._sizes.values())

        def network(part: slice) -> Array:
            parts = [scale.features(line, part) for scale, line in zip(self._scales, lines, strict=True)]
            hidden = np.concatenate(parts, axis=1)
            for layer in ("first", "second"):
                hidden = hidden @ n[f"{layer}.weight"].T + n[f"{layer}.bias"]
                np.maximum(hidden, 0, out=hidden)
            if not self._head:
                return hidden @ n["output_weight"].T + n["output_bias"]
            parts = []
            for head, (size, end) in enumerate(zip(sizes, np.cumsum(sizes), strict=True)):
                rows = slice(end - size, end)
                own = hidden[:, head * self._head : (head + 1) * self._head]
                parts.append(own @ n["output_weight"][rows].T + n["output_bias"][rows])
            return np.concatenate(parts, axis=1)

        output = _in_blocks(len(self._still), len(n["output_bias"]), network)
        return self._still.changed(self._sizes, output, self._unit)
