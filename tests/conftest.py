"""What all tests share: one torch thread, a cache folder of their own, and a small recorded scene."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from frog_blender.engine.capture.capture import Capture
    from frog_blender.engine.frames.store import FrameStore

# The tests start several interpreters and threads of their own; torch must not add more.
os.environ.setdefault("OMP_NUM_THREADS", "1")
if str(Path(__file__).parent) not in sys.path:
    sys.path.insert(0, str(Path(__file__).parent))


INTEGRATION = (
    "benchmarks",
    "blender",
    "capture/calibration",
    "capture/readers/test_colmap.py",
    "capture/readers/test_layouts.py",
    "capture/synchronization",
    "capture/test_media.py",
    "capture/test_quality.py",
    "frames/test_seed_store.py",
    "capture/test_seeds.py",
    "capture/test_shipped_captures.py",
    "cli",
    "research",
    "playback/test_without_torch.py",
    "cuda",
    "rasterizer/test_bands.py",
    "rasterizer/test_options.py",
    "rasterizer/test_random_scenes.py",
    "test_damaged_files.py",
    "test_installed.py",
    "test_python_api.py",
    "training",
)
"""Folders and files of this one whose tests train, start other processes or Blender, or draw for seconds. ``make
test-fast`` leaves them out; what is added to another folder and does so belongs here as well."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """What is not asked for is not imported either: importing Blender and torch takes long as well."""
    without = "not integration" in config.option.markexpr
    return True if without and collection_path in _integration() else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    marked = _integration()
    for item in items:
        if not marked.isdisjoint((item.path, *item.path.parents)):
            item.add_marker(pytest.mark.integration)


def _integration() -> set[Path]:
    """The paths of ``INTEGRATION``; UsageError where one is not there, since its tests would no longer be marked."""
    tests = Path(__file__).parent
    if missing := [name for name in INTEGRATION if not (tests / name).exists()]:
        raise pytest.UsageError(f"{tests / missing[0]}: no such tests; mend INTEGRATION in tests/conftest.py.")
    return {tests / name for name in INTEGRATION}


def pytest_configure() -> None:
    """Requests to end reach the processes that tests start, also where ``nohup`` or a shell's ``&`` ignores them."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if sys.platform != "win32":
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session", autouse=True)
def one_torch_thread() -> None:
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture folder: see ``synthetic_capture.write_capture``. Its decoded frames lie in a cache folder beside it."""
    from support.synthetic_capture import write_capture

    return write_capture(tmp_path_factory.mktemp("filmed") / "capture")


@pytest.fixture
def n3dv(tmp_path: Path) -> Path:
    """A small capture to decode."""
    from support.small_captures import write_n3dv

    return write_n3dv(tmp_path / "n3dv")


@pytest.fixture(scope="session")
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("frames")


@pytest.fixture(scope="session")
def capture(filmed: Path) -> Capture:
    """The recorded scene, opened."""
    from frog_blender.engine.capture.readers import open_capture

    return open_capture(filmed)


@pytest.fixture(scope="session")
def store(capture: Capture, cache_folder: Path) -> FrameStore:
    """Its frames."""
    from frog_blender.engine.frames.store import FrameStore

    return FrameStore.open(capture, cache_folder=cache_folder)


@pytest.fixture
def own_cache(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """``FROG_CACHE`` set, for code that opens frame stores itself."""
    monkeypatch.setenv("FROG_CACHE", str(cache_folder))
    return cache_folder


@pytest.fixture
def quick_seeds(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every training starts from ``synthetic_capture.seeds`` instead of searching for seed points: no more
    than are asked for."""
    from support import synthetic_capture

    from frog_blender.engine.capture.seeds import Seeds, SeedSettings
    from frog_blender.engine.frames import seed_store

    def seeds(_capture: object, _store: object, settings: SeedSettings, _progress: object) -> Seeds:
        return synthetic_capture.seeds(min(300, settings.count_limit))

    monkeypatch.setattr(seed_store, "find_seeds", seeds)


@pytest.fixture
def run(own_cache: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """``status, stdout, stderr = run("info", path, ...)``: a command of ``frog`` in this process."""
    from frog_blender.cli.main import main

    def call(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        return status, *capsys.readouterr()

    return call


@pytest.fixture
def set_thread_count() -> Iterator[Callable[[int], None]]:
    """Sets the threads of the native library until the test ends."""
    from frog_blender.engine.native import binding

    yield binding.set_thread_count
    binding.set_thread_count(0)


@pytest.fixture
def same_on_threads(set_thread_count: Callable[[int], None]) -> Callable[..., None]:
    """Checks that a function gives arrays of the same bits on any number of the native library's threads."""
    import numpy as np

    def check(work: Callable[[], Iterable[Any]]) -> None:
        results = []
        for count in (1, 2, 7, 1):
            set_thread_count(count)
            results.append([np.asarray(array).tobytes() for array in work()])
        assert all(result == results[0] for result in results)

    return check
