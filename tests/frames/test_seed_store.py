"""Seeds are found once and kept with the frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import synthetic_capture

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeds import Seeds
from frog_blender.engine.frames.seed_store import stored_seeds
from frog_blender.engine.frames.store import FrameStore


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    return open_capture(synthetic_capture.write_capture(tmp_path / "capture"))


@pytest.fixture
def store(capture: Capture, tmp_path: Path) -> FrameStore:
    return FrameStore.open(capture, cache_folder=tmp_path / "cache")


class Searches(list[int]):
    """In the place of ``find_seeds``: lists the seeds of its searches, which are short; each finds other points."""

    def __call__(self, *_: Any, seed: int = 0, **__: Any) -> Seeds:
        self.append(seed)
        return replace(synthetic_capture.seeds(), points=synthetic_capture.seeds().points + np.float32(len(self)))


@pytest.fixture
def searches() -> Searches:
    return Searches()


def same(a: Seeds, b: Seeds) -> bool:
    arrays = np.array_equal(a.points, b.points) and np.array_equal(a.colors, b.colors)
    if a.frames is None or b.frames is None:
        return a.origin == b.origin and arrays and a.frames is b.frames
    return a.origin == b.origin and arrays and np.array_equal(a.frames, b.frames, equal_nan=True)


def test_the_same_question_is_answered_from_the_disk(capture: Capture, store: FrameStore, searches: Searches) -> None:
    first = stored_seeds(capture, store, count_limit=300, seed=1, search=searches)
    assert same(first, stored_seeds(capture, store, count_limit=300, seed=1, search=searches))
    assert searches == [1]
    assert not list(store.folder.glob(".seeds-*"))


@pytest.mark.parametrize(
    "changed",
    [
        lambda c: replace(c, cameras=(c.cameras[0].with_pose(np.eye(4)), *c.cameras[1:])),
        lambda c: c.with_holdout(2),
        lambda c: replace(c, test_cameras=frozenset()),
        lambda c: replace(c, near_far=(0.5, 77.0)),
        lambda c: replace(c, points=np.zeros((3, 3))),
    ],
)
def test_whatever_decides_them_has_seeds_of_its_own(
    capture: Capture, store: FrameStore, searches: Searches, changed: Callable[[Capture], Capture]
) -> None:
    first = stored_seeds(capture, store, count_limit=300, seed=1, search=searches)
    assert not same(first, stored_seeds(changed(capture), store, count_limit=300, seed=1, search=searches))
    stored_seeds(capture, store, count_limit=200, seed=1, search=searches)
    stored_seeds(capture, store, count_limit=300, seed=2, search=searches)
    stored_seeds(capture, store, count_limit=300, seed=1, share=0.5, search=searches)
    stored_seeds(capture, store, count_limit=300, seed=1, num_moments=4, search=searches)
    assert len(searches) == 6


def test_times_are_kept(capture: Capture, store: FrameStore) -> None:
    frames = np.full(300, np.nan, np.float32)
    frames[200:] = 2
    timed = replace(synthetic_capture.seeds(), frames=frames)
    first = stored_seeds(capture, store, count_limit=300, num_moments=4, search=lambda *_, **__: timed)
    assert same(first, timed)
    searches = Searches()
    assert same(first, stored_seeds(capture, store, count_limit=300, num_moments=4, search=searches))
    assert not searches


def test_a_damaged_file_is_found_again(capture: Capture, store: FrameStore, searches: Searches) -> None:
    stored_seeds(capture, store, count_limit=300, search=searches)
    (path,) = store.folder.glob("seeds-*.npz")
    path.write_bytes(path.read_bytes()[:200])
    stored_seeds(capture, store, count_limit=300, search=searches)
    stored_seeds(capture, store, count_limit=300, search=searches)
    assert len(searches) == 2


@pytest.mark.parametrize(
    "changes",
    [
        {"points": np.zeros((2**20, 3), np.float32)},
        {"points": np.full((300, 3), np.nan, np.float32)},
        {"points": np.zeros((0, 3), np.float32), "colors": np.zeros((0, 3), np.float32)},
        {"colors": np.full((300, 3), 7, np.float32)},
        {"colors": np.zeros((299, 3), np.float32)},
        {"origin": np.array(3)},
        {"frames": np.zeros(299, np.float32)},
        {"frames": np.full(300, -1, np.float32)},
        {"frames": np.full(300, 1e9, np.float32)},
        {"origin": np.array({}, dtype=object)},
    ],
)
def test_what_no_search_finds_is_found_again(
    capture: Capture, store: FrameStore, searches: Searches, changes: dict[str, np.ndarray]
) -> None:
    first = stored_seeds(capture, store, count_limit=300, search=searches)
    (path,) = store.folder.glob("seeds-*.npz")
    kept = {"points": first.points, "colors": first.colors, "origin": np.array(first.origin)}
    np.savez_compressed(path, **kept)
    stored_seeds(capture, store, count_limit=300, search=searches)
    assert len(searches) == 1
    np.savez_compressed(path, **{**kept, **changes})
    stored_seeds(capture, store, count_limit=300, search=searches)
    assert len(searches) == 2


def test_a_disk_that_takes_nothing_is_no_reason_to_stop(
    capture: Capture, store: FrameStore, searches: Searches, tmp_path: Path
) -> None:
    store.folder = tmp_path / "gone"  # where nothing can be written
    assert len(stored_seeds(capture, store, count_limit=300, search=searches).points)
    assert len(stored_seeds(capture, store, count_limit=300, search=searches).points)
    assert len(searches) == 2 and not store.folder.exists()
