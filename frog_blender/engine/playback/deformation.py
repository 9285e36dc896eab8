"""The deformation network at playback (FRoG's, and E-D3DGS's two): numpy and the native library.

What does not depend on time is computed once: without modulation the first layer's product with the Gaussians'
embeddings; static Gaussians and colours that do not deform are written once into the frames' memory.

Groups of Gaussians lie side by side, each in one piece: the native library works on whole vectors of Gaussians, from
the embeddings to the deformed attributes.
"""

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from ..arrays import Array, NetworkArrays, SceneArrays
from ..errors import FrogError, brief
from ..field.names import FORMS, FUSIONS, fused_size, network_count
from ..field.network import column_outputs, first_layer, fuse, num_outputs, output_sizes, resampled
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.plain_values import JsonMapping
from ..native.deformation import FieldShape, PlaybackField
from .frame_delta import BufferPool, FrameDelta, canonical_gaussians, column_of

GROUP_SIZE = 16
"""Gaussians side by side; GROUP_SIZE of the native library."""
_ROWS_AT_ONCE = GROUP_SIZE * 4096  # Gaussians that are multiplied at once, which bounds the temporary arrays
_ATTRIBUTES = ("means", "opacity_logits", "sh", "log_scales", "quaternions")  # last what does not change of all


def pack_lanes(arrays: SceneArrays, precomputed_first_layer: bool) -> Array:
    """(ceil(N / GROUP_SIZE), rows, GROUP_SIZE) float32: each Gaussian's attributes and embedding as rows, a group's
    Gaussians as columns, zero beyond the last one.

    Args:
        arrays: ``means`` (N, 3), ``log_scales`` (N, 3), ``quaternions`` (N, 4), ``opacity_logits`` (N,), ``sh``
            (N, deformed coefficients, 3), ``embeddings`` (N, E) and ``embedding_weight`` (units, E).
        precomputed_first_layer: whether the embeddings' products with their weight stand in their place.
    """
    count, weight = len(arrays["means"]), arrays["embedding_weight"]
    columns = [arrays[name].reshape(count, math.prod(arrays[name].shape[1:])) for name in _ATTRIBUTES]
    width = sum(column.shape[1] for column in columns)
    own = len(weight) if precomputed_first_layer else weight.shape[1]
    result = np.zeros((-(-count // GROUP_SIZE), width + own, GROUP_SIZE), np.float32)
    for start in range(0, count, _ROWS_AT_ONCE):
        some = slice(start, start + _ROWS_AT_ONCE)
        embeddings = arrays["embeddings"][some]
        own_columns = embeddings @ weight.T if precomputed_first_layer else embeddings
        row = 0
        for column in [*(column[some] for column in columns), own_columns]:
            _put(column, result[start // GROUP_SIZE :, row : row + column.shape[1]])
            row += column.shape[1]
    return result


def _put(column: Array, rows: Array) -> None:
    """Writes (N, width) to the first of (groups, width, GROUP_SIZE)."""
    groups, rest = divmod(len(column), GROUP_SIZE)
    rows[:groups] = column[: groups * GROUP_SIZE].reshape(groups, GROUP_SIZE, column.shape[1]).transpose(0, 2, 1)
    if rest:
        rows[groups, :, :rest] = column[groups * GROUP_SIZE :].T


def transpose_weights(arrays: NetworkArrays) -> NetworkArrays:
    """The weights of the first layer and of the outputs, transposed, their rows padded to a multiple of GROUP_SIZE.

    Args:
        arrays: ``shared`` (units,), ``embedding_weight`` (units, E), ``output_weight`` (outputs, units) and
            ``output_bias`` (outputs,), and perhaps ``temporal_weight`` and ``modulation_weight`` (units, ...).
    """
    outputs = [slice(3), slice(10, None), slice(3, 10)]  # means; opacity and colours; scales and quaternions
    result: NetworkArrays = {}
    for name in ("shared", "embedding_weight", "temporal_weight", "modulation_weight", "output_weight", "output_bias"):
        if name in arrays:
            rows = arrays[name]
            if name.startswith("output"):
                rows = np.concatenate([rows[some] for some in outputs])
            padding = [(0, -len(rows) % GROUP_SIZE), *[(0, 0)] * (rows.ndim - 1)]
            result[name] = np.ascontiguousarray(np.pad(rows, padding).T, np.float32)
    return result


class _Table:
    """A table (R, T) between its rows, twice as fast as by ``field.network``: every frame needs it twice."""

    def __init__(self, table: Array) -> None:
        self._rows, self._steps = table, np.diff(table, axis=0, append=table[-1:])

    def at(self, time: float) -> Array:
        position = min(max(time, 0.0), 1.0) * (len(self._rows) - 1)
        row = int(position)
        return np.asarray(self._rows[row] + np.float32(position - row) * self._steps[row])


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
        if self.form == "attention":
            width = arrays["attention_query"].size
            self._weight = checked(arrays, "attention_weight", (width, length))
            self._query = checked(arrays, "attention_query", (width,))
        self.networks, self.size = network_count(self.form), fused_size(self.form, length)

    def at(self, time: float) -> Array:
        """(networks, size) float32 at a time in [0, 1]."""
        fused: Array = fuse(self.form, np.stack([table.at(time) for table in self._tables]), self._shares)
        return fused.astype(np.float32, copy=False)

    def _shares(self, embeddings: Array) -> Array:
        """See ``fuse``: the score of an embedding e is query . tanh(weight e)."""
        scores = np.tanh(embeddings @ self._weight.T) @ self._query
        shares = np.exp(scores - scores.max())
        return np.asarray(shares / shares.sum())


def checked(arrays: SceneArrays, name: str, shape: tuple[int, ...]) -> Array:
    """An array as contiguous float32; KeyError or ValueError unless it has that shape, none of it zero."""
    array = arrays[name]
    if array.shape != shape or 0 in shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    return np.ascontiguousarray(array, np.float32)


_CANONICAL = ("means", "log_scales", "quaternions", "opacity_logits")


def _checked_arrays(arrays: SceneArrays, model: JsonMapping, temporal: TemporalEmbedding) -> SceneArrays:
    """Contiguous float32 by the native library's names.

    KeyError or ValueError unless every array is what the settings say: the library only sees addresses.
    """
    count, networks, embedding = len(arrays["means"]), temporal.networks, int(model["embedding_size"])
    deformed = len(arrays["embeddings"])
    if deformed > count:
        raise ValueError(f"{deformed} of its {count} Gaussians move")
    hidden, heads, colors = (int(model[name]) for name in ("hidden_width", "head_width", "deformed_sh"))
    outputs = num_outputs(colors)
    if not 0 <= colors <= arrays["sh"].shape[1]:
        raise ValueError("it deforms more colours than there are")
    shapes = {name: (count, *size) for name, size in zip(_CANONICAL, ((3,), (3,), (4,), ()), strict=True)}
    shapes |= {
        "sh": (count, arrays["sh"].shape[1], 3),
        "embeddings": (deformed, embedding),
        "network.embedding_weight": (networks * hidden, embedding),
        "network.temporal_weight": (networks * hidden, temporal.size),
        "network.bias": (networks * hidden,),
        "network.output_weight": (outputs, networks * (heads or hidden)),
        "network.output_bias": (outputs,),
    }
    if model.get("modulation", False):
        if embedding > temporal.size:
            raise ValueError(f"embeddings of {embedding} are modulated by {temporal.size} numbers")
        shapes["network.modulation_weight"] = (networks * hidden, embedding)
    if heads:
        width = networks * heads * len(output_sizes(colors))
        shapes |= {"network.head_weight": (width, hidden), "network.head_bias": (width,)}
    return {name.removeprefix("network."): checked(arrays, name, shape) for name, shape in shapes.items()}


def _shape(model: JsonMapping, sh_count: int, networks: int) -> FieldShape:
    """KeyError or ValueError for settings that cannot be."""
    form, sharpness = model["opacity_reduction"], float(model["opacity_sharpness"])
    if form not in FORMS or not sharpness >= 0:
        raise ValueError(f"the opacity reduction is {form!r}, {sharpness}")
    share = float(model.get("opacity_share", 1.0))
    if not 0 <= share <= 1:
        raise ValueError(f"the opacity reduction's share is {share}")
    head_width, deformed, unit = int(model["head_width"]), int(model["deformed_sh"]), float(model["motion_unit"])
    return FieldShape(head_width, sh_count, deformed, form, sharpness, share, unit, networks)


def _changing(arrays: SceneArrays, deformed: int) -> frozenset[str]:
    """The columns that some output of the network reaches."""
    reached = arrays["output_weight"].any(axis=1) | (arrays["output_bias"] != 0)
    return frozenset(name for name, outputs in column_outputs(deformed).items() if reached[outputs].any())


class DeformationPlayer:
    """Deformed Gaussians at a time, exactly as the training path computes them, but for rounding.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.

    Attributes:
        num_dynamic: Gaussians that the network moves, which come first.
        changing: the columns (see frame_delta) that change in time. An output of zeros changes none.
    """

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        try:
            self._temporal = TemporalEmbedding(arrays, model)
            a = _checked_arrays(arrays, model, self._temporal)
            self._shape = _shape(model, a["sh"].shape[1], self._temporal.networks)
            self.num_dynamic = len(a["embeddings"])
        except (KeyError, ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
            raise FrogError(
                f"The scene's deformation network cannot be used ({brief(error)}); train it again."
            ) from error
        a["shared"] = a.pop("bias")
        colors = self._shape.sh_deformed
        self.changing = _changing(a, colors) if self.num_dynamic else frozenset()
        self._still = canonical_gaussians(a).arrays
        self._memory = BufferPool({k: v for k, v in self._still.items() if k != "sh" or colors})
        for name in _CANONICAL:
            a[name] = a[name][: self.num_dynamic]
        a["sh"] = np.ascontiguousarray(a["sh"][: self.num_dynamic, :colors])  # the others are in the frames' memory
        kept = "modulation_weight" not in a  # the first layer's product with the embeddings is the same at all times
        self._first_layer = a["shared"], a["embedding_weight"], a["temporal_weight"], a.get("modulation_weight")
        if not self._shape.head_width:  # heads are nearly all of the arithmetic: how Gaussians lie matters little
            a = {"means": a["means"], "groups": pack_lanes(a, kept), **transpose_weights(a)}
        # Of frames, which have all colours, and of parts, which have those that deform.
        self._field, self._part_field = (
            PlaybackField(shape, a, kept) for shape in (self._shape, replace(self._shape, sh_active=colors))
        )

    def _time_inputs(self, time: float) -> SceneArrays:
        """The native library's inputs that depend on time. With groups it computes the first layer itself."""
        temporal = self._temporal.at(time)
        if not self._shape.head_width:
            return {"temporal": temporal}
        bias, embedding_weight, temporal_weight, modulation_weight = self._first_layer
        layer = first_layer(temporal, temporal_weight, bias, embedding_weight, modulation_weight)
        return dict(zip(("shared", "embedding_weight"), layer, strict=True))

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated, with unit quaternions; the arrays are not to be changed."""
        memory, addresses = self._memory.take()
        result = {"sh": self._still["sh"]} | memory
        if self.num_dynamic:
            self._field.deform(self._time_inputs(time), {**result, **addresses})
        return GaussianArrays.of(result)

    def delta_at(self, time: float, names: Collection[str]) -> FrameDelta:
        """Columns of the dynamic Gaussians (at least one) at a time in [0, 1]: the same bits as in ``at``."""
        count, colors = self.num_dynamic, self._shape.sh_deformed
        sizes = {"means": (3,), "quaternions": (4,), "scales": (3,), "opacities": (), "sh": (colors, 3)}
        moved = {name: np.empty((count, *size), np.float32) for name, size in sizes.items()}
        self._part_field.deform(self._time_inputs(time), moved)
        if not colors:
            moved["sh"] = self._still["sh"][:count]
        gaussians = GaussianArrays.of(moved)
        return {name: column_of(gaussians, name) for name in names}
