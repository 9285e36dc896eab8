"""Paths that a file says: none may make Windows call another computer."""

from __future__ import annotations

from itertools import product
from pathlib import PureWindowsPath

import pytest

from frog_blender.engine.io.paths import is_network_path

STROKES = ["\\", "/"]


@pytest.mark.parametrize("begin", ["".join(pair) for pair in product(STROKES, repeat=2)])
@pytest.mark.parametrize("middle", STROKES)
def test_another_computer_is_known_however_its_strokes_lean(begin: str, middle: str) -> None:
    for path in (f"{begin}evil{middle}share", f"{begin}evil{middle}share{middle}room", f"{begin}evil"):
        assert is_network_path(path)
    assert PureWindowsPath(f"{begin}evil{middle}share{middle}room").drive == r"\\evil\share"


@pytest.mark.parametrize(
    "path",
    [
        r"\\?\UNC\evil\share\room",
        "//?/UNC/evil/share",
        r"\\.\pipe\name",
        r"\\?\GLOBALROOT\Device\Mup\evil\share",
        r"\??\UNC\evil\share",
        "/??/UNC/evil/share",
        r"///evil/share",
    ],
)
def test_devices_and_the_long_ways_round(path: str) -> None:
    assert is_network_path(path)


@pytest.mark.parametrize(
    "path",
    ["", "room", "/home/a/room", r"C:\captures\room", "C:/captures//room", "room//cam", r"..\room", "/", "\\", "C:"],
)
def test_paths_of_this_computer(path: str) -> None:
    assert not is_network_path(path)
    drive = PureWindowsPath(path).drive
    assert drive in ("", "C:")
