"""Operators as a window runs them, without a screen; and scripts in a Blender of their own."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import bpy
import pytest


def started_in_window(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType, operator: type
) -> list[tuple[Any, Iterator[Any]]]:
    """From now on ``operator`` of ``module`` runs as if it was asked for in a window.

    Returns:
        a list that every operator that goes on in the window joins, with the steps that it takes.
    """
    monkeypatch.setattr(module, "has_window", lambda context: context.window is not None)
    monkeypatch.setattr(operator, "is_interactive", True, raising=False)  # of those that first show a file browser
    started: list[tuple[Any, Iterator[Any]]] = []
    go_on = operator.go_on_in_window

    def noted(self: Any, context: Any, steps: Iterator[Any], *rest: Any) -> Any:
        started.append((self, steps))
        return go_on(self, context, steps, *rest)

    monkeypatch.setattr(operator, "go_on_in_window", noted)
    return started


def drop_operators() -> None:
    """Blender itself drops an operator of a window when it ends; a new file makes it do so here."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def viewport() -> dict[str, Any]:
    """A 3D viewport, as ``temp_override`` takes it."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    return {"window": window, "area": area, "region": region, "space_data": area.spaces.active}


def event(kind: str = "TIMER", value: str = "NOTHING") -> SimpleNamespace:
    return SimpleNamespace(type=kind, value=value)


def another_blender(script: Path, *arguments: object) -> list[str]:
    """The command that runs a script in another process of the Blender, or the bpy module, that runs the tests."""
    words = [str(script), *(["--"] if bpy.app.binary_path else []), *map(str, arguments)]
    blender = [bpy.app.binary_path, "-b", "--factory-startup", "--python"] if bpy.app.binary_path else [sys.executable]
    return [*blender, *words]
