import os
import shutil
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.builders import refused
from support.small_captures import write_video
from support.system_faults import file_size_limit

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture, Distortion, Shot
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.io.cache_folder import default_cache_folder
from frog_blender.engine.io.child_process import Stopped


def open_store(folder: Path, **options: Any) -> FrameStore:
    return FrameStore.open(open_capture(folder), cache_folder=folder.parent / "cache", **options)


def stores(folder: Path) -> list[str]:
    return sorted(entry.name for entry in (folder.parent / "cache").iterdir())


def test_every_shot_is_its_own_frame(n3dv: Path) -> None:
    write_video(n3dv / "cam01.mp4", 5, image=lambda f: np.full((48, 64, 3), (200 - 20 * f, 40, 40), np.uint8))
    capture, store = open_capture(n3dv), open_store(n3dv)
    assert len(store) == 15
    for index, shot in enumerate(capture.shots):
        image = store.image(index)
        assert (image.shape, image.dtype) == ((48, 64, 3), np.uint8)
        expected = 200 - 20 * shot.frame if shot.camera == 1 else 20 + 10 * shot.frame
        assert abs(int(image[24, 32, 0]) - expected) < 6  # red first
    with pytest.raises(ValueError, match="read-only"):
        store.image(0)[0, 0, 0] = 1


def test_a_store_is_reused_and_rebuilt_when_a_video_changes(n3dv: Path) -> None:
    calls: list[tuple[int, int]] = []
    open_store(n3dv, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(i, 15) for i in range(1, 16)]
    first = stores(n3dv)
    open_store(n3dv, progress=lambda done, total: pytest.fail("decoded again"))
    write_video(n3dv / "cam01.mp4", 5, image=lambda f: np.full((48, 64, 3), 250, np.uint8))
    os.utime(n3dv / "cam01.mp4", ns=(1, 1))
    store = open_store(n3dv)
    assert store.image(1).mean() > 240
    assert len(stores(n3dv)) == 1  # the outdated store is gone
    assert stores(n3dv) != first


def test_cancelling_leaves_nothing(n3dv: Path) -> None:
    asked = iter([False] * 7 + [True])
    with pytest.raises(Stopped):
        open_store(n3dv, cancelled=lambda: next(asked))
    assert stores(n3dv) == []


def test_without_zstandard_it_is_named(n3dv: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zstandard", None)
    refused("need zstandard", open_store, n3dv)
    assert stores(n3dv) == []


def test_a_store_that_another_process_finished_first_is_used(n3dv: Path) -> None:
    """It may be in use already."""
    others: list[int] = []

    def finish_another(done: int, total: int) -> None:
        if done == total:
            others.append((open_store(n3dv).folder / "image.tiles").stat().st_ino)

    store = open_store(n3dv, progress=finish_another)
    assert [(store.folder / "image.tiles").stat().st_ino] == others
    assert stores(n3dv) == [store.folder.name]


def test_a_full_disk_is_noticed_before_decoding(n3dv: Path) -> None:
    capture, cache = open_capture(n3dv), n3dv.parent / "cache"
    largest = tuple(replace(camera, width=8192, height=8192) for camera in capture.cameras)
    frames = -(-shutil.disk_usage(n3dv).total // (8192 * 8192 * 3))
    endless = replace(capture, cameras=largest, shots=capture.shots * frames)
    with pytest.raises(FrogError, match=r"need about [\d.]+ GB and 0\.27 GB that stay free, found [\d.]+ GB free"):
        FrameStore.open(endless, cache_folder=cache, progress=lambda done, total: pytest.fail("decoded"))
    assert stores(n3dv) == []


@pytest.mark.parametrize("decoded", [0, 7])
def test_a_disk_that_fills_up_meanwhile_is_one_sentence(n3dv: Path, decoded: int) -> None:
    with ExitStack() as limits:

        def fill(done: int, total: int) -> None:
            if done == decoded:
                limits.enter_context(file_size_limit(20))

        if not decoded:
            fill(0, 15)
        refused(r"cannot be written here \(File too large\)", open_store, n3dv, progress=fill)
    assert stores(n3dv) == []


def test_a_video_shorter_than_its_header_says_is_named(n3dv: Path) -> None:
    capture = open_capture(n3dv)
    write_video(n3dv / "cam03.mp4", 3)  # it shrinks after it was opened
    with pytest.raises(FrogError, match=r"cam03\.mp4: 3 frames could be decoded, expected 5"):
        FrameStore.open(capture, cache_folder=n3dv.parent / "cache")


def test_where_a_video_lacks_its_last_frame_the_one_before_stays(n3dv: Path, tmp_path: Path) -> None:
    """As edit lists make it, in videos too large for their frames to be counted beforehand."""
    capture = open_capture(n3dv)
    write_video(n3dv / "cam03.mp4", 4)  # of the five that were there when it was opened
    store = FrameStore.open(capture, cache_folder=tmp_path / "cache")
    camera = next(i for i, each in enumerate(capture.cameras) if each.name == "cam03")
    before, last = (store.image(i) for i, shot in enumerate(capture.shots) if shot.camera == camera and shot.frame > 2)
    np.testing.assert_array_equal(before, last)


def test_the_cache_folder_can_be_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "here"))
    assert default_cache_folder() == tmp_path / "here"
    monkeypatch.delenv("FROG_CACHE")
    assert default_cache_folder().name == "frog_blender"


def test_distortion_is_removed(tmp_path: Path) -> None:
    """A straight bright line seen through a strong lens is bent; the store makes it straight, at its place."""
    width, height = 320, 240
    intrinsics = np.array([[200.0, 0, 150], [0, 200, 125], [0, 0, 1]])
    coefficients = np.array([-0.3, 0.08, 0.002, -0.001, 0.0])
    line_y = 40.0
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixels, intrinsics, coefficients, P=intrinsics)[:, 0, 1].reshape(height, width)
    bent = np.repeat(255 * np.exp(-(((ideal - line_y) / 1.5) ** 2))[..., None], 3, axis=2).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), bent)
    bend = np.ptp([np.flatnonzero(bent[:, x, 0] > 128).mean() for x in (20, 100, 160, 300)])
    assert bend > 5
    camera = Camera("a", width, height, intrinsics, np.eye(4))
    capture = Capture(
        tmp_path, "transforms", (camera,), (Distortion(coefficients),), (Shot(0, 0, tmp_path / "a.png", 0),), 1
    )
    straight = FrameStore.open(capture, cache_folder=tmp_path / "cache").image(0)
    rows = [np.average(np.arange(240) + 0.5, weights=straight[:, x, 0]) for x in (20, 100, 160, 300)]
    np.testing.assert_allclose(rows, line_y, atol=0.2)
    half = FrameStore.open(capture.scaled(0.5), cache_folder=tmp_path / "cache").image(0)
    rows = [np.average(np.arange(120) + 0.5, weights=half[:, x, 0]) for x in (10, 50, 80, 150)]
    np.testing.assert_allclose(rows, line_y / 2, atol=0.4)


def test_frames_are_given_up_to_make_room(n3dv: Path) -> None:
    store = open_store(n3dv)
    image = store.image(3).copy()
    size = sum(file.stat().st_size for file in store.folder.iterdir())
    assert store.give_up() == size > 0
    assert stores(n3dv) == []
    assert store.give_up() == 0
    np.testing.assert_array_equal(open_store(n3dv).image(3), image)


def test_of_two_that_share_frames_neither_deletes_them(n3dv: Path) -> None:
    """Asking for the frames alone gives the shared lock away: it has to be taken again."""
    one, other = open_store(n3dv), open_store(n3dv)
    image = one.image(3).copy()
    assert [one.give_up(), other.give_up(), one.give_up()] == [0, 0, 0]
    assert len(stores(n3dv)) == 1
    np.testing.assert_array_equal(one.image(3), image)
    del one
    assert other.give_up() > 0 and stores(n3dv) == []
