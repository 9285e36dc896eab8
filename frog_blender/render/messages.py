"""What a person in front of Blender is told when there is no image."""

from __future__ import annotations

from ..engine.errors import FrogError


def error_message(error: Exception) -> str:
    """A sentence for an error that a final render or a viewport met."""
    if isinstance(error, MemoryError):
        return f"Out of memory{f' ({error})' if str(error) else ''}: make the image smaller or hide captures."
    return str(error) if isinstance(error, FrogError) else f"FRoG could not draw: {error!r}."
