"""The figures of the FRoG paper for a scene of one's own, of one held-out image.

    python examples/figures.py X.frog CAPTURE OUT [--camera NAME] [--frame N]

Writes OUT/figures.png, panels with their names, and each panel as a file of its own:

- truth, render, and their difference in colour as a heat map (dark to yellow, 0 to 0.1);
- the canonical field as it is before anything moves it;
- median depth and mean depth (near is bright): what is half transparent corrupts the mean;
- "opacity filter", the render without Gaussians whose opacity is below 0.05, and "no opacity deform", with the
  canonical opacities; each with its difference.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from frog_blender import engine as frog
from frog_blender.engine.evaluation.evaluate import held_out_shots, open_training_capture

FAINT = 0.05
"""The opacity below which the paper's filter leaves Gaussians out."""
BRIGHTEST = 0.1
"""The mean difference of colours that is the top of a heat map."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--camera", help="default: the first that was held out")
    parser.add_argument("--frame", type=int, help="of the capture; default: the middle one that it has")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    panels = figures(options.scene, options.capture, options.camera, options.frame)
    for name, image in panels.items():
        write(options.out / f"{name.replace(' ', '_')}.png", image)
    write(options.out / "figures.png", sheet(panels))


def figures(scene_path: Path, capture_path: Path, name: str | None, frame: int | None) -> dict[str, np.ndarray]:
    """Panels (H, W, 3) by name, RGB in [0, 1].

    Raises:
        FrogError: if the scene is not of the capture, or there is no such image.
    """
    scene = frog.load_scene(scene_path)
    capture = open_training_capture(scene, capture_path)
    shots = held_out_shots(scene, capture) or list(range(len(capture.shots)))
    if name is not None:
        shots = [i for i, shot in enumerate(capture.shots) if capture.cameras[shot.camera].name == name]
    wanted = capture.frame_count // 2 if frame is None else frame
    if not shots or (frame is not None and frame not in {capture.shots[i].frame for i in shots}):
        raise frog.FrogError(f"{capture_path}: found no image of camera {name or 'held out'} at frame {frame}.")
    index = min(shots, key=lambda i: abs(capture.shots[i].frame - wanted))
    shot = capture.shots[index]
    camera, time = capture.cameras[shot.camera], capture.time_of(shot)
    truth = frog.TrueImages(capture, None).image(index)

    moved, canonical = scene.at(time), scene.canonical().at(time)
    as_is = frog.draw(moved, camera, scene.header.background)
    variants = {
        "render": moved,
        "opacity filter": replace(moved, opacities=np.where(moved.opacities < FAINT, 0, moved.opacities)),
        "no opacity deform": replace(moved, opacities=canonical.opacities),
    }
    still = frog.draw(canonical, camera, scene.header.background).rgb.clip(0, 1)
    median, mean = depths(as_is.median_z, as_is.mean_depth)
    beside = {"truth": truth, "canonical": still, "median depth": median}
    panels = {}
    for (left, panel), (title, gaussians) in zip(beside.items(), variants.items(), strict=True):
        image = frog.draw(gaussians, camera, scene.header.background).rgb.clip(0, 1)
        panels |= {left: panel, title: image, f"{title} difference": heat(np.abs(image - truth).mean(2) / BRIGHTEST)}
    return panels | {"mean depth": mean}


def depths(median: np.ndarray, mean: np.ndarray) -> list[np.ndarray]:
    """Heat maps of two depths (H, W) in the same colours, from the median's nearest to its farthest hundredth."""
    near, far = np.nanpercentile(median, (1, 99))
    span = max(1 / near - 1 / far, 1e-9)
    return [heat(np.nan_to_num((1 / np.maximum(depth, 1e-6) - 1 / far) / span)) for depth in (median, mean)]


def heat(values: np.ndarray) -> np.ndarray:
    """(H, W) in [0, 1] as colours (H, W, 3)."""
    levels = (values.clip(0, 1) * 255).round().astype(np.uint8)
    return cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO)[..., ::-1] / np.float32(255)


def sheet(panels: dict[str, np.ndarray], columns: int = 3) -> np.ndarray:
    """All panels with their names in rows of ``columns``."""
    named = []
    for title, panel in panels.items():
        image = np.ascontiguousarray(panel * np.float32(255))
        for level, thickness in ((0, 3), (255, 1)):  # white with a black rim
            cv2.putText(image, title, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (level,) * 3, thickness, cv2.LINE_AA)
        named.append(image / 255)
    named += [np.zeros_like(named[0])] * (-len(named) % columns)
    rows = [np.concatenate(named[start : start + columns], axis=1) for start in range(0, len(named), columns)]
    return np.concatenate(rows)


def write(path: Path, image: np.ndarray) -> None:
    if not cv2.imwrite(str(path), (image[..., ::-1] * 255).round().clip(0, 255).astype(np.uint8)):
        raise frog.FrogError(f"{path}: could not be written.")


if __name__ == "__main__":
    try:
        main()
    except frog.FrogError as error:
        sys.exit(f"figures: {error}")
