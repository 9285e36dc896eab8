"""Operators, one family per file."""

from __future__ import annotations

from . import (
    align,
    bake,
    calibrate,
    cameras,
    capture_cameras,
    click_points,
    clips,
    compose,
    edit_clean,
    edit_crops,
    edit_file,
    edit_match,
    export_scene,
    import_frog,
    import_ply,
    install_torch,
    open_capture,
    relink,
    set_up_scene,
    train,
)

_FAMILIES = (
    import_frog,
    import_ply,
    export_scene,
    open_capture,
    bake,
    relink,
    cameras,
    clips,
    align,
    set_up_scene,
    compose,
    edit_crops,
    edit_clean,
    edit_file,
    edit_match,
    train,
    install_torch,
    calibrate,
    click_points,
    capture_cameras,
)


def register() -> None:
    for family in _FAMILIES:
        family.register()


def unregister() -> None:
    for family in reversed(_FAMILIES):
        family.unregister()
