"""Small true-to-format captures, written by the tests themselves."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.small_captures import llff_row, write_n3dv, write_video

__all__ = ["llff_row", "write_n3dv", "write_video"]


@pytest.fixture
def n3dv(tmp_path: Path) -> Path:
    return write_n3dv(tmp_path / "n3dv")
