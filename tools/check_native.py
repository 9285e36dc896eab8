"""Draws with the library of the installed package frog_blender_native: ``python tools/check_native.py``.

Needs numpy and safetensors. cibuildwheel runs it with every wheel that it builds.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import frog_blender_native
import numpy as np


def main() -> None:
    """Ends with a sentence where the image is not what it should be."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    path = frog_blender_native.library_path()
    os.environ["FROG_NATIVE_LIBRARY"] = str(path)  # not that of this checkout

    from frog_blender.engine.capture.camera import Camera
    from frog_blender.engine.gaussians import GaussianArrays
    from frog_blender.engine.native.binding import instruction_set
    from frog_blender.engine.playback.render import draw

    intrinsics = np.array([[40.0, 0.0, 32.0], [0.0, 40.0, 32.0], [0.0, 0.0, 1.0]])
    gaussian = GaussianArrays(
        means=np.array([[0.0, 0.0, 4.0]], np.float32),
        quaternions=np.array([[1.0, 0.0, 0.0, 0.0]], np.float32),
        scales=np.full((1, 3), 0.4, np.float32),
        opacities=np.array([0.9], np.float32),
        sh=np.full((1, 1, 3), 1.0, np.float32),
    )
    alpha = draw(gaussian, Camera("cam00", 64, 64, intrinsics, np.eye(4))).alpha
    row, column = np.unravel_index(np.argmax(alpha), alpha.shape)
    if {int(row), int(column)} - {31, 32} or not 0.8 < alpha.max() < 0.91 or alpha[0, 0] > 0.01:
        sys.exit(f"{path}: drew {alpha.max():.3f} at ({column}, {row}), expected nearly 0.9 in the middle.")
    print(f"{path}: draws, kernels: {instruction_set()}")


if __name__ == "__main__":
    main()
