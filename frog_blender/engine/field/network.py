"""The deformable field in numpy: temporal table, first layer of the network, and how its outputs lie. No torch.

A temporal table of R rows (FRoG, section on early fusion; E-D3DGS's two resolutions of one table) is resampled to n
rows and interpolated at a time. Few rows change slowly (coarse), many can follow fast motion (fine). Both steps are
linear in the table, so that each time is a vector of R weights.

The time-dependent part of the first layer (see model.deformation) is a dozen products of small matrices: automatic
differentiation takes longer to keep track of them than they take. Sums are einsum's, since the threads of numpy's own
matrix product would spin on the cores that the rasterizer wants.

The C++ side has the same offsets of outputs in ``native/src/deformation/types.h``.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ..arrays import Array

_FIXED = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1}


def output_sizes(deformed_sh: int) -> dict[str, int]:
    """Outputs by attribute, in their order.

    Args:
        deformed_sh: SH coefficients a channel that the network changes; 0 leaves ``sh`` out.
    """
    return _FIXED | ({"sh": 3 * deformed_sh} if deformed_sh else {})


def num_outputs(deformed_sh: int) -> int:
    """Numbers that a network gives for each Gaussian."""
    return sum(output_sizes(deformed_sh).values())


def column_outputs(deformed_sh: int) -> dict[str, slice]:
    """The outputs that reach each column of a frame (see playback.frame_delta)."""
    base = 11
    columns = {"means": slice(0, 3), "scales": slice(3, 6), "quaternions": slice(6, 10), "base": slice(10, base + 3)}
    return columns | {f"sh_{k}": slice(base + 3 * k, base + 3 * k + 3) for k in range(1, deformed_sh)}


def resampled(table: Array, rows: int) -> Array:
    """(rows, T) a table's values at as many times, evenly from 0 to 1."""
    return np.stack([_between(table, row * (len(table) - 1) / max(rows - 1, 1)) for row in range(rows)])


def _between(table: Array, position: float) -> Array:
    row = min(int(position), max(len(table) - 2, 0))
    share = position - row
    return np.asarray(table[row] if share == 0.0 else (1.0 - share) * table[row] + share * table[row + 1])


@functools.lru_cache(maxsize=4096)  # a training returns to a few hundred times in thousands of steps
def temporal_weights(time: float, rows: int, table_rows: int) -> Array:
    """(table_rows,) float32, read-only: the weight of each row at a time (clamped to [0, 1]), of a table resampled to
    ``rows``: the first at 0, the last at 1, linear between."""
    position = min(max(time, 0.0), 1.0) * (rows - 1)
    weights = _between(_resampling(rows, table_rows), position).astype(np.float32)
    weights.flags.writeable = False
    return weights


@functools.lru_cache(maxsize=8)
def _resampling(rows: int, table_rows: int) -> Array:
    """(rows, table_rows) the matrix that resamples a table."""
    return resampled(np.eye(table_rows), rows)


def fuse(form: str, embeddings: Any, shares: Callable[[Any], Any]) -> Any:  # Any: arrays, or tensors in training
    """(networks, fused size) what the networks are given at a time.

    Args:
        form: one of ``names.FUSIONS``.
        embeddings: (2, T), the coarse and the fine one of the time.
        shares: gives the weights (2,) of the embeddings for "attention".
    """
    coarse, fine = embeddings
    match form:
        case "product":
            return (coarse * fine)[None]
        case "add":
            return (coarse + fine)[None]
        case "concat":
            return embeddings.reshape(1, -1)
        case "attention":
            return (shares(embeddings) @ embeddings)[None]
        case "dual":
            return embeddings
    return (coarse if form == "coarse" else fine)[None]


def first_layer(
    temporal: Array,
    temporal_weight: Array,
    bias: Array,
    embedding_weight: Array,
    modulation_weight: Array | None = None,
) -> tuple[Array, Array]:
    """``DeformationField.shared`` (networks * hidden,) and ``embedding_weights`` (networks * hidden, E) of a time.

    Args:
        temporal: (networks, T) fused temporal embedding.
        temporal_weight: (networks * hidden, T).
        bias: (networks * hidden,).
        embedding_weight: (networks * hidden, E); comes back itself where there is no modulation.
        modulation_weight: (networks * hidden, E) or None.
    """
    networks = len(temporal)
    shared = np.einsum("nht,nt->nh", _by_network(temporal_weight, networks), temporal).ravel() + bias
    if modulation_weight is None:
        return shared, embedding_weight
    change = _by_network(modulation_weight, networks) * _modulation(temporal, embedding_weight.shape[1])
    return shared, embedding_weight + change.reshape(embedding_weight.shape)


def first_layer_gradients(
    by_shared: Array, by_weights: Array, temporal: Array, temporal_weight: Array, modulation_weight: Array | None = None
) -> dict[str, Array]:
    """Gradients by argument of ``first_layer``; those of bias and embedding_weight are the first two arguments.

    Args:
        by_shared, by_weights: (networks * hidden,) and (networks * hidden, E) gradients by what ``first_layer`` gave.
        temporal, temporal_weight, modulation_weight: what it was given.
    """
    networks = len(temporal)
    by_sums = by_shared.reshape(networks, -1)
    by_temporal = np.einsum("nh,nht->nt", by_sums, _by_network(temporal_weight, networks))
    by_temporal_weight = by_sums[:, :, None] * temporal[:, None]
    gradients = {"temporal": by_temporal, "temporal_weight": by_temporal_weight.reshape(temporal_weight.shape)}
    gradients |= {"bias": by_shared, "embedding_weight": by_weights}
    if modulation_weight is not None:
        size, by_products = modulation_weight.shape[1], _by_network(by_weights, networks)
        by_temporal[:, :size] += (by_products * _by_network(modulation_weight, networks)).sum(1)
        gradients["modulation_weight"] = (by_products * _modulation(temporal, size)).reshape(modulation_weight.shape)
    return gradients


def _by_network(rows: Array, networks: int) -> Array:
    """(networks, hidden, ...) of (networks * hidden, ...)."""
    return rows.reshape(networks, -1, rows.shape[1])


def _modulation(temporal: Array, size: int) -> Array:
    """(networks, 1, E) what the modulation's weights are multiplied with."""
    return temporal[:, None, :size] - 1
