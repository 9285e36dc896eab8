"""pycolmap, loaded when it is needed, in the child process alone: a C++ error in it ends the process."""

from __future__ import annotations

from typing import Any

from ...errors import FrogError
from ...optional_imports import is_missing, not_loaded


def load_pycolmap() -> Any:  # pycolmap's own types do not pass mypy's strict checks
    """pycolmap with its log turned down to errors.

    Raises:
        FrogError: if it is not installed, or cannot be loaded.
    """
    try:
        import pycolmap
    except ImportError as error:
        if not is_missing(error):
            raise FrogError(f"{not_loaded(error, 'pycolmap')}.") from error
        raise FrogError("Calibrating films needs pycolmap: pip install pycolmap.") from error
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    pycolmap.set_random_seed(0)
    return pycolmap
