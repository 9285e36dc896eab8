"""What of the network's first layer depends on the moment (see model.deformation), and its gradients. No torch.

A dozen products of small matrices: automatic differentiation takes longer to keep track of them than they take.
"""

from __future__ import annotations

import numpy as np


def first_layer(
    temporal: np.ndarray,
    temporal_weight: np.ndarray,
    bias: np.ndarray,
    embedding_weight: np.ndarray,
    modulation_weight: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """``DeformationField.shared`` (networks * hidden,) and ``embedding_weights`` (networks * hidden, E) of a moment.

    Args:
        temporal: (networks, T) fused temporal embedding.
        temporal_weight, bias, embedding_weight, modulation_weight: the field's; no modulation leaves the embedding's
            weights as they are.
    """
    networks, size = len(temporal), embedding_weight.shape[1]
    shared = (temporal_weight.reshape(networks, -1, temporal.shape[1]) @ temporal[:, :, None]).ravel() + bias
    if modulation_weight is None:
        return shared, embedding_weight
    change = modulation_weight.reshape(networks, -1, size) * (temporal[:, None, :size] - 1)
    return shared, embedding_weight + change.reshape(-1, size)


def first_layer_gradients(
    by_shared: np.ndarray,
    by_weights: np.ndarray,
    temporal: np.ndarray,
    temporal_weight: np.ndarray,
    modulation_weight: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Gradients by argument of ``first_layer``, from those by what it gave."""
    networks = len(temporal)
    own = by_shared.reshape(networks, 1, -1)
    by_temporal = (own @ temporal_weight.reshape(networks, -1, temporal.shape[1]))[:, 0]
    by_temporal_weight = own.transpose(0, 2, 1) * temporal[:, None]
    gradients = {"temporal": by_temporal, "temporal_weight": by_temporal_weight.reshape(temporal_weight.shape)}
    gradients |= {"bias": by_shared, "embedding_weight": by_weights}
    if modulation_weight is not None:
        size = modulation_weight.shape[1]
        of_weights = by_weights.reshape(networks, -1, size)
        by_temporal[:, :size] += (of_weights * modulation_weight.reshape(networks, -1, size)).sum(1)
        by_modulation = of_weights * (temporal[:, None, :size] - 1)
        gradients["modulation_weight"] = by_modulation.reshape(modulation_weight.shape)
    return gradients
