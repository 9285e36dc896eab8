"""Gaussians of which nothing changes but their opacity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.builders import ATTRIBUTES
from support.played_scenes import TIMES, assert_same_bits, fading

from frog_blender.engine.errors import FrogError
from frog_blender.engine.field.opacity_tracks import OpacityTracks, quantize_opacities
from frog_blender.engine.model.torch_player import TorchScenePlayer
from frog_blender.engine.native.deformation import FieldShape
from frog_blender.engine.playback.frame_delta import canonical_gaussians
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile, read_scene, write_scene
from frog_blender.engine.training.compression.finalize import as_packed, reorder_for_playback

SHAPE = FieldShape(0, 4, 1, "unit", 10.0, 1.0, 0.5)


def test_tracks_are_linear_between_frames() -> None:
    opacities = np.array([[0.0, 1.0, 0.5], [0.2, 0.2, 0.2]], np.float32)
    fades, found = OpacityTracks(quantize_opacities(opacities)), np.empty(2, np.float32)
    assert len(fades) == 2
    for time, expected in ((0.0, 0.0), (0.125, 0.25), (0.5, 1.0), (0.75, 0.75), (1.0, 0.5)):
        fades.at(time, found)
        np.testing.assert_allclose(found, [expected, 0.2], atol=0.6 / 255)
    OpacityTracks(quantize_opacities(opacities[:, 1:2])).at(0.7, found)  # a single frame
    np.testing.assert_allclose(found, [1.0, 0.2], atol=0.6 / 255)


def test_more_tracks_than_gaussians_are_refused() -> None:
    scene = fading()
    with pytest.raises(FrogError, match="cannot be used"):
        ScenePlayer(SceneFile(scene.header, scene.arrays | {"fades": np.zeros((81, 7), np.uint8)}))


@pytest.mark.parametrize("tracks", [np.zeros((0, 7), np.uint8), np.zeros(7, np.uint8), np.zeros((3, 7), np.float32)])
def test_tracks_of_another_kind_are_refused(tracks: np.ndarray) -> None:
    scene = fading()
    with pytest.raises(FrogError, match="fades are"):
        ScenePlayer(SceneFile(scene.header, scene.arrays | {"fades": tracks}))


@pytest.mark.parametrize("model", [{}, {"deformed_sh": 0}, {"deformed_sh": 4}, {"fusion": "dual"}], ids=str)
def test_only_what_changes_differs_from_rest(model: dict) -> None:
    scene = fading(**model)
    whole = {name: array for name, array in scene.arrays.items() if name != "fades"}
    all_change = ScenePlayer(SceneFile(scene.header, whole))
    playable, still = assert_same_bits(scene), canonical_gaussians(scene.arrays)
    assert playable.num_dynamic == 160 and "scales" in playable.changing
    for time in TIMES:
        found, expected = playable.at(time), all_change.at(time)
        for name in ATTRIBUTES:
            values, other = getattr(found, name), getattr(expected, name)
            np.testing.assert_array_equal(values[:120], other[:120], err_msg=name)
            if name != "opacities":
                np.testing.assert_allclose(values[120:], getattr(still, name)[120:], rtol=1e-6, err_msg=name)
        assert np.abs(found.opacities[120:160] - still.opacities[120:160]).max() > 0.1


def test_parts_of_a_scene_keep_their_kinds() -> None:
    scene = fading()
    whole = ScenePlayer(scene)
    for first, last in ((0, 200), (30, 140), (120, 200), (125, 130), (170, 200), (45, 55)):
        kept = np.arange(first, last, 2)
        part = whole.subset(kept)
        assert part.count == len(kept) and part.num_dynamic == int((kept < 160).sum())
        for time in TIMES:
            found, expected = part.at(time), whole.at(time)
            for name in ATTRIBUTES:
                np.testing.assert_allclose(getattr(found, name), getattr(expected, name)[kept], rtol=1e-5, atol=1e-6)
    assert_same_bits(scene)


@pytest.mark.parametrize("compact", [False, True])
def test_files_keep_them(tmp_path: Path, compact: bool) -> None:
    """In the order of a file, with lifetimes beside them; torch plays the same."""
    scene = reorder_for_playback(fading(fleeting=True))
    assert "lifetimes" in scene.arrays
    write_scene(tmp_path / "a.frog", scene, compact=compact)
    back, expected = read_scene(tmp_path / "a.frog"), as_packed(scene) if compact else scene
    assert back.arrays.keys() == expected.arrays.keys()
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array, err_msg=name)
    playable = assert_same_bits(back)
    for time in TIMES:
        played, on_device = playable.at(time), TorchScenePlayer(back, "cpu").at(time)
        seen = played.opacities > 0
        for name in ATTRIBUTES:
            values = getattr(on_device, name).numpy()
            if name == "quaternions":
                values = values / np.linalg.norm(values, axis=1, keepdims=True)
            np.testing.assert_allclose(values[seen], getattr(played, name)[seen], rtol=1e-4, atol=1e-4, err_msg=name)


def test_the_order_of_a_file_keeps_kinds_apart() -> None:
    """Whoever is where: the same Gaussians of each kind, at the same time."""
    scene = fading(fleeting=True)
    found = reorder_for_playback(scene)
    for first, last in ((0, 120), (120, 160), (160, 200)):
        before, after = (sorted(map(tuple, each.arrays["means"][first:last])) for each in (scene, found))
        assert before == after
    brightest = [
        ScenePlayer(each).at(0.5).opacities[120:160][each.arrays["means"][120:160, 0].argsort()]
        for each in (scene, found)
    ]
    np.testing.assert_array_equal(*brightest)
