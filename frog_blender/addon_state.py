"""What the add-on keeps while it is switched on: one object of each kind, made when it is first asked for.

Modules keep no state of their own. Each defines a class for what it has to remember and asks for the one object of it:
``addon_state.get(OpenScenes)``. Switching the add-on off drops them all.
"""

from __future__ import annotations

import threading
from typing import Any, TypeVar

T = TypeVar("T")

_lock = threading.RLock()  # renders ask in their own thread
_kept: dict[type, Any] = {}  # Any: the object of the type that is its key


def get(kind: type[T]) -> T:
    """The one object of a class, which is made without arguments; any thread may ask."""
    found: T | None = _kept.get(kind)
    if found is None:
        with _lock:
            found = _kept.get(kind)
            if found is None:
                found = _kept[kind] = kind()
    return found


def put(state: object) -> None:
    """Has an object take the place of the one of its class, such as one that was made with other arguments."""
    with _lock:
        _kept[type(state)] = state


def reset(kind: type) -> None:
    """Drops the object of a class; the next ``get`` makes a new one."""
    with _lock:
        _kept.pop(kind, None)


def clear() -> None:
    """Drops every object: for switching the add-on off, after everything that works in the background has ended."""
    with _lock:
        _kept.clear()
