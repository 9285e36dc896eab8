"""Names of methods and of a model's forms: a recipe or a header can be read without torch."""

SEQUENCE = "sequence"
"""``method`` of a scene that another program made: its frames are stored one by one, or CURVES say how it moves."""

FUSIONS = ("product", "add", "concat", "attention", "coarse", "fine", "dual")
"""Of the temporal embeddings. ``product`` is FRoG's t_c * t_f, ``dual`` E-D3DGS's late fusion: two networks whose
changes add up. The paper does not write out its attention; here a small layer scores each embedding and a softmax over
the scores weighs them."""

FORMS = ("paper", "unit", "off")
"""Of the opacity reduction, see ``model.deformation.reduction_factor``."""

WINDOW_COLUMNS = 8
"""Columns of the embeddings that are kept for the times at which Gaussians are seen, see ``model.time_windows``."""


def network_count(fusion: str) -> int:
    """Deformation networks that a fusion needs."""
    return 2 if fusion == "dual" else 1


def fused_size(fusion: str, temporal_size: int) -> int:
    """Length of what each network is given, of embeddings of length ``temporal_size``."""
    return 2 * temporal_size if fusion == "concat" else temporal_size


CANONICAL = frozenset({"means", "log_scales", "quaternions", "opacity_logits", "sh"})
"""Arrays of the canonical Gaussians, which every scene has."""
CURVES = "curves"
"""Array (N, 15) of a scene whose Gaussians move by a formula, see ``playback.player.PlayableCurves``."""
PER_GAUSSIAN = CANONICAL | {"embeddings", CURVES}
"""Arrays with a row a Gaussian: of all, and embeddings of the deformed ones, which come first."""
