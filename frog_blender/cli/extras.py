"""Packages that only some commands need, and how to install them."""

from __future__ import annotations

from ..engine.optional_imports import is_missing, not_loaded

EXTRAS = {
    "torch": ("train",),
    "cv2": ("render", "train"),
    "av": ("render", "train"),
    "PIL": ("render", "train"),
    "zstandard": ("spz", "render", "train"),
    "pycolmap": ("calibrate",),
    "tqdm": ("render", "train"),
    "matplotlib": ("chart", "pictures"),
    "flip_evaluator": ("chart",),
    "bpy": ("blender",),
    "pxr": ("usd",),
    "distributed": ("cluster",),
}
"""The extras of ``pyproject.toml`` that install a module, the smallest first."""


def unusable(error: ImportError) -> str:
    """One sentence about a package that could not be imported: what to install, or why it does not load."""
    if not is_missing(error):
        return f"{not_loaded(error)}."
    module = str(error.name).split(".")[0]
    extras = " or ".join(f'".[{extra}]"' for extra in EXTRAS.get(module, ()))
    advice = f"pip install {extras} brings it" if extras else "see the README for the extras to install"
    return f"the Python package {module!r} is missing; {advice}."
