"""What only some commands import, and how to get it."""

from __future__ import annotations

EXTRAS = {
    "torch": ("train",),
    "cv2": ("render", "train"),
    "tqdm": ("render", "train"),
    "matplotlib": ("chart", "pictures"),
    "flip_evaluator": ("chart",),
    "bpy": ("blender",),
}
"""The extras of ``pyproject.toml`` that bring a module, the smallest first."""


def missing(error: ModuleNotFoundError) -> str:
    """One sentence that says what is missing and what to install."""
    module = str(error.name).split(".")[0]
    extras = " or ".join(f'".[{extra}]"' for extra in EXTRAS.get(module, ()))
    advice = f"pip install {extras} brings it" if extras else "see the README for the extras to install"
    return f"the Python package {module!r} is missing; {advice}."
