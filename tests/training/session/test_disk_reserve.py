"""Space reserved for a scene where the system gives it at once, and not elsewhere."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path
from typing import BinaryIO

import pytest

from frog_blender.engine.training.session.fallback_save import DiskReserve, allocate

SIZE = 3 << 20


@pytest.mark.skipif(sys.platform != "linux", reason="space is reserved on Linux")
def test_space_is_reserved_and_released_once(tmp_path: Path) -> None:
    reserve = DiskReserve(tmp_path / "x.frog", SIZE)
    assert reserve.size >= SIZE
    assert not list(tmp_path.iterdir())
    assert reserve.release() and not reserve.release() and not reserve.size


@pytest.mark.parametrize("system", ["darwin", "win32"])
def test_systems_that_know_no_such_call_refuse(tmp_path: Path, system: str) -> None:
    with (tmp_path / "file").open("wb") as file, pytest.raises(OSError, match="at once"):
        allocate(file, SIZE, system)


def test_nothing_is_written_where_space_cannot_be_reserved(tmp_path: Path) -> None:
    """As on disks in a network, and on systems that know no such call."""
    asked: list[int] = []

    def unable(file: BinaryIO, size: int) -> None:
        asked.append(os.fstat(file.fileno()).st_size)
        raise OSError(errno.EOPNOTSUPP, "no space can be reserved at once")

    assert not DiskReserve(tmp_path / "x.frog", SIZE, unable).release()
    assert asked == [0] and not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a file that no space can be reserved for")
def test_a_file_without_blocks_is_refused_by_the_system() -> None:
    with open("/dev/full", "wb", buffering=0) as file, pytest.raises(OSError, match="at once"):
        allocate(file, SIZE)
