"""Room that is kept for a scene where the system sets it aside at once, and not elsewhere."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from frog_blender.engine.training.session.disk_reserve import DiskReserve

SIZE = 3 << 20


@pytest.mark.skipif(sys.platform != "linux", reason="room is set aside on Linux")
def test_room_is_kept_and_given_back_once(tmp_path: Path) -> None:
    reserve = DiskReserve(tmp_path / "x.frog", SIZE)
    assert reserve.size >= SIZE
    assert not list(tmp_path.iterdir())
    assert reserve.release() and not reserve.release() and not reserve.size


def unable(*_: Any) -> int:
    ctypes.set_errno(errno.EOPNOTSUPP)
    return -1


@pytest.mark.parametrize("system", ["linux", "darwin", "win32"])
def test_nothing_is_written_where_room_cannot_be_set_aside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, system: str
) -> None:
    """As on disks in a network, and on systems that know no such call."""
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: SimpleNamespace(fallocate=unable))
    monkeypatch.delattr(os, "posix_fallocate", raising=False)
    assert not DiskReserve(tmp_path / "x.frog", SIZE).release()
