"""Registration of functions in ``bpy.app.handlers`` and ``bpy.app.timers``."""

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

import bpy
from bpy.app.handlers import persistent

from . import reported_once

Handler = Callable[..., Any]  # Any: each list of Blender's passes other arguments
Handlers = list[tuple[list[Handler], Handler]]
"""Pairs of a list of ``bpy.app.handlers`` and a function to register there."""


def add(handlers: Handlers) -> None:
    """Registers each function once, wrapped by ``guarded``, for all files that are opened."""
    for functions, function in handlers:
        if guarded(function) not in functions:
            functions.append(guarded(function))


def remove(handlers: Handlers) -> None:
    """Unregisters each function that is registered."""
    for functions, function in handlers:
        if guarded(function) in functions:
            functions.remove(guarded(function))


def later(function: Handler, seconds: float = 0.0, *, persistent: bool = False) -> None:
    """Has Blender call a function after a while, when it does not draw; once, unless the function waits already.

    Args:
        persistent: also where another file is opened meanwhile.
    """
    if not bpy.app.timers.is_registered(function):
        bpy.app.timers.register(function, first_interval=seconds, persistent=persistent)


def not_later(*functions: Handler) -> None:
    """Calls off what ``later`` was asked for."""
    for function in functions:
        if bpy.app.timers.is_registered(function):
            bpy.app.timers.unregister(function)


@cache
def guarded(function: Handler) -> Handler:
    """The wrapper that is registered for a function: it reports an error once instead of at every frame."""

    @persistent
    @wraps(function)
    def handler(*arguments: Any) -> None:
        try:
            function(*arguments)
        except Exception as error:
            reported_once.unexpected(f"{function.__module__}.{function.__name__}", error)

    return handler
