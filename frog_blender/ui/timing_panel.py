"""The panels Timing and Sound of the FRoG tab: when the chosen capture plays, how fast, and what is heard."""

from typing import Any

import bpy

from ..engine.errors import FrogError
from ..scene_import import capture_sound
from ..timeline import playback, retiming
from .captures_panel import OfMoving, chosen_capture
from .sidebar_panel import split, wrapped_label

_SAME_SPEED = 0.005  # of the speed: nobody sees less
_OPERATORS = {"play_in_real_time": "Real Time", "fit_frame_range": "Fit Frame Range", "timing_to_curve": "Curve"}


class FROG_PT_timing(OfMoving, bpy.types.Panel):
    """When the chosen capture plays, and how fast."""

    bl_label = "Timing"

    def draw(self, context: bpy.types.Context) -> None:
        chosen = chosen_capture(context)
        layout, settings = split(self.layout), chosen.frog
        layout.prop(settings, "use_remap")
        names = ("shown_frame",) if settings.use_remap else ("start_frame", "speed", "repeat")
        for name in names:
            layout.prop(settings, name)
        if not settings.use_remap:
            _draw_pair(layout, settings, "use_trim", ("first_frame", "last_frame"))
        _draw_pair(layout, settings, "use_range", ("range_start", "range_end"))
        wrapped_label(layout, _told_of_frames(chosen, context.scene), icon="INFO")
        row = layout.row(align=True)
        for name, text in _OPERATORS.items():
            row.operator(f"frog.{name}", text=text)


class FROG_PT_sound(OfMoving, bpy.types.Panel):
    """The sound of the chosen capture, and whether it is still in time."""

    bl_label = "Sound"

    def draw(self, context: bpy.types.Context) -> None:
        layout, chosen = self.layout, chosen_capture(context)
        layout.operator("frog.add_sound_strip", text="Strip", icon="SEQ_SEQUENCER")
        if capture_sound.sound_of(chosen) is None:
            return
        try:
            is_outdated = capture_sound.is_outdated(chosen, context.scene)
        except FrogError:  # shown by the Scene panel
            return
        if is_outdated:
            wrapped_label(layout, "The timing has changed since the sound was made.", icon="ERROR")
        elif is_outdated is None:
            sentence = "The time is driven, in the NLA or modified: update the sound when that has changed."
            wrapped_label(layout, sentence, icon="INFO")
        layout.operator("frog.update_sound", icon="FILE_REFRESH")


def _draw_pair(layout: bpy.types.UILayout, settings: Any, use: str, names: tuple[str, str]) -> None:
    """A switch, and the two settings that it is about where it is on: off, they hold numbers that say nothing."""
    row = layout.row(heading=settings.bl_rna.properties[use].name, align=True)
    row.prop(settings, use, text="")
    for name in names if getattr(settings, use) else ():
        row.prop(settings, name, text="")


def _told_of_frames(obj: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """When a capture plays, if that is not the scene's range of frames, and how fast, if not as it was filmed."""
    header = playback.open_scene(playback.file_of(obj)).header
    frames, said = retiming.playing_frames(obj, scene, header.frame_count), []
    if frames is not None and (round(frames[0]), round(frames[1])) != (scene.frame_start, scene.frame_end):
        said.append(f"Plays in frames {frames[0]:,.0f} to {frames[1]:,.0f}.")
        said.append(f"The scene has {scene.frame_start:,} to {scene.frame_end:,}.")
    ratio = obj.frog.speed / max(retiming.real_time_speed(scene, header.frames_per_second), 1e-9)
    if abs(ratio - 1) > _SAME_SPEED and not obj.frog.use_remap:
        pace = f"{abs(ratio):.2g} times as fast as it was filmed" if abs(abs(ratio) - 1) > _SAME_SPEED else ""
        words = ("Plays backwards" if ratio < 0 else "", pace if ratio else "Stands still")
        sentence = ", ".join(filter(None, words))
        said.append(f"{sentence[:1].upper()}{sentence[1:]}.")
    return " ".join(said)
