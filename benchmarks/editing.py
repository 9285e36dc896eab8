"""What selecting by hand and hiding take: each place of the mouse, the release of its button, Hide and Restore.

    python benchmarks/editing.py [--count 40000] [--repeats 15] [--json]        (with the bpy module)

A random scene, a third of which moves, with colours of degree 3. Milliseconds of the processor, which other programs
may share: the median and the least of so many.
"""

from __future__ import annotations

import argparse
import functools
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import bpy
import numpy as np
from support.blender_windows import viewport
from support.builders import scene_file

import frog_blender
from frog_blender import point_cloud
from frog_blender.engine.editing.edited_scene import edited
from frog_blender.engine.editing.gestures import GESTURES, Gesture
from frog_blender.engine.editing.grades import Grade
from frog_blender.engine.editing.marks import Marks
from frog_blender.engine.scene.scene_file import write_scene
from frog_blender.operators.bases import mark, scene_of
from frog_blender.operators.select_by_hand import seen_in
from frog_blender.timeline import playback
from frog_blender.timeline.edits import graded
from frog_blender.timeline.playback_cache import SceneTime

PATH = [(300.0, 300.0), (1200.0, 300.0), (900.0, 800.0)]


def milliseconds(work: Callable[[], object], repeats: int, before: Callable[[], object] = lambda: None) -> list[float]:
    """The processor's, the median and the least, of work that something else comes before."""
    found = []
    for _ in range(repeats):
        before()
        began = time.process_time()
        work()
        found.append(1000 * (time.process_time() - began))
    return [round(statistics.median(found), 2), round(min(found), 2)]


def of_places(drawn: Gesture, repeats: int) -> list[float]:
    """Of random places of a gesture."""
    places = iter(np.random.default_rng(1).uniform(0, 900, (repeats, 2)).tolist())
    return milliseconds(lambda: drawn.move(tuple(next(places))), repeats)


def show_selection(capture: bpy.types.Object, selection: Marks) -> None:
    """Makes a capture's points show what is selected, as a window does after a gesture."""
    shown = playback.scene_time(capture, bpy.context.scene.frame_current_final)
    scene, _ = edited(shown.scene, graded(None, Grade(exposure=1.0, only=selection)))
    part = SceneTime(scene, shown.time).part
    point_cloud.show(capture, scene, shown.time, part)


def measured(capture: bpy.types.Object, repeats: int) -> dict[str, list[float]]:
    """What each takes, by its name; the context's region is a viewport."""
    context, scene, settings = bpy.context, scene_of(capture), capture.frog_edits
    some = np.random.default_rng(0).random(scene.count) < 0.1
    path = [{"name": "", "loc": place, "time": 0.0} for place in PATH]

    def nothing_edited() -> None:
        mark(settings.hidden, scene, np.zeros(scene.count, bool))
        mark(settings.selection, scene, np.zeros(scene.count, bool))
        playback.refresh(context.scene)

    def some_selected() -> None:
        nothing_edited()
        mark(settings.selection, scene, some)

    def some_hidden() -> None:
        some_selected()
        bpy.ops.frog.hide_gaussians()

    found = {
        "a gesture begins": milliseconds(lambda: seen_in(context, capture, False), repeats),
        "the same, only visible": milliseconds(lambda: seen_in(context, capture, True), repeats),
    }
    screen = seen_in(context, capture, False).screen
    for kind in GESTURES:
        found[f"{kind.lower()}, a place"] = of_places(GESTURES[kind](screen, 60.0), repeats)

    def release() -> None:
        bpy.ops.frog.select_by_hand(path=path, radius=60)

    found["a whole gesture, released"] = milliseconds(release, repeats, nothing_edited)
    colored = functools.partial(show_selection, capture, Marks.of(scene, some))
    found["what it selected, colored"] = milliseconds(colored, repeats, nothing_edited)
    found["Hide"] = milliseconds(lambda: bpy.ops.frog.hide_gaussians(), repeats, some_selected)
    found["Restore"] = milliseconds(lambda: bpy.ops.frog.restore_gaussians(), repeats, some_hidden)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(prog="editing.py", description="What selecting by hand and hiding take.")
    parser.add_argument("--count", type=int, default=40_000)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    frog_blender.register()
    with tempfile.TemporaryDirectory() as folder:
        file = scene_file(options.count, moving=options.count // 3, sh_count=16)
        write_scene(Path(folder) / "scene.frog", file)
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        bpy.ops.import_scene.frog(filepath=str(Path(folder) / "scene.frog"), show_clips=False)
        capture = next(playback.captures(bpy.context.scene.objects))
        with bpy.context.temp_override(**viewport()):
            found = measured(capture, options.repeats)
    if options.json:
        print(json.dumps(found))
        return
    for name, (median, least) in found.items():
        print(f"{name:<28}{median:9.2f} ms{least:9.2f} ms")


if __name__ == "__main__":
    main()
