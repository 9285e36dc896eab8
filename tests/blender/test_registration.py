"""Enabling and disabling leaves nothing behind, and needs nothing heavy."""

import bpy
import pytest
from support.builders import refuses, run_python
from support.small_scenes import rig_of_three, write_scene
from support.training_panel import switched_off

from frog_blender.operators.bases import FrogOperator
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask


def footprint():
    """What a registered add-on could leave behind."""
    lists = [name for name in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, name), list)]
    handlers = {name: len(getattr(bpy.app.handlers, name)) for name in lists}
    types = {name for name in dir(bpy.types) if "frog" in name.lower()}
    owners = [hasattr(getattr(bpy.types, owner), "frog") for owner in ("Scene", "Object", "Camera")]
    stock = [panel for panel in bpy.types.Panel.__subclasses__() if not panel.__name__.startswith("FROG")]
    panels = sum("FROG" in getattr(panel, "COMPAT_ENGINES", ()) for panel in stock)
    return handlers, types, owners, panels


def test_twice_on_and_off_leaves_nothing(addon):
    with switched_off():
        clean = footprint()
        assert not any(clean[2]) and not clean[3]
        for _ in range(2):
            addon.register()
            assert footprint() != clean
            addon.unregister()
            assert footprint() == clean
            assert not bpy.app.timers.is_registered(background_task.tick) and TrainingTask.current() is None


def test_every_operator_that_does_not_apply_says_why(empty):
    silent = []
    for cls in below(FrogOperator):
        if not issubclass(cls, bpy.types.Operator):
            continue
        room, name = cls.bl_idname.split(".")
        operator = getattr(getattr(bpy.ops, room), name)
        if not operator.poll():
            said = refuses(".", operator)
            if not said.strip().endswith(".") or "context is incorrect" in said:
                silent.append(cls.bl_idname)
    assert not silent


def below(base):
    """All classes derived from one."""
    return [found for cls in base.__subclasses__() for found in (cls, *below(cls))]


def in_python(code, *arguments):
    """Run code in a fresh interpreter with the bpy module, or skip where Blender is not a module."""
    if bpy.app.binary_path:
        pytest.skip("a real Blender runs no second interpreter with bpy")
    return run_python(f"import sys\n{code}", *arguments)


def test_open_scrub_and_render_imports_nothing_heavy_and_leaves_the_environment_alone(tmp_path):
    path = write_scene(tmp_path / "figure.frog", rig_of_three())
    code = """
import os, bpy, frog_blender
before = dict(os.environ)
sys.modules["torch"] = None
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
frog_blender.register()
from frog_blender import point_cloud
print({name for name, _ in os.environ.items() ^ before.items()})
bpy.ops.import_scene.frog(filepath=sys.argv[1])
scene = bpy.context.scene
capture = next(child for child in bpy.context.object.children if child.type != "CAMERA")
scene.frame_set(1); first = point_cloud.read(capture)["position"]
scene.frame_set(6); moved = abs(point_cloud.read(capture)["position"] - first).max()
scene.render.filepath = sys.argv[2]
bpy.ops.render.render(write_still=True)
from frog_blender.ui.torch_environment import torch_needed
heavy = [name for name in ("cv2", "pycolmap", "matplotlib") if name in sys.modules]
print("moved", moved > 1e-3, "says", "Training needs torch" in torch_needed(), heavy)
frog_blender.unregister()  # the bpy 4.5 module never leaves while any script's handler is registered
"""
    result = in_python(code, path, tmp_path / "still.png")
    assert "moved True says True []" in result.stdout and "set()" in result.stdout, result.stdout + result.stderr
    assert (tmp_path / "still.png").stat().st_size > 1000
