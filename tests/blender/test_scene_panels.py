"""The Scene and Render panels of the FRoG tab, and what Blender's own menus and status bar offer."""

import re
from types import SimpleNamespace

import bpy
from support.small_scenes import edit_everything, rig_of_three, write_scene
from support.training_panel import Written, panel_says, told

from frog_blender.engine.training.session import events
from frog_blender.scene_import.capture_objects import active_capture, root_of
from frog_blender.tasks.background_task import Ended
from frog_blender.tasks.training import TrainingTask
from frog_blender.timeline import playback
from frog_blender.ui import captures_panel, edit_panel, menus, render_panel, status_bar, timing_panel
from frog_blender.ui.captures_panel import FROG_UL_captures


def test_one_capture_is_a_handful_of_rows(empty, static_rig):
    assert panel_says(captures_panel.FROG_PT_captures) == "import_scene.frog"
    assert panel_says(render_panel.FROG_PT_render) is None
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    rows = panel_says(captures_panel.FROG_PT_captures)
    assert rows == "import_scene.frog filepath 60 Gaussians frog.align_to_floor frog.add_clips frog.hide_clips"
    panels = {
        timing_panel.FROG_PT_timing: "start_frame",
        timing_panel.FROG_PT_sound: "frog.add_sound_strip",
        captures_panel.FROG_PT_display: "density",
    }
    for kind, name in panels.items():
        assert name in panel_says(kind) and kind.bl_options == {"DEFAULT_CLOSED"}
    assert panel_says(render_panel.FROG_PT_render) == "engine frog.compose frog.render_film", "it was set up"


def test_several_captures_are_a_list_of_which_one_is_chosen(empty, static_rig, tmp_path):
    other = write_scene(tmp_path / "other.frog", rig_of_three(), count=40)
    for path in (static_rig, other):
        bpy.ops.import_scene.frog(filepath=str(path))
    captures = list(playback.captures(empty.objects))
    flags, _ = FROG_UL_captures.filter_items(SimpleNamespace(bitflag_filter_item=4), None, empty, "objects")
    assert [obj for obj, flag in zip(empty.objects, flags, strict=True) if flag] == captures
    for obj, count in ((captures[0], 60), (captures[1], 40)):
        empty.frog.capture_index = list(empty.objects).index(obj)
        assert bpy.context.object == root_of(obj) and active_capture(bpy.context) == obj
        assert empty.objects[empty.frog.capture_index] == obj
        rows = panel_says(captures_panel.FROG_PT_captures)
        assert "FROG_UL_captures" in rows and f"{count} Gaussians" in rows
        assert rows.count("filepath") == 1
    other.unlink()
    empty.frame_set(3)
    empty.frog.capture_index = list(empty.objects).index(captures[0])
    assert "found no file" in panel_says(captures_panel.FROG_PT_captures), "a problem is told whatever is chosen"


def test_edits_are_drawn_and_taken_back(empty, capture):
    edit_everything(capture)
    panels = edit_panel.FROG_PT_edit, edit_panel.FROG_PT_crop, edit_panel.FROG_PT_clean, edit_panel.FROG_PT_grade
    said = " ".join(map(panel_says, panels)).split()
    assert {"frog.save_edits", "feather", "frog.remove_crop", "frog.clean_up", "hidden", "frog.remove_grade"} <= set(
        said
    )
    settings = capture.frog_edits
    for operator in (bpy.ops.frog.remove_crop, bpy.ops.frog.remove_grade, bpy.ops.frog.reset_grade):
        assert operator() == {"FINISHED"}
    assert not len(settings.crops) and not len(settings.grades) and settings.grade.exposure == 0.0


def test_a_view_transform_is_told_and_taken_away(empty, capture):
    panel = render_panel.FROG_PT_render
    assert not bpy.ops.frog.show_as_filmed.poll()
    empty.view_settings.view_transform, empty.view_settings.look = "AgX", "AgX - Punchy"
    assert "AgX, AgX - Punchy changes the colours of the videos. frog.show_as_filmed" in panel_says(panel)
    assert bpy.ops.frog.show_as_filmed() == {"FINISHED"}
    assert (empty.view_settings.view_transform, empty.view_settings.look) == ("Standard", "None")
    assert "changes the colours" not in panel_says(panel)


def drawn(entry):
    layout = Written()
    entry(SimpleNamespace(layout=layout), bpy.context)
    return layout.said


def test_menus_have_what_the_search_is_to_find(empty, static_rig):
    draw = menus.FROG_MT_object.draw
    offered = set(drawn(draw))
    for name in ("train", "align_to_floor", "add_clips", "compose", "set_up_scene", "show_as_filmed"):
        assert f"frog.{name}" in offered
    for name in offered:
        group, word = name.split(".")
        assert getattr(getattr(bpy.ops, group), word).get_rna_type(), "an operator that there is"
    assert drawn(menus._context_menu) == []
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    assert drawn(menus._context_menu) == ["FROG_MT_object"]
    assert drawn(menus._add) == ["import_scene.frog", "import_scene.frog_capture"]
    for menu in ("VIEW3D_MT_object", "VIEW3D_MT_object_context_menu", "VIEW3D_MT_add", "TOPBAR_MT_render"):
        entries = [function.__module__ for function in getattr(bpy.types, menu)._dyn_ui_initialize()]
        assert menus.__name__ in entries


def test_the_status_bar_tells_of_a_training(empty, tmp_path):
    assert drawn(status_bar._draw) == []
    told(events.Stage("decoding frames", 3, 10))
    assert drawn(status_bar._draw) == ["Training: Decoding frames"]
    task = told(events.Progress(40, 100, 12.0, 125.0, 0.04, 320))
    assert drawn(status_bar._draw) == ["Training: about 2 minutes left"]
    assert "The training is not done yet." in " ".join(drawn(status_bar._draw_quitting))
    task.control.pause()
    assert drawn(status_bar._draw) == ["Training: paused"] and not bpy.ops.frog.dismiss_training.poll()
    ended = Ended("")
    told(events.Progress(9, 9, 9.0, 0.0, 0.1, 300), events.Finished(str(tmp_path / "x.frog"), 9, 1.0, 28.0, 5), ended)
    assert drawn(status_bar._draw) == ["x.frog is trained", "frog.dismiss_training"]
    told(Ended("It stopped."))
    assert "stopped with an error" in drawn(status_bar._draw)[0]
    assert bpy.ops.frog.dismiss_training() == {"FINISHED"} and TrainingTask.current() is None
    assert drawn(status_bar._draw) == []


def test_tooltips_are_lines_of_their_own(addon):
    """A docstring's line break would be one in the tooltip."""
    broken = []
    for group in ("frog", "import_scene", "export_scene"):
        for word in dir(getattr(bpy.ops, group)):
            if group == "frog" or word.startswith("frog"):
                kind = getattr(getattr(bpy.ops, group), word).get_rna_type()
                if re.search(r"\n|  ", kind.description):
                    broken.append(kind.identifier)
    assert broken == []
