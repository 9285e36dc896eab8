"""The papers' methods that FRoG is compared with, as guests of ``engine.registry``: pyproject.toml offers them by name.

All share canonical Gaussians, rasterizer, losses, schedules and limits with FRoG: a comparison compares methods.
"""

from ...engine.registry import Method


def _method(title: str, module: str, arrays: frozenset[str] = frozenset()) -> Method:
    """A method whose module has ``model_of``, ``playable`` and ``adapted``."""
    build, play, adapt = (f"{__name__}.{module}:{name}" for name in ("model_of", "playable", "adapted"))
    return Method(title, build, play, adapt, arrays)


D3DGS = _method("Deformable-3DGS", "d3dgs")
HEXPLANE = _method("4DGaussians", "hexplane")
CURVES = _method("SpacetimeGaussians", "curves", frozenset({"embeddings"}))
