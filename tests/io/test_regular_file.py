"""What is no file that ends is refused in a sentence: nobody waits for somebody to write into a pipe."""

import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.builders import refused

from frog_blender.cli.main import main
from frog_blender.engine.capture.calibration.board_detection import read_board
from frog_blender.engine.capture.readers.calibrated_videos import read_qualisys
from frog_blender.engine.capture.readers.checks import read_json
from frog_blender.engine.capture.video import image_size, read_facts, read_image
from frog_blender.engine.editing.edits_file import load_edits
from frog_blender.engine.given_options import given_file
from frog_blender.engine.interchange.ply import read_splats
from frog_blender.engine.io.regular_file import read_text, regular_file
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.session.checkpoint import checkpoint_settings
from frog_blender.engine.training.session.output_paths import trained_from

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
READERS: list[Callable[[Path], Any]] = [
    *(read_splats, read_scene, checkpoint_settings),
    *(read_image, image_size, read_facts, read_json, read_qualisys),
]


@pytest.fixture(autouse=True)
def nobody_waits() -> Iterator[None]:
    """Ends a test that waits for a pipe, which nothing else would."""

    def late(*_: Any) -> None:
        raise TimeoutError("a reader waits for ever")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(params=["a pipe", "a folder", "a socket", "a device", "no file"])
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def path(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Something of that kind, by a short name."""
    monkeypatch.chdir(tmp_path)  # names of sockets must be short
    short = Path("x.ply")
    if kind == "a pipe":
        os.mkfifo(short)
    elif kind == "a folder":
        short.mkdir()
    elif kind == "a device":
        short.symlink_to("/dev/zero")
    elif kind == "a socket":
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(str(short))
            yield short
        return
    yield short


def test_every_reader_says_what_is_there(path: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands and panels do not wait either."""
    for reader in READERS:
        sentence = refused(".", reader, path)
        assert f"x.ply: found {kind}, expected" in sentence, reader
    assert trained_from(path) == ""
    is_missing = kind == "no file"
    assert main(["import", str(path)]) == (2 if is_missing else 1)
    assert ("no such file" if is_missing else kind) in capsys.readouterr().err


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "file/below"])
def test_names_that_no_file_can_have(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_bytes(b"")
    refused(r"could not be read|no file", regular_file, tmp_path / name, "a file")


def test_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "link").symlink_to("file")
    assert regular_file(tmp_path / "link", "a file") == tmp_path / "link"


def test_text_of_another_encoding_is_refused_where_the_file_is_ours(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes('masks = "caf\u00e9"'.encode("latin-1"))
    assert read_text(path, "a file", foreign=True) == 'masks = "caf\ufffd"'
    for read in (given_file, load_edits, read_board):
        refused(r"x\.toml: found text that is no UTF-8, expected ", read, path)
