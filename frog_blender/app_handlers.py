"""Blender's lists of functions to call when something happens."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

from . import reported_once

Handler = Callable[..., Any]  # Any: each list of Blender's passes other arguments
Handlers = list[tuple[list[Handler], Handler]]
"""Lists of ``bpy.app.handlers``, and what is to be called from each."""


def add(handlers: Handlers) -> None:
    """Puts each function into its list, once, guarded."""
    for functions, function in handlers:
        if guarded(function) not in functions:
            functions.append(guarded(function))


def remove(handlers: Handlers) -> None:
    """Takes each function out of its list, if it is there."""
    for functions, function in handlers:
        if guarded(function) in functions:
            functions.remove(guarded(function))


@cache
def guarded(function: Handler) -> Handler:
    """What stands for a function in Blender's lists: an error is reported once, not at every frame."""

    @wraps(function)  # with what ``persistent`` wrote on it
    def handler(*arguments: Any) -> None:
        try:
            function(*arguments)
        except Exception as error:
            reported_once.unexpected(f"{function.__module__}.{function.__name__}", error)

    return handler
