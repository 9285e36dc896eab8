"""Registers what the rooms of the add-on define, and takes it back.

Of a room these are its classes of Blender's, in the order in which they are written, groups of properties where they
are ``attached_to``, what it draws in ``MENUS`` of Blender's, the ``KEYMAPS`` that call its operators, and the functions
of its ``HANDLERS``. What else there is to do, its ``register`` and ``unregister`` do, if it has them.
"""

from types import ModuleType
from typing import Any

import bpy
from bpy import types
from bpy.props import PointerProperty

from . import app_handlers

Keys = list[tuple[str, str, str, str, dict[str, bool]]]
"""Of operators: a keymap, the operator, the key and what happens to it, and what is held."""
_KINDS = (
    *(types.AddonPreferences, types.FileHandler, types.Menu, types.Operator, types.Panel, types.PropertyGroup),
    *(types.RenderEngine, types.UIList, types.GizmoGroup),
)


def classes_of(room: ModuleType) -> list[Any]:  # Any: Blender's classes
    """The classes of Blender's that a room defines, in order."""
    own = [kind for kind in vars(room).values() if getattr(kind, "__module__", "") == room.__name__]
    return [kind for kind in own if isinstance(kind, type) and issubclass(kind, _KINDS)]


def _keys_of(keymap: str) -> Any:
    """Where add-ons put keys: a keymap of viewports, or of a mode in all of Blender; None without a window."""
    keys, space = bpy.context.window_manager.keyconfigs.addon, "VIEW_3D" if keymap == "3D View" else "EMPTY"
    return None if keys is None else keys.keymaps.new(name=keymap, space_type=space).keymap_items


def register(room: ModuleType) -> None:
    for kind in classes_of(room):
        bpy.utils.register_class(kind)
        if hasattr(kind, "attached_to"):
            owner, name = kind.attached_to
            setattr(owner, name, PointerProperty(type=kind))
    for menu, draw in getattr(room, "MENUS", {}).items():
        getattr(types, menu).append(draw)
    for keymap, operator, key, value, held in getattr(room, "KEYMAPS", []):
        if (items := _keys_of(keymap)) is not None:
            items.new(operator, key, value, **held)
    app_handlers.add(getattr(room, "HANDLERS", []))
    if hasattr(room, "register"):
        room.register()


def unregister(room: ModuleType) -> None:
    app_handlers.remove(getattr(room, "HANDLERS", []))
    if hasattr(room, "unregister"):
        room.unregister()
    for keymap, operator, *_ in getattr(room, "KEYMAPS", []):
        items = _keys_of(keymap)
        for item in [item for item in items or () if item.idname == operator]:
            items.remove(item)
    for menu, draw in getattr(room, "MENUS", {}).items():
        getattr(types, menu).remove(draw)
    for kind in reversed(classes_of(room)):
        if hasattr(kind, "attached_to"):
            delattr(*kind.attached_to)
        bpy.utils.unregister_class(kind)
