"""Seeds are found once and kept with the frames."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_capture

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeds import Seeds, SeedSettings
from frog_blender.engine.frames import seed_store
from frog_blender.engine.frames.store import FrameStore

SETTINGS = SeedSettings(300, seed=1)


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    return open_capture(synthetic_capture.write_capture(tmp_path / "capture"))


@pytest.fixture
def store(capture: Capture, tmp_path: Path) -> FrameStore:
    return FrameStore.open(capture, cache_folder=tmp_path / "cache")


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[SeedSettings]:
    """The searches that ``find_seeds`` made, which are short; each finds other points, the last of them timed."""
    made: list[SeedSettings] = []

    def find(_capture: object, _store: object, settings: SeedSettings, _progress: object) -> Seeds:
        made.append(settings)
        seeds = synthetic_capture.seeds()
        frames = np.full(len(seeds.points), np.nan, np.float32)
        frames[200:] = 2
        return replace(seeds, points=seeds.points + np.float32(len(made)), frames=frames)

    monkeypatch.setattr(seed_store, "find_seeds", find)
    return made


def same(a: Seeds, b: Seeds) -> bool:
    assert a.frames is not None and b.frames is not None
    arrays = np.array_equal(a.points, b.points) and np.array_equal(a.colors, b.colors)
    return a.origin == b.origin and arrays and np.array_equal(a.frames, b.frames, equal_nan=True)


def test_the_same_question_is_answered_from_the_disk(
    capture: Capture, store: FrameStore, searches: list[SeedSettings]
) -> None:
    first = seed_store.stored_seeds(capture, store, SETTINGS)
    assert same(first, seed_store.stored_seeds(capture, store, SETTINGS))
    assert searches == [SETTINGS]
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
    capture: Capture, store: FrameStore, searches: list[SeedSettings], changed: Callable[[Capture], Capture]
) -> None:
    first = seed_store.stored_seeds(capture, store, SETTINGS)
    assert not same(first, seed_store.stored_seeds(changed(capture), store, SETTINGS))
    for other in ({"count_limit": 200}, {"seed": 2}, {"share": 0.5}, {"num_moments": 4}):
        seed_store.stored_seeds(capture, store, replace(SETTINGS, **other))
    assert len(searches) == 6


def test_what_was_damaged_is_found_again(capture: Capture, store: FrameStore, searches: list[SeedSettings]) -> None:
    seed_store.stored_seeds(capture, store, SETTINGS)
    (path,) = store.folder.glob("seeds-*.npz")
    with np.load(path) as kept:
        arrays = dict(kept)
    np.savez(path, **{**arrays, "colors": arrays["colors"] + np.float32(1)})
    seed_store.stored_seeds(capture, store, SETTINGS)
    path.write_bytes(path.read_bytes()[:200])
    seed_store.stored_seeds(capture, store, SETTINGS)
    assert len(searches) == 3


def test_a_disk_that_takes_nothing_is_no_reason_to_stop(
    capture: Capture, store: FrameStore, searches: list[SeedSettings], tmp_path: Path
) -> None:
    store.folder = tmp_path / "file"  # where nothing can be written
    store.folder.touch()
    for count in (1, 2):
        assert len(seed_store.stored_seeds(capture, store, SETTINGS).points) and len(searches) == count
