"""What all tests share: one torch thread, a cache folder of their own, and a small recorded scene."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

# The tests start several interpreters and threads of their own; torch must not add more.
os.environ.setdefault("OMP_NUM_THREADS", "1")
if str(Path(__file__).parent) not in sys.path:
    sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session", autouse=True)
def one_torch_thread() -> None:
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture folder: see ``synthetic_capture.write_capture``. Its decoded frames lie in a cache folder beside it."""
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


@pytest.fixture
def quick_seeds(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every training starts from ``synthetic_capture.seeds`` instead of searching for seed points."""
    from support import synthetic_capture

    from frog_blender.engine.capture import seed_store

    monkeypatch.setattr(seed_store, "find_seeds", lambda *_, **__: synthetic_capture.seeds())
