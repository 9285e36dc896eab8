"""How tiles are compressed: without loss, and what was damaged is found."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.codecs import TileCodec
from frog_blender.engine.frames.store import FrameStore


def tile(seed: int = 0) -> np.ndarray:
    """Small numbers, most of them near 0, as differences are."""
    return (np.random.default_rng(seed).normal(0, 3, (3, 32, 32)).astype(np.int16) % 256).astype(np.uint8)


def test_tiles_come_back_and_are_smaller() -> None:
    """By any number of threads; a tile of another size, or one that is cut off, is refused."""
    codec = TileCodec()

    def check(numbers: np.ndarray) -> None:
        packed = memoryview(codec.pack(numbers.data))
        assert codec.unpack(packed, numbers.size) == numbers.tobytes()
        for wrong, size in ((packed, numbers.size - 1), (packed, numbers.size + 1), (packed[:-1], numbers.size)):
            with pytest.raises(ValueError):
                codec.unpack(wrong, size)

    with ThreadPoolExecutor(4) as threads:
        list(
            threads.map(check, [*map(tile, range(50)), np.zeros((3, 1, 1), np.uint8), np.zeros((12, 64, 64), np.uint8)])
        )
    assert len(codec.pack(tile().data)) < 0.7 * tile().size


def test_without_zstandard_it_is_named(n3dv: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(FrogError, match="need zstandard"):
        FrameStore.open(open_capture(n3dv), cache_folder=tmp_path)
    assert not any(tmp_path.rglob("*.tiles"))
