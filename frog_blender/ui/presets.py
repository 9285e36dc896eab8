"""Presets of training settings, managed by Blender like its own."""

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..engine.options import Door, options_at
from ..option_properties import property_name

SUBFOLDER = "frog_blender/training"
PRESET_SETTINGS = (*(property_name(option) for option in options_at(Door.PRESET)), "import_when_done")
"""Properties of ``Scene.frog`` that a preset stores: how to train, not what."""


class FROG_MT_training_presets(bpy.types.Menu):
    """The menu of training presets."""

    bl_label = "Training Presets"
    preset_subdir = SUBFOLDER
    preset_operator = "script.execute_preset"
    draw = bpy.types.Menu.draw_preset


class FROG_OT_training_preset_add(AddPresetBase, bpy.types.Operator):
    """Add a preset of the training settings, or remove the active one"""

    bl_idname = "frog.training_preset_add"
    bl_label = "Add Training Preset"
    preset_menu = "FROG_MT_training_presets"
    preset_subdir = SUBFOLDER
    preset_defines = ("settings = bpy.context.scene.frog",)
    preset_values = tuple(f"settings.{name}" for name in PRESET_SETTINGS)


class FROG_PT_training_presets(PresetPanel, bpy.types.Panel):
    """The preset popover in the panel's header."""

    bl_label = "Training Presets"
    preset_subdir = SUBFOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "frog.training_preset_add"

    def draw(self, context: bpy.types.Context) -> None:
        if bpy.utils.preset_paths(SUBFOLDER):
            super().draw(context)
            return
        # Before the first preset Blender would speak of missing paths.
        self.layout.label(text="No presets yet")
        self.layout.operator(self.preset_add_operator, text="Keep These Settings", icon="ADD")
