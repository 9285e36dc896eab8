"""Names of a model's forms, apart from what computes them: a recipe can be read without torch."""

from __future__ import annotations

FUSIONS = ("product", "add", "concat", "attention", "coarse", "fine", "dual")
"""Of the temporal embeddings. ``product`` is FRoG's t_c * t_f, ``dual`` E-D3DGS's late fusion: two networks whose
changes add up. The paper does not write out its attention; here a small layer scores each embedding and a softmax over
the scores weighs them."""

FORMS = ("paper", "unit", "off")
"""Of the opacity reduction, see ``opacity.reduction_factor``."""
