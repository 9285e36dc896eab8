"""The papers' methods that FRoG is compared with, as guests of ``engine.registry``: pyproject.toml offers them by name.

All share canonical Gaussians, rasterizer, losses and schedules with FRoG, so that a comparison compares methods.
"""

from __future__ import annotations

from ...engine.registry import Method

D3DGS = Method(
    "Deformable-3DGS", f"{__name__}.d3dgs:model_of", f"{__name__}.d3dgs:playable", f"{__name__}.d3dgs:adapted"
)
HEXPLANE = Method(
    "4DGaussians", f"{__name__}.hexplane:model_of", f"{__name__}.hexplane:playable", f"{__name__}.hexplane:plain"
)
CURVES = Method(
    "SpacetimeGaussians",
    f"{__name__}.curves:model_of",
    f"{__name__}.curves:playable",
    f"{__name__}.curves:adapted",
    frozenset({"embeddings"}),
)
