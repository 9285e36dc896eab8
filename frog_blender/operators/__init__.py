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
    export_scene,
    import_frog,
    import_ply,
    install_torch,
    open_capture,
    pick,
    relink,
    set_up_scene,
    show_result,
    train,
)

_FAMILIES = (
    import_frog,
    import_ply,
    export_scene,
    open_capture,
    bake,
    relink,
    pick,
    cameras,
    clips,
    align,
    set_up_scene,
    show_result,
    compose,
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
