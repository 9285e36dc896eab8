"""Scenes of splats that do not move, where a test says each splat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.builders import scene_header
from support.small_scenes import MODEL, gaussian_arrays, rig_of_three

from frog_blender.engine.scene.scene_file import SceneFile, write_scene
from frog_blender.engine.spherical_harmonics import SH_DC


def write_still(path: Path, means, scales, colors, quaternion=(1.0, 0.0, 0.0, 0.0), opacity=0.99) -> Path:
    """A scene of splats at (N, 3) with scales (N, 3) or (3,) and display colours (N, 3)."""
    count = len(means)
    arrays = gaussian_arrays(np.random.default_rng(0), count, 1)
    arrays |= {name: np.zeros_like(arrays[name]) for name in ("network.output_weight", "network.output_bias")}
    arrays["means"] = np.asarray(means, np.float32)
    arrays["quaternions"] = np.tile(np.asarray(quaternion, np.float32), (count, 1))
    arrays["log_scales"] = np.log(np.broadcast_to(scales, (count, 3))).astype(np.float32)
    arrays["opacity_logits"] = np.full(count, np.log(opacity / (1 - opacity)), np.float32)
    arrays["sh"] = ((np.asarray(colors) - 0.5) / SH_DC).astype(np.float32)[:, None, :]
    header = scene_header(rig_of_three(), 2, model=MODEL, background=(0.0, 0.0, 0.0))
    write_scene(path, SceneFile(header, arrays))
    return path
