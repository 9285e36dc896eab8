"""Scenes of splats that do not move, where a test says each splat."""

from pathlib import Path

from support.builders import blobs, still_scene
from support.small_scenes import rig_of_three

from frog_blender.engine.scene.scene_file import write_scene


def write_still(path: Path, means, scales, colors) -> Path:
    """A scene of splats at (N, 3) with scales (N, 3) or (3,) and display colours (N, 3)."""
    splats = blobs(means, scales, colors=colors, opacities=0.99)
    write_scene(path, still_scene(splats, rig_of_three(), 2, background=(0.0, 0.0, 0.0)))
    return path
