"""The scene file: what is written is read, nothing half-written is ever found, and nothing foreign is believed."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import odd_camera, scene_file
from support.system_faults import file_size_limit

from frog_blender.engine.errors import FrogError
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
        train_seconds=56.5,
        capture_path="/somewhere/with space/ü",
    )
    write_scene(tmp_path / "deep" / "er" / "x.frog", SceneFile(header, scene.arrays))
    found = read_scene(tmp_path / "deep" / "er" / "x.frog")
    assert found.arrays.keys() == scene.arrays.keys()
    for name, array in scene.arrays.items():
        assert found.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(found.arrays[name], array)
    for name, value in vars(header).items():
        if name != "cameras":
            assert getattr(found.header, name) == value, name
    for camera, expected in zip(found.header.cameras, header.cameras, strict=True):
        assert camera.to_json() == expected.to_json()
        np.testing.assert_array_equal(camera.world_to_camera, expected.world_to_camera)


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


def test_a_failed_write_leaves_the_old_file_and_nothing_else(path: Path) -> None:
    before = path.read_bytes()
    with file_size_limit(len(before) // 2):
        for name in ("x.frog", "new.frog"):
            with pytest.raises(FrogError, match="File too large"):
                write_scene(path.with_name(name), scene_file(seed=1))
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == ["x.frog"]


def test_bytes_reach_the_disk_before_the_name(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []

    def noting(call: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments: (order.append(call.__name__), call(*arguments))[1]

    for owner, call in ((os, os.fsync), (Path, Path.replace)):
        monkeypatch.setattr(owner, call.__name__, noting(call))
    write_scene(path, scene_file())
    assert order == ["fsync", "replace"]
