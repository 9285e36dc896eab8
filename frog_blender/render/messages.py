"""Messages for images that could not be drawn."""

from __future__ import annotations

from ..engine.errors import FrogError


def error_message(error: Exception) -> str:
    """A sentence for an error in a final render or a viewport."""
    if isinstance(error, MemoryError):
        return f"Out of memory{f' ({error})' if str(error) else ''}. Reduce the image size or hide captures."
    return str(error) if isinstance(error, FrogError) else f"FRoG could not draw: {error!r}."
