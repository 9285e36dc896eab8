"""What the commands do, as functions that the demo and the examples share."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.capture.camera import Camera
from ..engine.capture.capture import Capture
from ..engine.capture.frames import FrameStore, is_decoded
from ..engine.capture.readers import open_capture
from ..engine.errors import FrogError
from ..engine.evaluation.evaluate import Measure, evaluate
from ..engine.io.atomic_files import write_atomically
from ..engine.playback.player import ScenePlayer
from ..engine.playback.render import render_image, to_uint8
from ..engine.scene import compression_report
from ..engine.scene.scene_file import SceneFile, read_scene
from ..engine.source_media.clips import camera_path
from ..engine.training.recipe import recipe
from ..engine.training.session.job import usual_scale
from ..engine.training.session.likely_device import likely_device
from ..engine.training.session.time_estimate import Workload, estimate

Report = Callable[[int, int], None]


def describe(path: Path, pixel_offsets: dict[str, tuple[float, float]] | None) -> dict[str, Any]:
    """What a capture folder or a ``.frog`` holds, as plain values; lists are lines."""
    if path.suffix == ".frog":
        return _describe_scene(ScenePlayer.load(path), path)
    capture = open_capture(path, pixel_offsets=pixel_offsets)
    sizes = sorted({f"{camera.width} x {camera.height}" for camera in capture.cameras})
    withheld = sorted(capture.test_cameras) or [f"{len(capture.test_frames)} of {capture.frame_count} moments"]
    if len(withheld) > 12:
        withheld = [*withheld[:12], f"... ({len(withheld)} in all)"]
    return {
        "format": capture.format,
        "cameras": "1, moving" if capture.is_moving else len(capture.cameras),
        "frames": capture.frame_count,
        "frame rate": capture.frames_per_second,
        "size": ", ".join(sizes),
        "held out": ", ".join(withheld) if capture.test_cameras or capture.test_frames else "nothing",
        "distortion": "removed at import" if any(capture.distortions) else "none",
        "training": _training_times(capture),
        "warning": list(capture.warnings),
    }


def _training_times(capture: Capture) -> list[str]:
    """What the recipes for any computer would take, a line each."""
    device = likely_device("auto")
    times = [(name, recipe(name)) for name in ("draft", "standard")]
    scale = usual_scale(capture.cameras)
    prepared = is_decoded(capture if scale == 1 else capture.scaled(scale))
    works = [replace(Workload.of(capture, chosen, scale=scale), prepared=prepared) for _, chosen in times]
    return [f"{name}: {estimate(work, device)}" for (name, _), work in zip(times, works, strict=True)]


def _describe_scene(scene: ScenePlayer, path: Path) -> dict[str, Any]:
    header = scene.header
    return {
        "method": header.method,
        "gaussians": scene.count,
        "dynamic": scene.moving,
        "heads": _heads(scene),
        "sh_degree": scene.sh_degree,
        "bytes": path.stat().st_size,
        "cameras": "1, moving" if header.is_moving else ", ".join(camera.name for camera in header.cameras) or "none",
        "frames": header.frame_count,
        "frame rate": header.frames_per_second,
        "size": ", ".join(sorted({f"{camera.width} x {camera.height}" for camera in header.cameras})),
        "training": f"{header.recipe.get('name')}, {header.steps} steps, {header.train_seconds:.0f} s",
        "metrics": [f"{name} {value}" for name, value in header.metrics.items()],
        "capture": header.capture_path,
        "reductions": compression_report.lines(header.capacity),
    }


def _heads(scene: ScenePlayer) -> list[str]:
    """What the network of a scene changes; none where there is none of FRoG's kind, or nothing moves."""
    model = scene.header.model
    if not scene.moving or scene.header.method not in ("frog", "ed3dgs"):
        return []
    names = ["means", "log_scales", "quaternions", "opacity_logits", *(["sh"] if model["deformed_sh"] else [])]
    return [name for name in names if name not in model.get("silent_heads", ())]


def open_evaluated(scene: ScenePlayer, capture_path: Path) -> tuple[Any, FrameStore]:
    """The capture as the scene saw it (size, offsets, poses), and its frames. FrogError when it is another capture."""
    header = scene.header
    capture = open_capture(capture_path, pixel_offsets=header.pixel_offsets or None)
    if header.scale != 1.0:
        capture = capture.scaled(header.scale)
    for found, expected in _pairs(capture.cameras, capture.frame_count, header.cameras, header.frame_count):
        if found != expected:
            raise FrogError(f"{capture_path}: found {found}, expected {expected} as the scene was trained on.")
    seen = capture.with_cameras(header.cameras)  # their poses may have been refined in training
    return seen, FrameStore.open(capture)


def _pairs(
    cameras: Sequence[Camera], frames: int, trained: Sequence[Camera], trained_frames: int
) -> Iterator[tuple[str, str]]:
    """What a capture and a scene must have in common, as each has it."""
    yield f"{len(cameras)} cameras and {frames} frames", f"{len(trained)} cameras and {trained_frames} frames"
    for camera, own in zip(cameras, trained, strict=True):
        yield (
            f"camera {camera.name} of {camera.width} x {camera.height} pixels",
            f"camera {own.name} of {own.width} x {own.height} pixels",
        )


def evaluate_file(
    scene_path: Path,
    capture_path: Path,
    split: str = "auto",
    mask: Path | None = None,
    report: Report | None = None,
    *,
    perceptual: bool = False,
) -> dict[str, Any]:
    """See ``evaluate``; with ``perceptual`` also "flip" and "lpips", None where they cannot be computed, and then
    "missing" says why by name."""
    scene = ScenePlayer.load(scene_path)
    capture, store = open_evaluated(scene, capture_path)
    measures: dict[str, Measure] = {}
    absent: dict[str, Any] = {}
    if perceptual:
        from ..experiments.perceptual import perceptual_measures

        measures, missing = perceptual_measures()
        absent = {**dict.fromkeys(missing), "missing": missing}
    size = scene_path.stat().st_size
    figures = evaluate(
        scene, capture, store, split=split, mask_file=mask, file_bytes=size, measures=measures, progress=report
    )
    return {**figures, **absent}


def parse_frames(text: str | None, count: int) -> range:
    """``A:B`` as frames A to B - 1, either end optional; FrogError for anything outside."""
    try:
        first, last = text.split(":") if text else ("", "")
        frames = range(int(first or 0), int(last or count))
    except ValueError:
        raise FrogError(f"--frames {text}: expected A:B, such as 0:30.") from None
    if not frames or frames[0] < 0 or frames[-1] >= count:
        raise FrogError(f"--frames {text}: expected frames between 0:{count}.")
    return frames


def image_maker(scene: SceneFile, device: str) -> Callable[[float, Camera], np.ndarray]:
    """Draws frames: (frame, camera) to (H, W, 3) uint8; without torch unless ``device`` is another one than "cpu"."""
    played = ScenePlayer(scene)  # refuses what does not fit together
    if device != "cpu":
        from ..engine.model.torch_player import TorchScenePlayer
        from ..engine.training.optimize.device import choose_device

        chosen, said_of_it = choose_device(device)
        if said_of_it:
            print(f"warning: {said_of_it}", file=sys.stderr)
        if chosen.type != "cpu" and played.moving:  # what stands still needs no GPU to be moved
            on_device = TorchScenePlayer(scene, chosen)
            return lambda frame, camera: to_uint8(on_device.render_image(frame, camera))
    return lambda frame, camera: render_image(played.at_frame(frame), camera, scene.header.background)


def _file_name(camera_name: str) -> str:
    """A camera's name without what leads into other folders, on any system."""
    return re.sub(r'[/\\:*?"<>|]', "_", camera_name)


def render_frames(
    scene_path: Path, camera_name: str, frames: str | None, out: Path, report: Report, device: str = "cpu"
) -> int:
    """Writes a PNG for each frame as the camera of that name sees it; returns how many.

    A moving camera's name stands for one moment's pose; "moving" follows it. ``device`` is "cpu", "cuda" or "auto".
    """
    import cv2

    scene = read_scene(scene_path)
    header, image_of = scene.header, image_maker(scene, device)
    names = [camera.name for camera in header.cameras]
    follow = header.is_moving and camera_name == "moving"
    if camera_name not in names and not follow:
        known = ", ".join([*names[:12], "..."] if len(names) > 12 else names) or "none"
        raise FrogError(f"{scene_path}: there is no camera {camera_name!r}; there are {known}.")
    chosen = parse_frames(frames, header.frame_count)
    by_frame = dict(camera_path(header))
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FrogError(f"{out}: the folder could not be made ({error.strerror}).") from error
    for done, frame in enumerate(chosen):
        if follow:  # the nearest moment that has an image: captures may leave moments out
            camera = by_frame[min(by_frame, key=lambda moment: abs(moment - frame))]
        else:
            camera = header.cameras[names.index(camera_name)]
        path = out / f"{_file_name(camera_name)}_{frame:04d}.png"
        written, content = cv2.imencode(".png", cv2.cvtColor(image_of(frame, camera), cv2.COLOR_RGB2BGR))
        if not written:
            raise FrogError(f"{path}: the image could not be encoded.")
        write_atomically(path, content.tobytes())
        report(done + 1, len(chosen))
    return len(chosen)
