"""The state of the add-on while it is enabled: one object of each class, created on first use.

Modules keep no state of their own. Each defines a class for what it has to remember and asks for the one object of it:
``addon_state.get(OpenScenes)``. Switching the add-on off drops them all.
"""

import threading
from typing import Any, TypeVar

T = TypeVar("T")

_lock = threading.RLock()  # renders call ``get`` from their own thread
_kept: dict[type, Any] = {}  # Any: the object of the type that is its key


def get(kind: type[T]) -> T:
    """The one object of a class, created without arguments on first use. Thread-safe."""
    with _lock:
        if kind not in _kept:
            _kept[kind] = kind()
        kept: T = _kept[kind]
    return kept


def put(state: object) -> None:
    """Replaces the object of a class, such as by one that was created with other arguments."""
    with _lock:
        _kept[type(state)] = state


def reset(kind: type) -> None:
    """Drops the object of a class; the next ``get`` makes a new one."""
    with _lock:
        _kept.pop(kind, None)


def clear() -> None:
    """Drops every object. To be called when the add-on is disabled, after all background work has ended."""
    with _lock:
        _kept.clear()
