"""Run in a Blender with a window by test_in_window.py: invokes operators as the window does, and writes what happened.

    blender --factory-startup --python window_script.py -- ROOT SCENE PLY CAPTURE RESULT.json

Each step runs from a timer, when Blender has drawn what the one before did.
"""

import sys
import traceback
from functools import partial
from itertools import repeat
from pathlib import Path

import bpy

ROOT, SCENE, PLY, CAPTURE, RESULT = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from support.blender_windows import run_steps, viewport  # noqa: E402

import frog_blender  # noqa: E402
from frog_blender.timeline import playback  # noqa: E402

frog_blender.register()
found = {"errors": [], "tabs": [], "operators": {}}


def invoke(name, **given):
    """What the operator returned when a window invoked it; a traceback in it is an error that is raised here."""
    group, word = name.split(".")
    with bpy.context.temp_override(**viewport()):
        return sorted(getattr(getattr(bpy.ops, group), word)("INVOKE_DEFAULT", **given))


def dropped(*paths):
    return {"directory": str(paths[0].parent) + "/", "files": [{"name": path.name} for path in paths]}


def drop_scene():
    found["operators"]["drop scene"] = invoke("import_scene.frog", filepath=str(SCENE), **dropped(SCENE))


def drop_ply():
    found["operators"]["drop ply"] = invoke("import_scene.frog_splats", filepath=str(PLY), **dropped(PLY))


def drop_videos():
    videos = sorted(CAPTURE.glob("*.mp4"))[:2]
    found["operators"]["drop videos"] = invoke("frog.drop_videos", **dropped(*videos))


def note_tab():
    area = viewport()["area"]
    sidebar = next(region for region in area.regions if region.type == "UI")
    found["tabs"].append(sidebar.active_panel_category if area.spaces.active.show_region_ui else "")


def close_sidebar():
    viewport()["space_data"].show_region_ui = False


def capture_from_the_menu():
    """Its context is that of the menu's bar, which is no area of the screen."""
    override = viewport()
    for key in ("area", "region"):
        override[key] = None
    with bpy.context.temp_override(**override):
        found["operators"]["menu"] = sorted(bpy.ops.import_scene.frog_capture("EXEC_DEFAULT", directory=str(CAPTURE)))


def open_scene():
    bpy.ops.import_scene.frog("EXEC_DEFAULT", filepath=str(SCENE))
    found["captures"] = len(list(playback.captures(bpy.data.objects)))


def all_operators():
    for group in ("frog", "import_scene", "export_scene"):
        for word in dir(getattr(bpy.ops, group)):
            if (group == "frog" or word.startswith("frog")) and f"{group}.{word}" not in LEFT_OUT:
                yield partial(one_operator, f"{group}.{word}")


# They download, train, and go on.
LEFT_OUT = ("frog.install_torch", "frog.train", "frog.select_by_hand")


def one_operator(name):
    group, word = name.split(".")
    with bpy.context.temp_override(**viewport()):
        can = getattr(getattr(bpy.ops, group), word).poll()
    try:
        found["operators"][name] = invoke(name) if can else ["not now"]
    except RuntimeError as error:
        if "Traceback" in str(error):
            raise
        found["operators"][name] = ["refused"]


def is_reading():
    """Whether an operator that was begun reads a capture beside the window."""
    operators = bpy.context.window_manager.windows[0].modal_operators
    return any(operator.bl_idname in ("FROG_OT_drop_videos", "IMPORT_SCENE_OT_frog_capture") for operator in operators)


def nothing():
    """Blender draws."""


def steps():
    yield from (drop_scene, drop_ply)
    for step in (drop_videos, capture_from_the_menu):
        yield close_sidebar
        yield step
        yield from repeat(nothing, 20)
        while is_reading():
            yield nothing
        yield note_tab
    yield open_scene
    yield from all_operators()


def taken():
    """Each step, whatever becomes of the others."""
    for step in steps():
        try:
            step()
        except Exception:
            found["errors"].append(traceback.format_exc())
        yield 0.05


run_steps(taken(), found, RESULT)
