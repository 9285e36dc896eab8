"""The scene file: what is written is read, nothing half-written is ever found, and nothing foreign is believed.

Whoever opens a file that is no scene, or a damaged one, says so in one sentence.
"""

import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import odd_camera, refused, scene_file

from frog_blender.engine.field.names import FUSIONS
from frog_blender.engine.playback.deformation import DeformationPlayer
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene import scene_file as scene_files
from frog_blender.engine.scene.scene_file import SceneFile, read_scene, write_scene


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_scene(tmp_path / "x.frog", scene_file())
    return tmp_path / "x.frog"


def test_round_trip(tmp_path: Path) -> None:
    scene = scene_file(deformed_sh=4, head_width=16)
    header = replace(
        scene.header,
        test_frames=(2, 5),
        pixel_offsets={"odd": (8.0, -0.5)},
        metrics={"psnr": 31.25, "split": "held-out"},
        steps=1234,
        capture_path="/somewhere/with space/ü",
    )
    write_scene(tmp_path / "deep" / "er" / "x.frog", SceneFile(header, scene.arrays))
    actual = read_scene(tmp_path / "deep" / "er" / "x.frog")
    assert actual.arrays.keys() == scene.arrays.keys()
    for name, array in scene.arrays.items():
        assert actual.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(actual.arrays[name], array)
    assert actual.header.to_json() == header.to_json()


def test_arrays_in_another_memory_order_are_written_right(tmp_path: Path) -> None:
    scene = scene_file()
    scene.arrays["means"] = np.asfortranarray(scene.arrays["means"])
    scene.arrays["sh"] = scene.arrays["sh"][::-1]
    write_scene(tmp_path / "x.frog", scene)
    for name in ("means", "sh"):
        np.testing.assert_array_equal(read_scene(tmp_path / "x.frog").arrays[name], scene.arrays[name])


def test_a_moving_camera_is_known_by_its_shots() -> None:
    header = scene_file().header
    assert not header.is_moving
    assert replace(header, camera_shots=((0,), (1,), (2,))).is_moving
    assert not replace(header, cameras=(odd_camera(),), camera_shots=((0,),)).is_moving
    rig = replace(header, camera_shots=((1,), (0,), (1,)))  # the first is held out
    assert rig.is_moving
    assert not replace(rig, test_cameras=()).is_moving


def test_bytes_reach_the_disk_before_the_name(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []

    def noting(call: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments: (order.append(call.__name__), call(*arguments))[1]

    for owner, call in ((os, os.fsync), (Path, Path.replace)):
        monkeypatch.setattr(owner, call.__name__, noting(call))
    write_scene(path, scene_file())
    assert order == ["fsync", "replace"]


def not_played(path: Path, match: str = ".") -> None:
    assert len(refused(match, lambda: ScenePlayer.load(path).at(0.3))) < 600


def test_foreign_files(path: Path) -> None:
    not_played(path.with_name("none.frog"), "no file")
    not_played(path.parent, "a folder")
    for content in (
        b"\x89PNG\r\n\x1a\n" + bytes(200),
        b"ply\nformat binary_little_endian 1.0\nend_header\n",
        b"\x80\x04\x95\x10\x00\x00\x00",
        struct.pack("<Q", 2**63) + b"{}",
        struct.pack("<Q", 2) + b"[]",
        np.random.default_rng(0).bytes(5000),
    ):
        path.write_bytes(content)
        not_played(path, str(path))


def test_a_safetensors_file_without_a_header(path: Path) -> None:
    arrays = read_scene(path).arrays
    for metadata in (None, {}, {"other": "{}"}, {"frog": "{"}, {"frog": "[]"}, {"frog": "null"}, {"frog": ""}):
        path.write_bytes(scene_files.serialize(arrays, metadata=metadata))
        not_played(path)


WRONG = {"means": [(40, 2), (), (0, 3)], "quaternions": [(40, 3)], "opacity_logits": [(40, 1)], "embeddings": [(41, 8)]}
WRONG["sh"] = [(40, 5, 3), ()]


@pytest.mark.parametrize(("name", "shape"), [(name, shape) for name, shapes in WRONG.items() for shape in shapes])
def test_arrays_of_the_wrong_shape(path: Path, name: str, shape: tuple[int, ...]) -> None:
    """Shapes are checked when a scene is opened: the native library only sees addresses."""
    scene = read_scene(path)
    scene.arrays[name] = np.ones(shape, np.float32)
    write_scene(path, scene)
    not_played(path)


def test_a_missing_array(path: Path) -> None:
    whole = read_scene(path)
    for name in whole.arrays:
        arrays = {other: array for other, array in whole.arrays.items() if other != name}
        write_scene(path, replace(whole, arrays=arrays))
        not_played(path)


@pytest.mark.parametrize("form", FUSIONS)
@pytest.mark.parametrize("head_width", [0, 5])
def test_every_array_must_have_its_shape(form: str, head_width: int) -> None:
    """The library would read beyond an array that is too small."""
    scene = scene_file(7, fusion=form, head_width=head_width)
    DeformationPlayer(scene.arrays, scene.header.model)
    for name in scene.arrays.keys() - {"sh"}:
        whole = scene.arrays[name]
        # Fewer embeddings than Gaussians are legal: some are static.
        other_length = np.concatenate([whole, whole[:1]]) if name == "embeddings" else whole[:-1]
        without = {k: v for k, v in scene.arrays.items() if k != name}
        for other in ({name: other_length}, {name: whole[..., None]}, {name: whole[:0]}, {}):
            refused("deformation network", DeformationPlayer, without | other, scene.header.model)


def test_settings_that_do_not_fit_are_one_sentence() -> None:
    scene = scene_file(7)
    wrong = [{"fusion": "dual"}, {"fusion": "concat"}, {"fusion": "attention"}, {"fusion": "none"}, {"fusion": None}]
    wrong += [{"fine_rows": 7}, {"fine_rows": -1}, {"coarse_rows": 0}, {"motion_unit": []}, {"deformed_sh": 5}]
    wrong += [{"opacity_reduction": "some"}, {"hidden_width": -24}, {"head_width": 3}, {"embedding_size": "many"}]
    for change in wrong:
        refused("train it again", DeformationPlayer, scene.arrays, {**scene.header.model, **change})
