"""What an earlier run kept is taken as it was, or not at all."""

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.io.work_folder import WorkFolder


@pytest.mark.parametrize("other", [{"a": np.arange(4)}, {"a": np.arange(3.0)}, {"b": np.arange(3)}, {}])
def test_other_arrays_are_not_loaded(tmp_path: Path, other: dict[str, np.ndarray]) -> None:
    work = WorkFolder(tmp_path)
    path = work.keep("stage", "0", {"a": np.arange(3)})
    assert np.array_equal((work.load("stage", "0") or other)["a"], [0, 1, 2])
    with np.load(path) as kept:
        seal = kept["seal"]
    np.savez(path, **other, seal=seal)
    assert work.load("stage", "0") is None
    np.savez(path, **other)
    assert work.load("stage", "0") is None and work.load("stage", "1") is None
