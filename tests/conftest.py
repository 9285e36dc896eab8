"""What all tests share: one torch thread, frame stores away from the user's cache, and a small filmed scene."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

# The tests start several interpreters and threads of their own; torch must not add more.
os.environ.setdefault("OMP_NUM_THREADS", "1")
if str(Path(__file__).parent) not in sys.path:
    sys.path.insert(0, str(Path(__file__).parent))


INTEGRATION = (
    "benchmarks",
    "blender",
    "capture/test_seeds.py",
    "cli",
    "experiments",
    "io/test_mutated_files.py",
    "playback/test_without_torch.py",
    "rasterizer/cuda",
    "rasterizer/test_bands.py",
    "rasterizer/test_random_scenes.py",
    "rasterizer/test_reference_gradients.py",
    "training",
)
"""Folders and files of this one whose tests train, start other processes or Blender, or draw for seconds. ``make
test-fast`` leaves them out; what is added to another folder and does so belongs here as well."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks what ``INTEGRATION`` names."""
    tests = Path(__file__).parent
    marked = {tests / name for name in INTEGRATION}
    if missing := sorted(path for path in marked if not path.exists()):
        raise pytest.UsageError(f"{missing[0]}: there are no such tests; mend INTEGRATION in {__file__}.")
    for item in items:
        if not marked.isdisjoint((item.path, *item.path.parents)):
            item.add_marker(pytest.mark.integration)


@pytest.fixture(scope="session", autouse=True)
def one_torch_thread() -> None:
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture folder: see ``filmed.write_capture``. Its decoded frames lie in a cache folder beside it."""
    from support.synthetic_capture import write_capture

    return write_capture(tmp_path_factory.mktemp("filmed") / "capture")


@pytest.fixture(scope="session")
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("frames")


@pytest.fixture
def own_cache(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """``FROG_CACHE`` set, for code that opens frame stores itself."""
    monkeypatch.setenv("FROG_CACHE", str(cache_folder))
    return cache_folder
