"""Operators, one family per file. What a family registers, and in which menus it stands, its classes say."""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

import bpy

from .. import registration


def _families() -> list[ModuleType]:
    """Those of this edition, in the order of their names."""
    return [import_module(f".{module.name}", __package__) for module in iter_modules(__path__)]


def _draw(self: bpy.types.Menu, name: str) -> None:
    for family in _families():
        for kind in registration.classes_of(family):
            if text := getattr(kind, name, ""):
                self.layout.operator(kind.bl_idname, text=text)


def _draw_imports(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    _draw(self, "import_menu")


def _draw_exports(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    _draw(self, "export_menu")


MENUS = {"TOPBAR_MT_file_import": _draw_imports, "TOPBAR_MT_file_export": _draw_exports}


def register() -> None:
    for family in _families():
        registration.register(family)


def unregister() -> None:
    for family in reversed(_families()):
        registration.unregister(family)
