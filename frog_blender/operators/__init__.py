"""Operators, one family per file."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from .. import edition

_FAMILIES = (
    "import_frog",
    "import_ply",
    "export_scene",
    "export_take",
    "open_capture",
    "bake",
    "relink",
    "pick",
    "clips",
    "align",
    "set_up_scene",
    "show_result",
    "timing",
    "retime",
    "capture_sound",
    "compose",
    "render_film",
    "light",
    "make_proxy",
    "edit_crops",
    "edit_clean",
    "select_by_hand",
    "edit_file",
    "edit_match",
    "train",
    "install_torch",
    "calibrate",
    "click_points",
    "capture_cameras",
    "capture_scene",
)


def _families() -> list[ModuleType]:
    names = [name for name in _FAMILIES if edition.has(f"operators.{name}")]
    return [import_module(f".{name}", __package__) for name in names]


def register() -> None:
    for family in _families():
        family.register()


def unregister() -> None:
    for family in reversed(_families()):
        family.unregister()
