"""The time-dependent part of the network's first layer (see model.deformation) and its gradients. No torch.

A dozen products of small matrices: automatic differentiation takes longer to keep track of them than they take. Sums
are einsum's, since the threads of numpy's own matrix product would spin on the cores that the rasterizer wants.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array


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
    by_shared: Array,
    by_weights: Array,
    temporal: Array,
    temporal_weight: Array,
    modulation_weight: Array | None = None,
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
