"""The scene file: what is written is read, nothing half-written is ever found, and nothing foreign is believed."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import odd_camera, scene_file

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io import atomic_files
from frog_blender.engine.io.atomic_files import write_atomically
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
    rig = replace(header, camera_shots=((1,), (0,), (1,)))  # the first is withheld
    assert rig.is_moving
    assert not replace(rig, test_cameras=()).is_moving


def break_write(monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    if how == "write":
        real = os.fdopen

        def full(handle: int, mode: str) -> Any:
            file = real(handle, mode, buffering=0)

            class Full:
                def __enter__(self) -> Full:
                    return self

                def __exit__(self, *_: object) -> None:
                    file.close()

                def write(self, content: bytes) -> int:
                    file.write(content[: len(content) // 2])
                    raise OSError(28, "No space left on device")

            return Full()

        monkeypatch.setattr(atomic_files.os, "fdopen", full)
    elif how == "replace":
        monkeypatch.setattr(atomic_files.os, "replace", fail)
        monkeypatch.setattr(Path, "replace", fail)
    else:
        monkeypatch.setattr(atomic_files.os, how, fail)


@pytest.mark.parametrize("how", ["write", "fsync", "replace"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        break_write(patch, how)
        with pytest.raises(FrogError, match="No space left on device"):
            write_scene(path, scene_file(seed=1))
        with pytest.raises(FrogError, match="No space left on device"):
            write_scene(path.with_name("new.frog"), scene_file(seed=1))
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == ["x.frog"]
    write_scene(path, scene_file(seed=1))
    assert path.read_bytes() != before


def test_bytes_reach_the_disk_before_the_name(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order = []
    fsync, replace_ = os.fsync, Path.replace
    monkeypatch.setattr(atomic_files.os, "fsync", lambda handle: (order.append("fsync"), fsync(handle))[1])
    monkeypatch.setattr(Path, "replace", lambda self, to: (order.append("rename"), replace_(self, to))[1])
    write_scene(path, scene_file())
    assert order == ["fsync", "rename"]


def test_a_folder_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "x.frog").mkdir()
    with pytest.raises(FrogError):
        write_scene(tmp_path / "x.frog", scene_file())
    (tmp_path / "file").write_text("")
    with pytest.raises(FrogError):
        write_atomically(tmp_path / "file" / "x.frog", b"")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "x.frog"]
