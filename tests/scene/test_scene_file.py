"""The scene file: what is written is read, nothing half-written is ever found, and nothing foreign is believed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import odd_camera, scene_file
from support.system_faults import file_size_limit

from frog_blender.engine.errors import FrogError
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
    rig = replace(header, camera_shots=((1,), (0,), (1,)))  # the first is held out
    assert rig.is_moving
    assert not replace(rig, test_cameras=()).is_moving


@contextmanager
def failing(owner: object, name: str) -> Iterator[None]:
    """A call of the system fails as on a full disk."""

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, fail)
        yield


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (lambda half: file_size_limit(half), "File too large"),
        (lambda _: failing(os, "fsync"), "No space left on device"),
        (lambda _: failing(Path, "replace"), "No space left on device"),
    ],
    ids=["write", "fsync", "replace"],
)
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    path: Path, fault: Callable[[int], AbstractContextManager[None]], reason: str
) -> None:
    before = path.read_bytes()
    with fault(len(before) // 2):
        with pytest.raises(FrogError, match=reason):
            write_scene(path, scene_file(seed=1))
        with pytest.raises(FrogError, match=reason):
            write_scene(path.with_name("new.frog"), scene_file(seed=1))
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == ["x.frog"]
    write_scene(path, scene_file(seed=1))
    assert path.read_bytes() != before


def test_bytes_reach_the_disk_before_the_name(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []

    def noting(call: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments: (order.append(call.__name__), call(*arguments))[1]

    for owner, call in ((os, os.fsync), (Path, Path.replace)):
        monkeypatch.setattr(owner, call.__name__, noting(call))
    write_scene(path, scene_file())
    assert order == ["fsync", "replace"]


def test_a_folder_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "x.frog").mkdir()
    with pytest.raises(FrogError):
        write_scene(tmp_path / "x.frog", scene_file())
    (tmp_path / "file").write_text("")
    with pytest.raises(FrogError):
        write_atomically(tmp_path / "file" / "x.frog", b"")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "x.frog"]
