"""Paths that a file says: none may make Windows call another computer."""

import pytest

from frog_blender.engine.io.paths import is_network_path

OTHERS = [r"\\evil\share", "//evil/share/room", r"\/evil\share", "/\\evil", "///evil/share", r"\\.\pipe\name"]
OTHERS += [r"\\?\UNC\evil\share\room", "//?/UNC/evil/share", r"\??\UNC\evil\share", "/??/UNC/evil/share"]
OWN = ["", "room", "/home/a/room", r"C:\captures\room", "C:/captures//room", "room//cam", r"..\room", "/", "\\", "C:"]


@pytest.mark.parametrize("path", [*OTHERS, *OWN])
def test_another_computer_and_devices_are_known_however_the_strokes_lean(path: str) -> None:
    assert is_network_path(path) == (path in OTHERS)
