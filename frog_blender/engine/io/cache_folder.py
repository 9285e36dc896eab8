"""Where this computer keeps what can be made again."""

import os
from pathlib import Path


def default_cache_folder() -> Path:
    """``$FROG_CACHE``, or ``frog_blender`` in the platform's cache folder of this user."""
    if os.environ.get("FROG_CACHE"):
        return Path(os.environ["FROG_CACHE"])
    if os.name == "nt":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
    elif os.uname().sysname == "Darwin":
        base = str(Path.home() / "Library" / "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "frog_blender"
