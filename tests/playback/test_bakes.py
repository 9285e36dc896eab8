"""Bakes are read by what they are, not by what they say: nothing is allocated for a header, nothing raised but a
sentence."""

import os
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.builders import scene_file
from support.scene_files import rewrite_header

from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.bake import Bake, fingerprint, write_bake
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import write_scene

TIMES = [0.0, 0.5, 1.0]


@pytest.fixture
def baked(tmp_path: Path) -> tuple[Path, Path, ScenePlayer]:
    """The bake, its scene's file, and the scene."""
    source = tmp_path / "x.frog"
    write_scene(source, scene_file())
    scene, path = ScenePlayer.load(source), tmp_path / "x.frogbake"
    list(write_bake(path, source, scene, TIMES))
    return path, source, scene


def test_a_disk_that_is_too_small_is_told(
    baked: tuple[Path, Path, ScenePlayer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=100))
    with pytest.raises(FrogError, match="needs 0 MB, found 0 MB on the disk"):
        list(write_bake(*baked, TIMES))


TIMES_THAT_ARE_NONE = ("[1e400]", '["0", 0.5, 1]', "[NaN, 0.5, 1]", "3", "null", "[" * 100_000, "[0, 0.5, 2]", "")
HOSTILE: dict[str, Callable[[dict[str, Any], dict[str, Any]], None]] = {
    "shape": lambda entry, _: entry.update(shape=[2**62, 2**62]),
    "one axis": lambda entry, _: entry.update(shape=[3 * 560]),
    "three axes": lambda entry, _: entry.update(shape=[3, 560, 1]),
    **{
        f"times {text[:20]}": lambda _, metadata, text=text: metadata.update(times=text) for text in TIMES_THAT_ARE_NONE
    },
    "type": lambda entry, _: entry.update(dtype="I32"),
    "columns": lambda _, metadata: metadata.update(columns="[" * 50_000),
    "other columns": lambda _, metadata: metadata.update(columns='["means"]'),
    "no scene": lambda _, metadata: metadata.pop("scene"),
    "many lists": lambda _, metadata: metadata.update(more=[[]] * 100_000),
}
"""What the header of any file of arrays may say is test_tensor_files' matter."""


@pytest.mark.parametrize("what", HOSTILE)
def test_a_header_that_lies_is_refused(baked: tuple[Path, Path, ScenePlayer], what: str) -> None:
    path, source, scene = baked
    rewrite_header(path, lambda header: HOSTILE[what](header["moments"], header["__metadata__"]))
    tracemalloc.start()
    with pytest.raises(FrogError) as caught:
        Bake(path, source, scene)
    assert tracemalloc.get_traced_memory()[1] < 40e6, "a 28 kB file asked for 2 GB"
    tracemalloc.stop()
    assert str(path) in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 800


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_a_bake_replaces_a_link_instead_of_following_it(baked: tuple[Path, Path, ScenePlayer]) -> None:
    path, source, scene = baked
    precious = path.with_name("precious.txt")
    precious.write_text("mine")
    path.unlink()
    path.symlink_to(precious)
    list(write_bake(path, source, scene, TIMES))
    assert precious.read_text() == "mine" and not path.is_symlink()
    assert fingerprint(source) and len(Bake(path, source, scene)) == 3
