"""A scene without its most transparent Gaussians, as is usual elsewhere, to be compared with one of a budget.

python benchmarks/budget.py FULL.frog CUT.frog [--budget 20000]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from frog_blender.engine.playback.player import select_gaussians
from frog_blender.engine.scene.scene_file import read_scene, write_scene


def main() -> None:
    parser = argparse.ArgumentParser(prog="budget.py", description="A scene without its most transparent Gaussians.")
    parser.add_argument("full", type=Path)
    parser.add_argument("cut", type=Path)
    parser.add_argument("--budget", type=int, default=20_000)
    options = parser.parse_args()
    scene = read_scene(options.full)
    kept = np.sort(np.argsort(-scene.arrays["opacity_logits"], kind="stable")[: options.budget])
    write_scene(options.cut, select_gaussians(scene, kept))


if __name__ == "__main__":
    main()
