"""What packing does to scenes in which some Gaussians are far away or huge, as MCMC-like trainings leave them.

    python benchmarks/packing.py SCENE.frog... [--shares 0 0.001 0.005 0.02] [--seeds 3]

Of each scene, which must come from `frog train --capacity fixed`, such a share of the Gaussians is put 1e2 to 1e7 away,
made e^3 to e^8 times as large or given colours 10 to 1,000 times as strong, a third each, all nearly transparent. The
scene is packed with such numbers apart, as files are, and together with the others of their blocks.
One JSON object a scene and share, means over the seeds: kilobytes of the packed arrays, PSNR of the
packed images against those of the scene as it is, and per cent of the pixels that differ by more than 8 of 255.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw, to_uint8
from frog_blender.engine.scene import quantization
from frog_blender.engine.scene.quantization import BITS, morton_order_by_range, pack, unpack
from frog_blender.engine.scene.scene_file import SceneFile, read_scene

DIM = -5.0  # logit of an opacity that can just be seen


def main() -> None:
    parser = argparse.ArgumentParser(prog="packing.py", description="What packing does to far and huge Gaussians.")
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--shares", type=float, nargs="+", default=[0, 0.001, 0.005, 0.02])
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    for path in options.scenes:
        scene = read_scene(path)
        if not scene.header.cameras:
            parser.error(f"{path}: expected a scene with cameras")
        for share in options.shares:
            found = [measured(strayed(scene, share, seed)) for seed in range(options.seeds if share else 1)]
            means = {name: round(float(np.mean([each[name] for each in found])), 3) for name in found[0]}
            print(json.dumps({"scene": path.name, "share": share, **means}), flush=True)


def strayed(scene: SceneFile, share: float, seed: int) -> SceneFile:
    """The scene with such a share of its Gaussians astray."""
    random = np.random.default_rng(seed)
    arrays = {name: array.copy() for name, array in scene.arrays.items()}
    count = len(arrays["means"])
    chosen = random.permutation(count)[: round(share * count)]
    far, huge, bright = np.array_split(chosen, 3)
    directions = random.normal(size=(len(far), 3))
    distances = 10 ** random.uniform(2, 7, (len(far), 1))
    arrays["means"][far] += np.float32(distances * directions / np.linalg.norm(directions, axis=1, keepdims=True))
    arrays["log_scales"][huge] += np.float32(random.uniform(3, 8, (len(huge), 1)))
    arrays["sh"][bright] *= np.float32(10 ** random.uniform(1, 3, (len(bright), 1, 1)))
    arrays["opacity_logits"][chosen] = DIM
    order = morton_order_by_range(arrays["means"], len(arrays.get("embeddings", ())))
    by_gaussian = {name: array[order[: len(array)]] for name, array in arrays.items() if name in BITS}
    return replace(scene, arrays=arrays | by_gaussian)


def measured(scene: SceneFile) -> dict[str, float]:
    """Bytes and images of the scene packed both ways."""
    truth, found = images(scene), {}
    for way, inside in (("apart", quantization._inside), ("together", lambda *_: None)):
        with patch.object(quantization, "_inside", inside):
            packed = {name: pack(name, array) for name, array in scene.arrays.items()}
        size = sum(len(array.content) for array in packed.values())
        arrays = {name: unpack(array.content, array.description) for name, array in packed.items()}
        figures = compared(images(replace(scene, arrays=arrays)), truth)
        found |= {f"{way} {name}": value for name, value in {"kB": size / 1e3, **figures}.items()}
    return found


def compared(drawn: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    differences = drawn.astype(float) - truth
    error = max(float(np.square(differences).mean()), 1e-6)
    off = np.abs(differences).max(axis=-1) > 8
    return {"PSNR": 10 * np.log10(255**2 / error), "% off": 100 * float(off.mean())}


def images(file: SceneFile) -> np.ndarray:
    """(P, 3) uint8: the pixels that three of the cameras see at three frames."""
    scene = ScenePlayer(file)
    cameras, frames = scene.header.cameras, scene.header.frame_count
    views = [(cameras[i * (len(cameras) - 1) // 2], i * (frames - 1) / 2) for i in range(3)]
    drawn = [draw(scene.at_frame(frame), camera, scene.header.background).rgb for camera, frame in views]
    return np.concatenate([to_uint8(rgb).reshape(-1, 3) for rgb in drawn])


if __name__ == "__main__":
    main()
