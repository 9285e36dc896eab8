"""Registers what the rooms of the add-on define, and takes it back.

Of a room these are its classes of Blender's, in the order in which they are written, groups of properties where they
are ``attached_to``, what it draws in ``MENUS`` of Blender's, and the functions of its ``HANDLERS``. What else there is
to do, its ``register`` and ``unregister`` do, if it has them.
"""

from types import ModuleType
from typing import Any

import bpy
from bpy import types
from bpy.props import PointerProperty

from . import app_handlers

_KINDS = (
    *(types.AddonPreferences, types.FileHandler, types.Menu, types.Operator, types.Panel, types.PropertyGroup),
    *(types.RenderEngine, types.UIList),
)


def classes_of(room: ModuleType) -> list[Any]:  # Any: Blender's classes
    """The classes of Blender's that a room defines, in order."""
    own = [kind for kind in vars(room).values() if getattr(kind, "__module__", "") == room.__name__]
    return [kind for kind in own if isinstance(kind, type) and issubclass(kind, _KINDS)]


def register(room: ModuleType) -> None:
    for kind in classes_of(room):
        bpy.utils.register_class(kind)
        if hasattr(kind, "attached_to"):
            owner, name = kind.attached_to
            setattr(owner, name, PointerProperty(type=kind))
    for menu, draw in getattr(room, "MENUS", {}).items():
        getattr(types, menu).append(draw)
    app_handlers.add(getattr(room, "HANDLERS", []))
    if hasattr(room, "register"):
        room.register()


def unregister(room: ModuleType) -> None:
    app_handlers.remove(getattr(room, "HANDLERS", []))
    if hasattr(room, "unregister"):
        room.unregister()
    for menu, draw in getattr(room, "MENUS", {}).items():
        getattr(types, menu).remove(draw)
    for kind in reversed(classes_of(room)):
        if hasattr(kind, "attached_to"):
            delattr(*kind.attached_to)
        bpy.utils.unregister_class(kind)
