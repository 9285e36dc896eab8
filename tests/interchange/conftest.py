"""The scene that most of these tests give to other programs."""

from pathlib import Path

import pytest
from support.foreign_takes import partly_static

from frog_blender.engine.playback.player import ScenePlayer


@pytest.fixture
def scene(tmp_path: Path) -> ScenePlayer:
    return partly_static(tmp_path)
