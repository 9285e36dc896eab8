"""Runs operators as a window does, without a screen, and scripts in another Blender process."""

import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy


class InWindow:
    """What ``in_window`` gives.

    Attributes:
        started: every operator that went on in the window, with the steps that it takes.
        said: the kind and the sentence of its reports, which a script does not see of an operator that runs later.
    """

    def __init__(self) -> None:
        self.started: list[tuple[Any, Iterator[Any]]] = []
        self.said: list[tuple[str, str]] = []

    @property
    def operator(self) -> Any:
        """The last one."""
        return self.started[-1][0]

    def send(self, kind: str = "TIMER", value: str = "NOTHING", times: int = 1) -> set[str]:
        """Sends events to the last operator; what it gives to Blender for the last of them."""
        for _ in range(times):
            result: set[str] = self.operator.modal(bpy.context, SimpleNamespace(type=kind, value=value))
        return result

    def send_until(self, reached: Callable[[], bool] = lambda: False) -> set[str]:
        """Sends the timer's events until something is reached, or else until the operator ends."""
        deadline, result = time.monotonic() + 60, {"PASS_THROUGH"}
        while not reached() and (result := self.send()) == {"PASS_THROUGH"}:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return result


@contextmanager
def in_window(operator: type) -> Iterator[InWindow]:
    """Inside, an operator runs as if it was asked for in a window: a class that derives from it has its name."""
    noted = InWindow()

    class Windowed(operator):  # type: ignore[misc]
        bl_idname, bl_label, __doc__ = operator.bl_idname, operator.bl_label, operator.__doc__
        is_interactive = True  # as ``invoke`` sets it, which does more that needs a screen
        slice_seconds = at_once = 0.0

        @staticmethod
        def has_window(context: bpy.types.Context) -> bool:
            return context.window is not None

        def run(self, context: bpy.types.Context, steps: Iterator[Any], total: int, *, in_window: bool) -> set[str]:
            if in_window:
                noted.started.append((self, steps))
            return super().run(context, steps, total, in_window=in_window)

        def end(self, context: bpy.types.Context, kind: str, sentence: str, result: set[str]) -> set[str]:
            noted.said.append((kind, sentence))
            return super().end(context, kind, sentence, result)

    with in_place_of(operator, Windowed):
        yield noted


@contextmanager
def in_place_of(operator: type, windowed: type) -> Iterator[None]:
    """Inside, a class that derives from an operator's is what its name calls."""
    bpy.utils.unregister_class(operator)
    bpy.utils.register_class(windowed)
    try:
        yield
    finally:
        # Blender itself drops an operator of a window when it ends; a new file makes it do so here.
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        bpy.utils.unregister_class(windowed)
        bpy.utils.register_class(operator)


def viewport() -> dict[str, Any]:
    """A 3D viewport, as ``temp_override`` takes it."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    return {"window": window, "area": area, "region": region, "space_data": area.spaces.active}


def run_steps(steps: Iterator[float], noted: dict[str, Any], result: Path) -> None:
    """Has a window draw for the seconds that each step yields; writes what was noted in the end, and quits."""

    def run() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            pass
        except Exception:
            noted["errors"].append(traceback.format_exc())
        result.write_text(json.dumps(noted))
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(run, first_interval=1.5)


def another_blender(script: Path, *arguments: object) -> list[str]:
    """The command that runs a script in another process of the Blender, or the bpy module, that runs the tests."""
    words = [str(script), *(["--"] if bpy.app.binary_path else []), *map(str, arguments)]
    blender = [bpy.app.binary_path, "-b", "--factory-startup", "--python"] if bpy.app.binary_path else [sys.executable]
    return [*blender, *words]


def script(folder: Path, code: str) -> Path:
    """A file with a script."""
    (folder / "script.py").write_text(code)
    return folder / "script.py"


def said_by(command: list[str], folder: Path, **environment: str) -> str:
    """What another Blender says, which ends as Blender ends. Its user's files are in ``user`` in the folder."""
    own = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user"), "PYTHONPATH": ""} | environment
    result = subprocess.run(command, capture_output=True, text=True, timeout=400, env=own, cwd=folder)
    said = result.stdout + result.stderr
    assert result.returncode == 0 and "Traceback" not in said, said
    return said
