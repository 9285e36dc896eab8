"""Decoded frames on disk: their limit, what is deleted first, what stays, and frames that were damaged."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import REPOSITORY, refused
from support.small_captures import write_video

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.decoding import decode_shots
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.frames import limit, store
from frog_blender.engine.frames.image_coding import halved_image
from frog_blender.engine.frames.limit import clear, limit_of, make_room, set_limit, stored_frames
from frog_blender.engine.frames.store import FrameStore


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("FROG_CACHE_LIMIT", raising=False)
    return tmp_path / "cache"


def noisy(size: tuple[int, int]) -> Callable[[int], np.ndarray]:
    return lambda frame: np.random.default_rng(frame).integers(0, 256, (*size, 3)).astype(np.uint8)


def films(n3dv: Path, size: tuple[int, int]) -> Path:
    """Three cameras, of five images of noise each."""
    height, width = size
    for name in ("cam00", "cam01", "cam03"):
        write_video(n3dv / f"{name}.mp4", 5, width, height, noisy(size))
    return n3dv


def decoded(capture: Capture) -> int:
    """How many images opening the store decodes."""
    done: list[int] = []
    FrameStore.open(capture, progress=lambda count, _: done.append(count))
    return len(done)


def aged(store: FrameStore, days: float) -> Path:
    used = (store.folder / "index.json").stat().st_mtime - 86400 * days
    os.utime(store.folder / "index.json", (used, used))
    return store.folder


@pytest.mark.parametrize(("scale", "is_large"), [(0.2, True), (1.0, True), (3.02, True), (3.02, False)])
def test_the_bits_are_those_that_were_decoded(
    n3dv: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, scale: float, is_large: bool
) -> None:
    """Whole, halved and in part, of small and large images, of even and odd sizes, kept or not."""
    if is_large:
        monkeypatch.setattr(store, "_memory_for_images", lambda: 0)
    capture = open_capture(films(n3dv, (48, 64))).scaled(scale)
    frames, order = FrameStore.open(capture), capture.decoding_order
    random = np.random.default_rng(0)
    assert frames.is_large == is_large
    for index, truth in zip(order, decode_shots(capture, order), strict=True):
        height, width = truth.shape[:2]
        half = (0, 0, width // 2, height // 2)
        for ahead in (False, True, False):
            left, top = int(random.integers(width)), int(random.integers(height))
            region = (left, top, int(random.integers(1, width - left + 1)), int(random.integers(1, height - top + 1)))
            if ahead:
                frames.prefetch((index + 1) % len(order), region)  # guessed wrong
                frames.prefetch(index, region)
            part = frames.part(index, region)
            np.testing.assert_array_equal(part, truth[top : top + region[3], left : left + region[2]])
            np.testing.assert_array_equal(frames.part(index, half, is_half=True), halved_image(truth))
        np.testing.assert_array_equal(frames.image(index), truth)


@pytest.mark.parametrize("is_half", [True, False])
def test_a_damaged_block_is_decoded_anew(
    n3dv: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, is_half: bool
) -> None:
    monkeypatch.setattr(store, "_memory_for_images", lambda: 0)
    capture = open_capture(films(n3dv, (96, 128)))
    truth = [FrameStore.open(capture).image(index).copy() for index in range(15)]
    path = FrameStore.open(capture).folder / "image.tiles"
    content, random = path.read_bytes(), np.random.default_rng(1)
    for position in random.integers(0, len(content), 6).tolist():
        damaged = bytearray(content)
        damaged[position] ^= 1 << int(random.integers(8))
        path.write_bytes(damaged)
        frames = FrameStore.open(capture)
        for index in range(15):
            expected, size = (halved_image(truth[index]), (64, 48)) if is_half else (truth[index], (128, 96))
            np.testing.assert_array_equal(frames.part(index, (0, 0, *size), is_half), expected)
        assert (frames.folder / "damaged").exists()
        del frames
        assert decoded(capture) == 15 and path.read_bytes() == content  # written again


@pytest.mark.parametrize("damage", ["image.tiles", "image.sizes", "index.json"])
def test_what_is_cut_off_or_altered_is_decoded_again(n3dv: Path, cache: Path, damage: str) -> None:
    capture = open_capture(films(n3dv, (96, 128)))
    folder = FrameStore.open(capture).folder
    content = (folder / damage).read_bytes()
    for changed in (content[:-1], content + b"0", b"", content[:10] + bytes([content[10] ^ 1]) + content[11:]):
        if damage == "image.tiles" and len(changed) == len(content):
            continue  # its checksums are checked when it is read
        (folder / damage).write_bytes(changed)
        assert decoded(capture) == 15 and (folder / damage).read_bytes() == content


def test_frames_of_an_earlier_coding_are_decoded_anew(n3dv: Path, cache: Path) -> None:
    capture = open_capture(films(n3dv, (96, 128)))
    folder = FrameStore.open(capture).folder
    index = json.loads((folder / "index.json").read_text())
    index |= {"format": 6, "files": {"halves": index["files"]["image"], "details": index["files"]["image"]}}
    (folder / "index.json").write_text(json.dumps(index))
    for kind in ("tiles", "sizes"):
        (folder / f"halves.{kind}").write_bytes((folder / f"image.{kind}").read_bytes())
        (folder / f"image.{kind}").rename(folder / f"details.{kind}")
    assert decoded(capture) == 15 and sorted(path.name for path in folder.iterdir())[0] == "image.sizes"
    assert decoded(capture) == 0 and not list(folder.glob("details.*"))


def test_what_was_used_longest_ago_is_deleted_first_and_never_what_is_open(n3dv: Path, cache: Path) -> None:
    captures = [open_capture(films(n3dv, (96, 128))).scaled(scale) for scale in (1.0, 0.9, 0.8)]
    oldest, older, young = map(aged, map(FrameStore.open, captures), (3, 2, 1))
    assert [entry.folder for entry in stored_frames(cache)] == [oldest, older, young]
    store = FrameStore.open(captures[0])
    aged(store, 9)  # open, however old it is
    total = sum(entry.size for entry in stored_frames(cache))
    set_limit(cache, f"{total - 1}B")
    make_room(cache)
    assert [entry.folder for entry in stored_frames(cache)] == [oldest, young]
    set_limit(cache, "1KB")
    make_room(cache)
    assert [entry.folder for entry in stored_frames(cache)] == [oldest]
    np.testing.assert_array_equal(store.image(2), FrameStore.open(captures[0]).image(2))


def test_frames_larger_than_the_limit_are_refused_in_a_sentence(
    n3dv: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = open_capture(films(n3dv, (96, 128)))
    monkeypatch.setenv("FROG_CACHE_LIMIT", "10 KB")
    expected = r"need about 0.00 GB, found a limit of 0.00 GB \(10KB by FROG_CACHE_LIMIT\): .* frog cache --limit"
    refused(expected, FrameStore.open, capture, progress=lambda done, total: pytest.fail("decoded"))
    assert list(cache.iterdir()) == []


def test_a_limit_is_a_size_or_a_share(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    total = limit.shutil.disk_usage(cache.parent).total
    assert limit_of(cache) == (int(0.25 * total), "25% of the disk")
    for text, size in (("40 gb", 40_000_000_000), ("1.5TB", 1_500_000_000_000), ("10%", int(0.1 * total))):
        set_limit(cache, text)
        assert limit_of(cache)[0] == size
    monkeypatch.setenv("FROG_CACHE_LIMIT", "5MB")
    assert limit_of(cache) == (5_000_000, "5MB by FROG_CACHE_LIMIT")
    monkeypatch.delenv("FROG_CACHE_LIMIT")
    set_limit(cache, "default")
    assert limit_of(cache)[0] == int(0.25 * total)
    for wrong in ("", "much", "-1GB", "0%", "101%", "1e9", "nan"):
        refused("a size such as 40GB or a share", set_limit, cache, wrong)
    (cache / "limit.txt").write_text("huge")
    refused(r"limit\.txt: found 'huge'", limit_of, cache)


def put(folder: Path, **files: str) -> Path:
    """A folder with files of these names (``__`` for a full stop) and contents."""
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name.replace("__", ".")).write_text(content)
    return folder


def test_only_what_says_that_it_is_decoded_frames_is_counted_or_deleted(n3dv: Path, cache: Path) -> None:
    """Whatever else lies in a folder that is shared: names as of stores, an index of others, files beside a store's."""
    capture, index = open_capture(films(n3dv, (96, 128))), '{"format": 5, "sources": {}, "capture": "/x"}'
    others = [
        put(cache / "captures", index__json=index),
        put(cache / ("1" * 32), model__bin="three weeks of work"),
        put(cache / ("2" * 32), index__json='{"format": 5}', model__tiles=""),
        put(cache / ("3" * 32), index__json=index, model__bin="three weeks of work"),
        put(cache / ("4" * 32) / "artifacts", model__bin="three weeks of work").parent,
        put(cache / f"{'5' * 32}.partial-x", notes__txt="three weeks of work"),
        put(cache / ("6" * 32) / "halves.tiles", model__bin="three weeks of work").parent,
    ]
    (others[4] / "index.json").write_text(index)
    (others[6] / "index.json").write_text(index)
    kept = {path: path.read_bytes() for path in cache.rglob("*") if path.is_file()}
    old = put(cache / ("0" * 32), index__json=index, halves__tiles="")
    link = cache / ("7" * 32)
    link.symlink_to(put(cache.parent / "elsewhere", index__json=index))
    current = FrameStore.open(capture).folder
    assert not old.exists() and [entry.folder for entry in stored_frames(cache)] == [current]
    set_limit(cache, "1KB")
    make_room(cache)
    assert clear(cache) == (0, 0) and not current.exists() and (link / "index.json").is_file()
    current.mkdir()
    (current / "model.bin").write_text("three weeks of work")
    set_limit(cache, "default")
    refused(f"{current.name}: found files of others, .* move them elsewhere", FrameStore.open, capture)
    assert {path: path.read_bytes() for path in kept} == kept and (current / "model.bin").is_file()


KILLED = """
import os, sys
from pathlib import Path
from frog_blender.engine.frames.limit import clear
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.capture.readers import open_capture
def progress(done, total):
    if done == 7:
        print(clear(Path(sys.argv[2])))  # nothing that is being written
        sys.stdout.flush()
        os.kill(os.getpid(), 9)
FrameStore.open(open_capture(Path(sys.argv[1])), progress=progress)
"""


@pytest.mark.parametrize("is_cleared", [True, False])
def test_what_a_killed_decoding_left_is_counted_and_goes(n3dv: Path, cache: Path, is_cleared: bool) -> None:
    """When it is asked for, or when the same is decoded again: it is not taken for whole."""
    command = [sys.executable, "-c", KILLED, str(films(n3dv, (96, 128))), str(cache)]
    ended = subprocess.run(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    assert ended.returncode == -9 and ended.stdout == "(0, 1)\n"
    (left,) = stored_frames(cache)
    assert ".partial-" in left.folder.name and left.size == sum(file.stat().st_size for file in left.folder.iterdir())
    assert clear(cache) == (left.size, 0) if is_cleared else decoded(open_capture(n3dv)) == 15
    assert not left.folder.exists()


HOLDING = """
import sys
from pathlib import Path
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.capture.readers import open_capture
store = FrameStore.open(open_capture(Path(sys.argv[1])))
print("open", flush=True)
sys.stdin.read()
print(int(store.image(3).sum()))
"""


def test_clearing_leaves_what_another_process_has_open(n3dv: Path, cache: Path) -> None:
    capture = open_capture(films(n3dv, (96, 128)))
    other = FrameStore.open(capture.scaled(0.9)).folder
    command: list[Any] = [sys.executable, "-c", HOLDING, str(n3dv)]
    with subprocess.Popen(command, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "open\n"
        freed, kept = clear(cache)
        assert freed > 0 and kept == 1 and not other.exists()
        assert FrameStore.open(capture).give_up() == 0
        total = int(FrameStore.open(capture).image(3).sum())
        assert holder.communicate()[0] == f"{total}\n"
    assert clear(cache)[1] == 0 and stored_frames(cache) == []
