"""What is done with a ``.frog`` in Blender: imported, scrubbed, rendered. Needs the bpy module."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

import frog_blender
from frog_blender.engine.errors import printable
from fuzzing.of_scenes import Scenes
from fuzzing.worker import Kind

_KEPT = ("objects", "cameras", "collections", "meshes", "pointclouds", "worlds", "images", "materials", "node_groups")
_SIZE = (48, 32)  # pixels that are rendered

frog_blender.register()
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


class InBlender(Scenes):
    """Tracebacks of handlers, which Blender prints and goes on after, are raised as well."""

    def use(self) -> bool:
        with _complaints() as said:
            imported = _import_and_render(self.path, self.path.parent)
        assert "Traceback" not in said.getvalue(), said.getvalue()
        return imported


KINDS: dict[str, type[Kind]] = {"blender": InBlender}


def _import_and_render(path: Path, out: Path) -> bool:
    """False if the file was refused in a sentence and left nothing behind."""
    scene, before = bpy.context.scene, _blocks()
    try:
        bpy.ops.import_scene.frog(filepath=str(path))
    except RuntimeError as error:
        sentence = str(error).removeprefix("Error: ").strip()
        assert "Traceback" not in sentence and sentence == printable(sentence), sentence
        assert _blocks() == before, "nothing is left behind"
        return False
    try:
        scene.render.resolution_x, scene.render.resolution_y = _SIZE
        scene.render.resolution_percentage = 100
        for frame in (scene.frame_start, scene.frame_end):
            scene.frame_set(frame)
        if scene.camera is not None:
            scene.render.filepath = str(out / "x.png")
            bpy.ops.render.render(write_still=True)
    finally:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return True


def _blocks() -> list[int]:
    return [len(getattr(bpy.data, name)) for name in _KEPT]


@contextlib.contextmanager
def _complaints() -> Iterator[io.StringIO]:
    """What Python code says to standard error; what Blender itself says of renders and imports is not shown."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "wb") as nowhere, contextlib.redirect_stderr(io.StringIO()) as said:
        os.dup2(nowhere.fileno(), 1)
        try:
            yield said
        finally:
            os.dup2(kept, 1)
            os.close(kept)
