"""Blender's lists of functions to call when something happens."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from . import reported_once

Handlers = list[tuple[list[Any], Callable[..., Any]]]
"""Lists of ``bpy.app.handlers``, and what is to be called from each."""

_guarded: dict[Callable[..., Any], Callable[..., Any]] = {}


def add(handlers: Handlers) -> None:
    """Puts each function into its list, once; what it raises is said once, not at every frame."""
    for functions, function in handlers:
        handler = _guarded.setdefault(function, _guard(function))
        if handler not in functions:
            functions.append(handler)


def remove(handlers: Handlers) -> None:
    """Takes each function out of its list, if it is there."""
    for functions, function in handlers:
        handler = _guarded.get(function)
        if handler in functions:
            functions.remove(handler)


def _guard(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)  # with what ``persistent`` wrote on it
    def handler(*arguments: Any) -> None:
        try:
            function(*arguments)
        except Exception as error:
            reported_once.unforeseen(f"{function.__module__}.{function.__name__}", error)

    return handler
