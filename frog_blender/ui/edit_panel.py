"""The Edit panel of the FRoG tab: Crop, Clean and Grade of the chosen capture."""

from typing import Any

import bpy

from ..engine.errors import FrogError
from ..tasks.scene_work import SceneWork
from ..timeline import playback
from ..timeline.edits import GRADE, edits_of, marks_of
from .captures_panel import OfChosen, chosen_capture
from .selection_tools import BOX, BRUSH, LASSO
from .sidebar_panel import draw_progress, split, wrapped_label


class FROG_PT_edit(OfChosen, bpy.types.Panel):
    """What is edited of the chosen capture."""

    bl_label = "Edit"

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(chosen_capture(context).frog_edits, "use", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.layout, chosen_capture(context)
        row = layout.row(align=True)
        row.operator("frog.load_edits", icon="FILE_FOLDER")
        row.operator("frog.save_edits", icon="FILE_TICK")
        for sentence in _problems(obj):
            wrapped_label(layout, sentence, icon="ERROR")


class FROG_PT_crop(OfChosen, bpy.types.Panel):
    """The crops of the chosen capture."""

    bl_label = "Crop"
    bl_parent_id = "FROG_PT_edit"

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.layout, chosen_capture(context)
        row = layout.row(align=True)
        for shape, icon in (("BOX", "MESH_CUBE"), ("SPHERE", "MESH_UVSPHERE"), ("OBJECT", "MESH_MONKEY")):
            row.operator("frog.add_crop", text=shape.title(), icon=icon).shape = shape
        for index, crop in enumerate(obj.frog_edits.crops):
            box = split(layout.box())
            row = box.row(align=True)
            row.use_property_split = False
            row.prop(crop, "use", text="")
            row.prop(crop, "object", text="")
            row.operator("frog.remove_crop", text="", icon="X").index = index
            column = box.column()
            column.active = crop.use
            column.use_property_decorate = True
            column.row().prop(crop, "keep", expand=True)
            column.prop(crop, "feather")
            column.prop(crop, "use_time")
            if crop.use_time:
                column.prop(crop, "time")


class FROG_PT_clean(OfChosen, bpy.types.Panel):
    """Which Gaussians of the chosen capture are selected, and which are hidden."""

    bl_label = "Clean"
    bl_parent_id = "FROG_PT_edit"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, chosen_capture(context).frog_edits
        if (task := SceneWork.current()) is not None and task.is_running:
            draw_progress(layout, task)
            layout.operator("frog.cancel_edit", icon="CANCEL")
        else:
            row = layout.row(align=True)
            row.operator("frog.clean_up", icon="BRUSH_DATA")
            row.prop(settings, "clean_strength", text="")
        layout.operator_menu_enum("frog.select_gaussians", "by", text="Select", icon="RESTRICT_SELECT_OFF")
        row = layout.row(align=True)
        for tool, name in ((BRUSH, "Brush"), (LASSO, "Lasso"), (BOX, "Box")):
            row.operator("wm.tool_set_by_id", text=name).name = tool
        row = layout.row(align=True)
        for action in ("All", "None", "Invert"):
            row.operator("frog.select_gaussians_all", text=action).action = action.upper()
        row.operator("frog.grow_selection", text="", icon="ADD").shrink = False
        row.operator("frog.grow_selection", text="", icon="REMOVE").shrink = True
        layout.prop(settings, "grow_distance")
        row = layout.row(align=True)
        row.operator("frog.hide_gaussians", text="Hide", icon="HIDE_ON").unselected = False
        row.operator("frog.hide_gaussians", text="Hide Others").unselected = True
        row.operator("frog.restore_gaussians", text="Restore", icon="HIDE_OFF")
        selected, hidden = (_number(marks) for marks in (settings.selection, settings.hidden))
        layout.label(text=f"{selected:,} selected, {hidden:,} hidden")
        layout.prop(settings, "show_selection")


class FROG_PT_grade(OfChosen, bpy.types.Panel):
    """The colours, opacities and sizes of the chosen capture."""

    bl_label = "Grade"
    bl_parent_id = "FROG_PT_edit"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, chosen_capture(context).frog_edits
        _draw_grade(layout, settings.grade)
        for index, grade in enumerate(settings.grades):
            box = layout.box()
            row = box.row(align=True)
            row.prop(grade, "use", text=f"{_number(grade.only):,} Gaussians")
            row.operator("frog.remove_grade", text="", icon="X").index = index
            _draw_grade(box, grade)
        row = layout.row(align=True)
        row.operator("frog.add_grade", icon="ADD")
        row.operator("frog.reset_grade", icon="LOOP_BACK")


def _draw_grade(layout: bpy.types.UILayout, grade: Any) -> None:
    column = split(layout.column())
    column.use_property_decorate = True
    column.active = grade.use
    for name in (*GRADE, "gains", "offsets"):
        column.prop(grade, name)


def _number(settings: Any) -> int:
    marks = marks_of(settings)
    return marks.number() if marks is not None else 0


def _problems(obj: bpy.types.Object) -> list[str]:
    """Sentences about what of the edits does not crop, or does not fit the scene."""
    try:
        edits = edits_of(obj)
        return [] if edits is None else edits.fitted(playback.open_scene(playback.file_of(obj)))[1]
    except FrogError as error:
        return [str(error)]
