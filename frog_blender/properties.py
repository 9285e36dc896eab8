"""Blender's properties, declared in a line: a name, a description, a default, and by keyword what else there is."""

from typing import Any

from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

HIDDEN = {"HIDDEN"}
"""Options of a property that no panel shows."""
_PATH = {"ANIMATABLE", "PATH_SUPPORTS_BLEND_RELATIVE"}


def switch(name: str, description: str, default: bool = False, **more: Any) -> Any:
    """On or off."""
    return BoolProperty(name=name, description=description, default=default, **more)


def whole(name: str, description: str, default: int = 0, **more: Any) -> Any:
    """A whole number."""
    return IntProperty(name=name, description=description, default=default, **more)


def number(name: str, description: str, default: float = 0.0, **more: Any) -> Any:
    """A number."""
    return FloatProperty(name=name, description=description, default=default, **more)


def vector(name: str, description: str, default: tuple[float, ...], **more: Any) -> Any:
    """Several numbers."""
    return FloatVectorProperty(name=name, description=description, default=default, size=len(default), **more)


def choice(name: str, description: str, items: Any, default: str | None = None, **more: Any) -> Any:
    """One of several items, each an identifier, a name and a description; the first where no default is named."""
    return EnumProperty(name=name, description=description, items=items, default=default or items[0][0], **more)


def text(name: str, description: str, default: str = "", **more: Any) -> Any:
    """A text."""
    return StringProperty(name=name, description=description, default=default, **more)


def path(name: str, description: str, default: str = "", *, subtype: str = "FILE_PATH", **more: Any) -> Any:
    """A path, which may begin at the .blend's folder."""
    return text(name, description, default, subtype=subtype, options=_PATH, **more)


def folder(name: str, description: str, default: str = "", **more: Any) -> Any:
    """The path of a folder; see ``path``."""
    return path(name, description, default, subtype="DIR_PATH", **more)


def reference(name: str, description: str, to: type, **more: Any) -> Any:
    """A data-block of a type of Blender's, or a group of properties."""
    return PointerProperty(name=name, description=description, type=to, **more)


def listed(name: str, description: str, of: type) -> Any:
    """Any number of groups of properties."""
    return CollectionProperty(name=name, description=description, type=of)
