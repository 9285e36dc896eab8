"""4DGaussians at playback; see ``model.baselines.hexplane``.

The product over the planes of space does not change in time and is kept; a time is three lines of features, which each
Gaussian reads at places that are kept too.
"""

from __future__ import annotations

import numpy as np

from ...arrays import Array, SceneArrays
from ...field.network import output_sizes
from ...gaussians import NumpyGaussians
from ...io.plain_values import JsonMapping
from .arrays import StaticGaussians, in_blocks, number, readable, take, whole

_AXES = ((0, 1), (0, 2), (1, 2))  # columns and rows of the planes of space
_WIDEST = 4096


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
        with readable("planes or network"):
            self._still = StaticGaussians(arrays)
            self.num_dynamic = len(self._still)
            channels, rows = whole(model, "channels", 1, _WIDEST), whole(model, "time_rows", 2, 1 << 20)
            hidden, self._head = whole(model, "hidden_width", 1, _WIDEST), whole(model, "head_width", 0, _WIDEST)
            deformed = whole(model, "deformed_sh", 0, self._still.sh_count)
            self._unit = number(model, "motion_unit")
            sizes = output_sizes(deformed)
            if not model["deformed_opacity"]:
                del sizes["opacity_logits"]
            self._sizes = sizes
            plain = {
                name.removeprefix("log_") for name in ("means", "log_scales", "quaternions") if name in self._sizes
            }
            base = {"base"} if self._sizes.keys() & {"opacity_logits", "sh"} else set()
            self.changing = frozenset({*plain, *base, *(f"sh_{k}" for k in range(1, deformed))})
            low, high = (take(arrays, f"network.{name}", 3) for name in ("low", "high"))
            if not (high > low).all():
                raise ValueError("its box has no room")
            places = (self._still.means - low) / (high - low)
            resolutions = [int(size) for size in model["resolutions"]]
            if not 1 <= len(resolutions) <= 16 or not all(2 <= size <= _WIDEST for size in resolutions):
                raise ValueError(f"the resolutions are {resolutions}")
            self._scales = [
                _Scale(
                    take(arrays, f"network.space_planes.{number_}", 3, channels, size, size),
                    take(arrays, f"network.time_planes.{number_}", 3, channels, rows, size),
                    places,
                )
                for number_, size in enumerate(resolutions)
            ]
            second = len(self._sizes) * self._head or hidden
            shapes = {
                "first.weight": (hidden, channels * len(resolutions)),
                "first.bias": (hidden,),
                "second.weight": (second, hidden),
                "second.bias": (second,),
                "output_weight": (sum(self._sizes.values()), self._head or hidden),
                "output_bias": (sum(self._sizes.values()),),
            }
            self._network = {name: take(arrays, f"network.{name}", *shape) for name, shape in shapes.items()}

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        lines, n = [scale.lines_at(time) for scale in self._scales], self._network

        def network(part: slice) -> Array:
            parts = [scale.features(line, part) for scale, line in zip(self._scales, lines, strict=True)]
            hidden = np.concatenate(parts, axis=1)
            for layer in ("first", "second"):
                hidden = hidden @ n[f"{layer}.weight"].T + n[f"{layer}.bias"]
                np.maximum(hidden, 0, out=hidden)
            if not self._head:
                return hidden @ n["output_weight"].T + n["output_bias"]
            outputs, start = [], 0
            for head, size in enumerate(self._sizes.values()):
                rows = slice(start, start + size)
                part_of = hidden[:, head * self._head : (head + 1) * self._head]
                outputs.append(part_of @ n["output_weight"][rows].T + n["output_bias"][rows])
                start += size
            return np.concatenate(outputs, axis=1)

        output = in_blocks(len(self._still), len(n["output_bias"]), network)
        return self._still.changed(self._sizes, output, self._unit)
