"""The fused temporal embedding at playback: what ``model.fusion`` computes in torch, for finished scenes without it."""

from __future__ import annotations

import numpy as np

from ..arrays import Array, SceneArrays
from ..field.names import FUSIONS, fused_size, network_count
from ..field.temporal_table import resampled
from ..io.plain_values import JsonMapping


def fuse(form: str, coarse: Array, fine: Array, attention: tuple[Array, Array] | None = None) -> Array:
    """(networks, fused size) what the networks are given, from the embeddings (T,) of a time.

    Args:
        form: one of ``field.names.FUSIONS``.
        attention: weight (A, T) and query (A,): the score of t is query . tanh(weight t).
    """
    match form:
        case "product":
            fused = coarse * fine
        case "add":
            fused = coarse + fine
        case "concat":
            fused = np.concatenate([coarse, fine])
        case "attention":
            assert attention is not None
            weight, query = attention
            both = np.stack([coarse, fine])
            scores = np.tanh(both @ weight.T) @ query
            shares = np.exp(scores - scores.max())
            fused = (shares / shares.sum()) @ both
        case "coarse":
            fused = coarse
        case "fine":
            fused = fine
        case "dual":
            return np.stack([coarse, fine])
        case _:
            raise ValueError(f"there is no fusion {form!r}")
    return fused[None]


class _Table:
    """``field.temporal_table.interpolated`` of a table (R, T), twice as fast: every frame needs it twice."""

    def __init__(self, table: Array) -> None:
        self._rows, self._steps = table, np.diff(table, axis=0, append=table[-1:])

    def at(self, time: float) -> Array:
        position = min(max(time, 0.0), 1.0) * (len(self._rows) - 1)
        row = int(position)
        result: Array = self._rows[row] + np.float32(position - row) * self._steps[row]
        return result


class TemporalEmbedding:
    """The temporal table of a finished scene.

    Args:
        arrays: the scene file's arrays: ``temporal_table`` (rows, T), and for attention ``attention_weight`` (A, T) and
            ``attention_query`` (A,).
        model: the scene header's model settings.

    Raises:
        KeyError, ValueError, TypeError: if they do not fit together.

    Attributes:
        networks, size: of the deformation networks there are, and length of what each is given.
    """

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        rows, coarse, length = (int(model[name]) for name in ("temporal_rows", "coarse_rows", "temporal_size"))
        fine = int(model.get("fine_rows", 0)) or rows  # scenes of the first version have no such setting
        if not (1 <= coarse <= rows and 1 <= fine <= rows):
            raise ValueError(f"its {rows} rows are resampled to {coarse} and {fine}")
        self.form = str(model.get("fusion", "product"))
        if self.form not in FUSIONS:
            raise ValueError(f"there is no fusion {self.form!r}")
        table = checked(arrays, "temporal_table", (rows, length))
        self._tables = _Table(resampled(table, coarse)), _Table(resampled(table, fine))
        self._attention = None
        if self.form == "attention":
            query = arrays["attention_query"]
            weight = checked(arrays, "attention_weight", (query.size, length))
            self._attention = weight, checked(arrays, "attention_query", (query.size,))
        self.networks, self.size = network_count(self.form), fused_size(self.form, length)

    def at(self, time: float) -> Array:
        """(networks, size) float32 at a time in [0, 1]."""
        coarse, fine = (table.at(time) for table in self._tables)
        return fuse(self.form, coarse, fine, self._attention).astype(np.float32, copy=False)


def checked(arrays: SceneArrays, name: str, shape: tuple[int, ...]) -> Array:
    """An array as contiguous float32; KeyError or ValueError unless it has that shape, none of it zero."""
    array = arrays[name]
    if array.shape != shape or 0 in shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    return np.ascontiguousarray(array, np.float32)
