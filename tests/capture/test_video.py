"""Videos and images by names that programs beneath would misread, and files that the system does not hand out."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from support.small_captures import write_n3dv, write_video

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import read_facts, read_image
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore

pytestmark = pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="names that this system does not take")


def test_a_colon_names_no_protocol(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_n3dv(tmp_path / "take10:30")
    monkeypatch.chdir(tmp_path)
    capture = open_capture(Path("take10:30"))
    assert len(FrameStore.open(capture, cache_folder=tmp_path / "cache")) == 15


def test_a_name_that_is_not_utf8_is_one_sentence(tmp_path: Path) -> None:
    """OpenCV would take the whole program down."""
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    folder.mkdir()
    write_video(tmp_path / "a.mp4", 2).rename(folder / "a.mp4")
    with pytest.raises(FrogError, match=r"caf.*: found a name that is not UTF-8") as caught:
        read_facts(folder / "a.mp4")
    str(caught.value).encode()


def test_an_image_that_the_system_does_not_read_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.png").symlink_to("/proc/self/mem")  # nothing is mapped at its start
    with pytest.raises(FrogError, match=r"a\.png: found a file that cannot be read \(Input/output error\)"):
        read_image(tmp_path / "a.png")
