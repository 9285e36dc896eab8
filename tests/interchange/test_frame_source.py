"""Frames of another program as a scene: stored one by one, played at any time, held where rows are others."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import refused
from support.foreign_takes import assert_plays_alike, partly_static
from support.played_scenes import assert_same_bits
from support.scene_files import rewrite_header

from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import ATTRIBUTES, GaussianArrays
from frog_blender.engine.interchange import imports
from frog_blender.engine.interchange.frame_source import FrameSource
from frog_blender.engine.interchange.imports import write_source
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene

Change = Callable[[GaussianArrays, int], GaussianArrays]


class Frames(FrameSource):
    """A scene's frames, as another program might have written them."""

    origin = "test"

    def __init__(self, scene: ScenePlayer, change: Change | None = None, keeps_identity: bool | None = True) -> None:
        self._scene, self._change, self.keeps_identity = scene, change, keeps_identity
        self.frame_count = scene.header.frame_count
        self.asked: list[int] = []

    def at(self, frame: int) -> GaussianArrays:
        self.asked.append(frame)
        gaussians = self._scene.at_frame(frame % 7)
        return gaussians if self._change is None else self._change(gaussians, frame)


@pytest.mark.parametrize("compact", [False, True])
def test_it_plays_what_the_frames_were(scene: ScenePlayer, tmp_path: Path, compact: bool) -> None:
    source = Frames(scene)
    told: list[tuple[int, int]] = []
    imported = write_source(
        source, tmp_path / "x.src", tmp_path / "y.frog", compact=compact, progress=lambda *done: told.append(done)
    )
    assert (imported.gaussians, imported.frames, imported.keeps_identity, imported.warning) == (40, 7, True, "")
    assert source.asked == [*range(7), *range(7)] and told[-1] == (14, 14)
    assert (imported.path.stat().st_size < 10_000) == compact
    assert "frames" not in read_scene(imported.path).arrays, "a frame is all that is held"
    back = assert_same_bits(read_scene(imported.path))
    assert (back.count, back.num_dynamic) == (40, 25) and set(back.changing) == set(scene.changing)
    assert_plays_alike(back, scene.at_frame, [0, 2, 6], 0.02 if compact else 1e-6, 0.02 if compact else 1e-6)
    before, after, between = (back.at_frame(frame).means for frame in (2, 3, 2.5))
    np.testing.assert_allclose(between, (before + after) / 2, atol=1e-6)
    assert np.abs(after - before).max() > 1e-2


def test_some_of_the_gaussians_are_those_of_the_whole(scene: ScenePlayer, tmp_path: Path) -> None:
    write_source(Frames(scene), tmp_path / "x.src", tmp_path / "y.frog")
    playing = ScenePlayer.load(tmp_path / "y.frog")
    kept = np.array([0, 3, 24, 25, 39])
    fewer, whole = playing.subset(kept).at(0.4), playing.at(0.4)
    again = playing.subset(kept).subset(np.array([1, 2, 4])).at(0.4)
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(getattr(fewer, name), getattr(whole, name)[kept])
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name)[[3, 24, 39]])


def test_rows_that_change_places_are_no_identity(scene: ScenePlayer, tmp_path: Path) -> None:
    """Nobody said that they do, but what moves as far as from one Gaussian to another is not the same one."""
    shuffled = Frames(scene, lambda g, frame: g.part(np.random.default_rng(frame).permutation(40)), None)
    assert not write_source(shuffled, tmp_path / "x", tmp_path / "y.frog").keeps_identity


def test_frames_that_do_not_change_are_a_static_scene(scene: ScenePlayer, tmp_path: Path) -> None:
    still = Frames(scene, lambda _gaussians, _frame: scene.at_frame(0))
    back = read_scene(write_source(still, tmp_path / "x", tmp_path / "y.frog").path)
    assert (back.header.method, back.rows, back.header.frame_count) == ("static", None, 7)


def test_harmonics_that_end_are_gone(tmp_path: Path) -> None:
    """A later frame of a lower degree, whose rows are the same Gaussians."""
    scene = partly_static(tmp_path, sh_count=4)
    plainer = Frames(scene, lambda g, frame: replace(g, sh=g.sh[:, : 1 if frame > 3 else 4]))
    back = ScenePlayer.load(write_source(plainer, tmp_path / "x", tmp_path / "y.frog").path)
    assert np.abs(back.at_frame(3).sh[:, 1:]).max() > 0.01
    assert not back.at_frame(4).sh[:, 1:].any()


def test_what_could_not_be_opened_or_has_no_room_is_not_written(
    scene: ScenePlayer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow, filmed, long = Frames(scene), Frames(scene), Frames(scene)
    slow.rate = 1e-7
    with pytest.raises(FrogError, match=r"x\.src: no scene of it could be opened: found .*frames_per_second"):
        write_source(slow, tmp_path / "x.src", tmp_path / "y.frog")
    filmed.cameras = scene.header.cameras[:1] * 700_000
    refused("4,900,000 frames of all cameras", write_source, filmed, tmp_path / "x.src", tmp_path / "y.frog")
    (tmp_path / "x.src").write_bytes(bytes(100))
    monkeypatch.setattr(imports, "_ROOM", 1 << 20)
    long.frame_count = 1000
    with pytest.raises(FrogError, match=r"1,000 frames of 25 Gaussians, .* MB of a file of its size"):
        write_source(long, tmp_path / "x.src", tmp_path / "y.frog")
    assert not (tmp_path / "y.frog").exists()


@pytest.mark.parametrize(
    ("model", "sentence"),
    [
        ({"dynamic": 41}, "dynamic"),
        ({"dynamic": 24}, "frames of shape"),
        ({"columns": ["means", "means"]}, "the columns means, means"),
        ({"columns": ["hue"]}, "the columns hue"),
        ({"columns": 3}, "columns"),
        ({"keeps_identity": 1}, "keeps_identity of the model = 1"),
        ({"half": True}, "frames of shape"),
    ],
)
def test_a_header_that_lies_is_one_sentence(
    scene: ScenePlayer, tmp_path: Path, model: dict[str, object], sentence: str
) -> None:
    write_source(Frames(scene), tmp_path / "x", tmp_path / "y.frog")

    def lie(header: dict[str, Any]) -> None:
        own = json.loads(header["__metadata__"]["frog"])
        own["model"] |= model
        header["__metadata__"]["frog"] = json.dumps(own)

    rewrite_header(tmp_path / "y.frog", lie)
    refused(sentence, ScenePlayer.load, tmp_path / "y.frog")


def test_a_file_that_changes_while_it_plays_is_one_sentence(scene: ScenePlayer, tmp_path: Path) -> None:
    write_source(Frames(scene), tmp_path / "x", tmp_path / "y.frog")
    playing = ScenePlayer.load(tmp_path / "y.frog")
    (tmp_path / "y.frog").write_bytes((tmp_path / "y.frog").read_bytes()[:-10])
    refused("another version of it", playing.at, 0.5)


def test_numbers_that_are_none_are_drawn_as_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    def broken(gaussians: GaussianArrays, frame: int) -> GaussianArrays:
        gaussians = gaussians.part(np.arange(40))  # what plays is read-only
        if frame == 3:
            gaussians.means[0], gaussians.scales[1], gaussians.opacities[2] = np.nan, -1.0, 7.0
        return gaussians

    back = ScenePlayer.load(write_source(Frames(scene, broken), tmp_path / "x", tmp_path / "y.frog").path)
    for array in back.at_frame(3).arrays.values():
        assert np.isfinite(array).all()
    assert back.at_frame(3).scales.min() >= 0 and back.at_frame(3).opacities.max() <= 1


def test_a_source_that_fails_changes_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    def failing(gaussians: GaussianArrays, _frame: int) -> GaussianArrays:
        if len(source.asked) > 9:
            raise FrogError("it failed.")
        return gaussians

    source = Frames(scene, failing)
    (tmp_path / "y.frog").write_bytes(b"before")
    refused("it failed", write_source, source, tmp_path / "x", tmp_path / "y.frog")
    assert (tmp_path / "y.frog").read_bytes() == b"before" and len(list(tmp_path.iterdir())) == 2
