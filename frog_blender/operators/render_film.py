"""Render Film: the animation into one film, where Blender's default is a folder of images."""

# mypy: disable-error-code="valid-type"

import os
from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ExportHelper

from ..capture_files import named_file
from ..engine.errors import FrogError, found_instead
from ..engine.io.atomic_files import check_writable
from ..render.rendered_view import region_of
from ..timeline import playback
from .bases import FrogOperator


class FROG_OT_render_film(FrogOperator, ExportHelper, bpy.types.Operator):
    """Render the scene's frame range into an .mp4 film, with its sound. Sets the scene's output to that film"""

    bl_label = "Render Film"

    filename_ext = ".mp4"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        if not playback.has_captures(context.scene):
            return "Import a capture first."
        return "Set a camera first." if context.scene.camera is None else ""

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.filepath = self.filepath or suggested_film(context.scene)
        return super().invoke(context, event)

    def act(self, context: bpy.types.Context) -> None:
        scene, path = context.scene, Path(os.path.abspath(bpy.path.abspath(self.filepath)))
        if os.path.isdir(path):  # false, not an error, for a name that is too long
            raise found_instead(path, "a folder", "the name of a film")
        if not path.parent.is_dir():
            raise FrogError(f"{path.parent}: found no such folder, expected one for the film.")
        check_writable(path)
        render = scene.render
        # Rounded as Blender does.
        whole = [side * render.resolution_percentage // 100 for side in (render.resolution_x, render.resolution_y)]
        width, height = region_of(render, *whole)[2:] if render.use_crop_to_border else whole
        if width % 2 or height % 2:
            raise FrogError(f"Renders have {width} x {height} pixels; films need even numbers of both.")
        set_output(scene, path)
        bpy.ops.render.render("EXEC_DEFAULT" if bpy.app.background else "INVOKE_DEFAULT", animation=True)


def suggested_film(scene: bpy.types.Scene) -> str:
    """A film beside the scene's first capture; "" for Blender's suggestion, which is beside the saved .blend."""
    return "" if bpy.data.filepath else str(named_file(playback.captures_in(scene)[0]).with_suffix(".mp4"))


def set_output(scene: bpy.types.Scene, path: Path) -> None:
    """H.264 in an .mp4, which every program plays, of good quality."""
    render, image = scene.render, scene.render.image_settings
    render.filepath = str(path).replace("{", "{{").replace("}", "}}")  # names in braces stand for others
    if hasattr(image, "media_type"):  # since 5.0
        image.media_type = "VIDEO"
    image.file_format, image.color_mode = "FFMPEG", "RGB"
    film = render.ffmpeg
    film.use_autosplit = film.use_lossless_output = False
    film.format, film.codec, film.constant_rate_factor = "MPEG4", "H264", "HIGH"
    film.audio_codec = "AAC" if _has_sound(scene) else "NONE"


def _has_sound(scene: bpy.types.Scene) -> bool:
    strips = scene.sequence_editor.strips_all if scene.sequence_editor is not None else ()
    return any(part.type in {"SPEAKER", "SOUND"} for part in (*scene.objects, *strips))
