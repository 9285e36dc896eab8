"""Scene files, compared and falsified."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from frog_blender.engine.scene.scene_file import SceneFile


def same_arrays(one: SceneFile, other: SceneFile) -> bool:
    """Whether two scenes have the same numbers, to the bit."""
    return one.arrays.keys() == other.arrays.keys() and all(
        np.array_equal(array, other.arrays[name]) for name, array in one.arrays.items()
    )


def rewrite_header(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """A file of named arrays whose header says something else."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    change(header)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + content[8 + length :])
