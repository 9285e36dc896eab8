"""Files that appear whole, under any legal name, with the permissions wanted; and paths that a file says."""

import os
import stat
from pathlib import Path

import pytest
from support.builders import refused, run_python
from support.system_faults import file_size_limit

from frog_blender.engine.errors import FrogError
from frog_blender.engine.io import atomic_files
from frog_blender.engine.io.atomic_files import atomic_file, write_atomically
from frog_blender.engine.io.paths import is_network_path

on_posix = pytest.mark.skipif(os.name != "posix", reason="permissions as POSIX has them")
LONG_NAMES = ["x" * (atomic_files.LONGEST_NAME - 5) + ".frog", "動" * 83 + ".frog", "Д" * 125 + ".frog"]


@pytest.mark.parametrize("name", LONG_NAMES, ids=["latin", "kanji", "cyrillic"])
def test_every_name_that_the_disk_takes_can_be_written(tmp_path: Path, name: str) -> None:
    write_atomically(tmp_path / name, b"whole")
    write_atomically(tmp_path / name, b"again")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {name: b"again"}


def test_a_name_that_the_disk_does_not_take_is_one_sentence(tmp_path: Path) -> None:
    refused("too long", write_atomically, tmp_path / ("x" * (atomic_files.LONGEST_NAME + 1)), b"whole")
    assert not list(tmp_path.iterdir())


def test_beginnings_of_long_names_differ(tmp_path: Path) -> None:
    assert atomic_files.beginning("x.frog") == "x.frog"
    alike = [atomic_files.beginning("動" * 80 + end) for end in ("a.frog", "b.frog", "b.frog.checkpoint")]
    assert len(set(alike)) == 3 and all(len(os.fsencode(name)) <= 100 for name in alike)
    undecodable = atomic_files.beginning(os.fsdecode(b"\xff" * 200))
    (tmp_path / undecodable).write_bytes(b"")


@on_posix
@pytest.mark.parametrize(("umask", "mode"), [(0o077, 0o600), (0o002, 0o664), (0o022, 0o644)])
def test_a_new_file_has_the_permissions_that_the_process_gives(tmp_path: Path, umask: int, mode: int) -> None:
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "x", b"")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == mode


@on_posix
@pytest.mark.parametrize("mode", [0o600, 0o664, 0o640, 0o444])
def test_a_file_that_is_overwritten_keeps_its_permissions(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")
    path.chmod(mode)
    write_atomically(path, b"new")
    assert (path.read_bytes(), stat.S_IMODE(path.stat().st_mode)) == (b"new", mode)


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, GeneratorExit, SystemExit])
def test_whatever_ends_a_write_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    (tmp_path / "x").write_bytes(b"old")
    with pytest.raises(error), atomic_file(tmp_path / "x") as file:
        file.write(b"half")
        raise error
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"x": b"old"}


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    code = """
import os, signal, sys
from pathlib import Path
from frog_blender.engine.io.atomic_files import atomic_file
with atomic_file(Path(sys.argv[1])) as file:
    file.write(b"half")
    os.kill(os.getpid(), signal.SIGTERM if os.name == "nt" else signal.SIGKILL)
"""
    for name in ("x.frog", LONG_NAMES[1]):
        assert run_python(code, tmp_path / name).returncode
        (left,) = tmp_path.iterdir()
        atomic_files.remove_partial_files(tmp_path / "y.frog")
        assert left.exists(), "another file's"
        atomic_files.remove_partial_files(tmp_path / name)
        assert not left.exists()


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"old")
    expected = r"x: could not be written \(File too large\); nothing was changed\."
    with file_size_limit(1000), pytest.raises(FrogError, match=expected):
        write_atomically(tmp_path / "x", bytes(1 << 20))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"x": b"old"}


OTHERS = [r"\\evil\share", "//evil/share/room", r"\/evil\share", "/\\evil", "///evil/share", r"\\.\pipe\name"]
OTHERS += [r"\\?\UNC\evil\share\room", "//?/UNC/evil/share", r"\??\UNC\evil\share", "/??/UNC/evil/share"]
OWN = ["", "room", "/home/a/room", r"C:\captures\room", "C:/captures//room", "room//cam", r"..\room", "/", "\\", "C:"]


@pytest.mark.parametrize("path", [*OTHERS, *OWN])
def test_another_computer_and_devices_are_known_however_the_strokes_lean(path: str) -> None:
    assert is_network_path(path) == (path in OTHERS)
