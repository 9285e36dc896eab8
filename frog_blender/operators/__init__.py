"""Operators, one family per file. What a family registers, and in which menus it stands, its classes say."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

import bpy


def _families() -> list[ModuleType]:
    """Those of this edition, in the order of their names."""
    return [import_module(f".{module.name}", __package__) for module in iter_modules(__path__)]


def _classes(family: ModuleType) -> list[Any]:  # Any: Blender's classes
    """The operators and file handlers that a family defines, in order."""
    of_it = [kind for kind in vars(family).values() if getattr(kind, "__module__", "") == family.__name__]
    registered = bpy.types.Operator, bpy.types.FileHandler
    return [kind for kind in of_it if isinstance(kind, type) and issubclass(kind, registered)]


def _draw(self: bpy.types.Menu, name: str) -> None:
    for family in _families():
        for kind in _classes(family):
            if text := getattr(kind, name, ""):
                self.layout.operator(kind.bl_idname, text=text)


def _draw_imports(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    _draw(self, "import_menu")


def _draw_exports(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    _draw(self, "export_menu")


def register() -> None:
    for family in _families():
        for kind in _classes(family):
            bpy.utils.register_class(kind)
        if hasattr(family, "on_register"):
            family.on_register()
    bpy.types.TOPBAR_MT_file_import.append(_draw_imports)
    bpy.types.TOPBAR_MT_file_export.append(_draw_exports)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_draw_imports)
    bpy.types.TOPBAR_MT_file_export.remove(_draw_exports)
    for family in reversed(_families()):
        if hasattr(family, "on_unregister"):
            family.on_unregister()
        for kind in reversed(_classes(family)):
            bpy.utils.unregister_class(kind)
