"""A small capture to decode."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.small_captures import write_n3dv


@pytest.fixture
def n3dv(tmp_path: Path) -> Path:
    return write_n3dv(tmp_path / "n3dv")
