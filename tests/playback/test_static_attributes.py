"""Gaussians of which not all attributes change: some keep their shape, some only fade."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import ATTRIBUTES, scene_file
from support.deformation_fields import field_arrays, in_groups, output_arrays
from support.played_scenes import TIMES, assert_same_bits, spared

from frog_blender.engine.errors import FrogError
from frog_blender.engine.field.opacity_tracks import OpacityTracks, quantize_opacities
from frog_blender.engine.model.torch_player import TorchScenePlayer
from frog_blender.engine.native.deformation import FieldShape, PlaybackField
from frog_blender.engine.playback.canonical import canonical_gaussians
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.simd_layout import GROUP_SIZE
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


@pytest.mark.parametrize("tracks", [np.zeros((0, 7), np.uint8), np.zeros(7, np.uint8), np.zeros((3, 7), np.float32)])
def test_tracks_of_another_kind_are_refused(tracks: np.ndarray) -> None:
    scene = spared()
    with pytest.raises(FrogError, match="fades are"):
        ScenePlayer(SceneFile(scene.header, scene.arrays | {"fades": tracks}))


@pytest.mark.parametrize(("num_shape_dynamic", "tracks"), [(-1, 40), (121, 40), ("many", 40), (50, 181)])
def test_counts_that_cannot_be_are_refused(num_shape_dynamic: object, tracks: int) -> None:
    scene = spared()
    header = replace(scene.header, model=scene.header.model | {"reshaped": num_shape_dynamic})
    arrays = scene.arrays | {"fades": np.zeros((tracks, 7), np.uint8)}
    with pytest.raises(FrogError, match="cannot be used"):
        ScenePlayer(SceneFile(header, arrays))
    heads = scene_file(40, head_width=8)
    header = replace(heads.header, model=heads.header.model | {"reshaped": 5})
    with pytest.raises(FrogError, match="cannot be used"):
        ScenePlayer(SceneFile(header, heads.arrays))


@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize("count", [5, 7 * GROUP_SIZE, 200])
@pytest.mark.parametrize("share", [0.0, 0.4, 0.71, 1.0])
def test_groups_that_keep_their_shape(count: int, share: float, kept: bool) -> None:
    """The others' attributes are the same bits; theirs are as in the output, or in a group of both kinds canonical."""
    arrays, num_shape_dynamic = field_arrays(SHAPE, 20, 5, count, sh_count=4), int(share * count)
    whole, found = output_arrays(SHAPE, count), output_arrays(SHAPE, count)
    PlaybackField(SHAPE, in_groups(SHAPE, arrays, kept), kept).deform({}, whole)
    PlaybackField(SHAPE, in_groups(SHAPE, arrays, kept), kept, num_shape_dynamic).deform({}, found)
    for name in ("means", "opacities", "sh"):
        np.testing.assert_array_equal(found[name], whole[name], err_msg=name)
    still, mixed = canonical_gaussians(arrays), -(-num_shape_dynamic // GROUP_SIZE) * GROUP_SIZE
    for name in ("quaternions", "scales"):
        np.testing.assert_array_equal(found[name][:num_shape_dynamic], whole[name][:num_shape_dynamic], err_msg=name)
        np.testing.assert_allclose(
            found[name][num_shape_dynamic:mixed], getattr(still, name)[num_shape_dynamic:mixed], rtol=1e-6
        )
        assert np.isnan(found[name][mixed:]).all(), name


@pytest.mark.parametrize("num_shape_dynamic", [0, 50, 120])
@pytest.mark.parametrize("model", [{}, {"deformed_sh": 0}, {"deformed_sh": 4}, {"fusion": "dual"}], ids=str)
def test_only_what_changes_differs_from_rest(model: dict, num_shape_dynamic: int) -> None:
    scene = spared(num_shape_dynamic=num_shape_dynamic, **model)
    whole = {name: array for name, array in scene.arrays.items() if name != "fades"}
    settings = {name: value for name, value in scene.header.model.items() if name != "reshaped"}
    all_change = ScenePlayer(SceneFile(replace(scene.header, model=settings), whole))
    playable, still = assert_same_bits(scene), canonical_gaussians(scene.arrays)
    assert playable.num_dynamic == 160 and ("scales" in playable.changing) == (num_shape_dynamic > 0)
    for time in TIMES:
        found, expected = playable.at(time), all_change.at(time)
        for name in ATTRIBUTES:
            deformed = num_shape_dynamic if name in ("quaternions", "scales") else 120
            values, other = getattr(found, name), getattr(expected, name)
            np.testing.assert_array_equal(values[:deformed], other[:deformed], err_msg=name)
            if name != "opacities":
                np.testing.assert_allclose(values[deformed:], getattr(still, name)[deformed:], rtol=1e-6, err_msg=name)
        assert np.abs(found.opacities[120:160] - still.opacities[120:160]).max() > 0.1


def test_parts_of_a_scene_keep_their_kinds() -> None:
    scene = spared()
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
    scene = reorder_for_playback(spared(fleeting=True))
    assert "lifetimes" in scene.arrays
    write_scene(tmp_path / "a.frog", scene, compact=compact)
    back, expected = read_scene(tmp_path / "a.frog"), as_packed(scene) if compact else scene
    assert back.header.model["reshaped"] == 50 and back.arrays.keys() == expected.arrays.keys()
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
    scene = spared(fleeting=True)
    found = reorder_for_playback(scene)
    for first, last in ((0, 50), (50, 120), (120, 160), (160, 200)):
        before, after = (sorted(map(tuple, each.arrays["means"][first:last])) for each in (scene, found))
        assert before == after
    brightest = [
        ScenePlayer(each).at(0.5).opacities[120:160][each.arrays["means"][120:160, 0].argsort()]
        for each in (scene, found)
    ]
    np.testing.assert_array_equal(*brightest)
