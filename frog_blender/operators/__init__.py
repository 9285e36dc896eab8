"""Operators, one family per file."""

from __future__ import annotations

from . import (
    align,
    bake,
    calibrate,
    cameras,
    capture_cameras,
    capture_scene,
    capture_sound,
    click_points,
    clips,
    compose,
    edit_clean,
    edit_crops,
    edit_file,
    edit_match,
    export_scene,
    export_take,
    import_frog,
    import_ply,
    install_torch,
    light,
    make_proxy,
    open_capture,
    pick,
    relink,
    retime,
    select_by_hand,
    set_up_scene,
    show_result,
    timing,
    train,
)

_FAMILIES = (
    import_frog,
    import_ply,
    export_scene,
    export_take,
    open_capture,
    bake,
    relink,
    pick,
    cameras,
    clips,
    align,
    set_up_scene,
    show_result,
    timing,
    retime,
    capture_sound,
    compose,
    light,
    make_proxy,
    edit_crops,
    edit_clean,
    select_by_hand,
    edit_file,
    edit_match,
    train,
    install_torch,
    calibrate,
    click_points,
    capture_cameras,
    capture_scene,
)


def register() -> None:
    for family in _FAMILIES:
        family.register()


def unregister() -> None:
    for family in reversed(_FAMILIES):
        family.unregister()
