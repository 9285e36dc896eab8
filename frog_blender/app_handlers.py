"""Blender's lists of functions to call when something happens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Handlers = list[tuple[list[Any], Callable[..., Any]]]
"""Lists of ``bpy.app.handlers``, and what is to be called from each."""


def add(handlers: Handlers) -> None:
    """Puts each function into its list, once."""
    for functions, function in handlers:
        if function not in functions:
            functions.append(function)


def remove(handlers: Handlers) -> None:
    """Takes each function out of its list, if it is there."""
    for functions, function in handlers:
        if function in functions:
            functions.remove(function)
