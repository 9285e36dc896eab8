"""Renders rooms with rigs of known cameras in Blender, calibrates the films alone, and compares: a JSON line each.

    python benchmarks/rendered_rigs.py OUT [--only WORDS] [--films]

Cycles renders curved things with soft shadows. Each rig is filmed twice, in step and with films that start at times of
their own. What stands is rendered once a camera, with new noise in every frame; what moves is rendered for each. OUT
keeps the images, so that a killed run goes on; a few minutes a rig on one core. ``results.jsonl`` lies in OUT.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import bpy
import cv2
import imageio_ffmpeg
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

import rig_cases
import textures as paint
from calibration import arguments, compared, cpu_seconds, run
from capture_rig import View
from capture_videos import configure
from real_rigs import read_found
from rig_cases import Array, Eye
from scene_parts import Scene, box, lamp, material, surface, surroundings, wall
from shapes import ball, bar

from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.synchronization.films import CalibrationRefused

RATE = 12.0
FRAMES, LONGER = 6, 16
"""Frames of films in step, and of those that are not."""
_STANDING_SAMPLES, _SAMPLES = 12, 3
_NOISE = 2.0  # standard deviation, of 255
_DIFFERS = 6.0  # blurred, of 255
_MARGIN = 0.2  # metres about what moves: its shadow's soft edge

Border = tuple[int, int, int, int]


def blotches(seed: int, size: int = 512, count: int = 500) -> Array:
    """Ellipses of all sizes and colours, as on a worn or painted thing."""
    random = np.random.default_rng(seed)
    image = np.full((size, size, 3), 0.5, np.float32)
    for _ in range(count):
        place = random.integers(0, size, 2).tolist()
        axes = np.maximum(2, size * random.uniform(0.004, 0.05, 2)).astype(int).tolist()
        color = (0.5 + random.uniform(-0.45, 0.45, 3)).tolist()
        cv2.ellipse(image, place, axes, float(random.uniform(0, 180)), 0, 360, color, -1, cv2.LINE_AA)
    return image


def _figure(scene: Scene, reach: float, coat: int) -> None:
    """Somebody of balls and bars who walks about; a phase of 1 is a second."""
    wear = [material(f"coat {part}", blotches(coat + part, 256, 160)) for part in range(4)]

    def feet(time: float) -> tuple[Array, Array]:
        turn = 1.3 * time
        spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
        return np.array([reach * np.cos(0.9 * time), reach * np.sin(1.1 * time), 0.0]), spin

    def body(time: float) -> Array:
        place, spin = feet(time)
        return place + (ball(np.zeros(3), 1.0, np.eye(3)) * [0.26, 0.17, 0.36] + [0, 0, 1.14]) @ spin.T

    def head(time: float) -> Array:
        place, spin = feet(time)
        return place + ball(np.array([0.0, 0.0, 1.64]), 0.14, spin.T)

    def limb(side: float, top: float, length: float, swing: float) -> Callable[[float], Array]:
        def shape(time: float) -> Array:
            place, spin = feet(time)
            angle = swing * np.sin(5 * time)
            joint = np.array([side, 0.0, top])
            end = joint + length * np.array([0.0, np.sin(angle), -np.cos(angle)])
            return place + bar(joint, end, 0.07) @ spin.T

        return shape

    scene.add_moving("body", body, wear[0])
    scene.add_moving("head", head, wear[1])
    for number, (side, swing) in enumerate([(0.3, 0.5), (-0.3, -0.5)]):
        scene.add_moving(f"arm {number}", limb(side, 1.4, 0.6, swing), wear[2])
        scene.add_moving(f"leg {number}", limb(side / 2.5, 0.85, 0.82, -swing), wear[3])


def _light() -> None:
    surroundings((1.0, 0.98, 0.95), 0.7)
    sun = lamp("lamp", "AREA", 260, (1.0, 0.95, 0.88), 1.5)
    sun.location = (1.5, -1.0, 4.2)


class Workshop(Scene):
    """Textured walls, crates, pots and a figure that walks."""

    def build(self) -> None:
        half, height = 3.0, 2.8
        side = 2 * half
        boards = material("boards", paint.planks(10, (0.62, 0.43, 0.27)), 0.55, (2, 2))
        wall("floor", (-half, -half, 0), (side, 0, 0), (0, side, 0), boards)
        wall(
            "back", (-half, half, 0), (side, 0, 0), (0, 0, height), material("bricks", paint.bricks(), 0.9, (2.6, 1.3))
        )
        papers = [paint.wallpaper((0.36, 0.56, 0.60), (0.44, 0.66, 0.68), 20)]
        papers.append(paint.wallpaper((0.86, 0.72, 0.50), (0.80, 0.58, 0.40), 21))
        for sign, paper in zip((-1, 1), papers, strict=True):
            wear = material(f"paper {sign}", paper, 0.9, (3, 1.5))
            wall(f"side {sign}", (sign * half, sign * half, 0), (0, -sign * side, 0), (0, 0, height), wear)
        for number, (x, z) in enumerate([(-1.9, 1.3), (-0.4, 1.6), (1.2, 1.2)]):
            wear = material(f"poster {number}", blotches(30 + number, 512, 350))
            wall(f"poster {number}", (x, half - 0.03, z), (0.9, 0, 0), (0, 0, 0.7), wear)
            place = (half - 0.03, 0.9 - x, z - 0.2)
            wall(f"other poster {number}", place, (0, -0.8, 0), (0, 0, 0.7), wear)
        for number, (x, y, edge) in enumerate([(-1.7, 1.2, 0.7), (1.6, 1.5, 0.5), (1.9, 0.2, 0.6), (-1.6, -0.6, 0.45)]):
            wear = material(f"crate {number}", blotches(40 + number, 256, 200))
            box(f"crate {number}", (x, y, edge / 2), (edge, edge, edge), wear, 0.4 * number)
        for number, (x, y) in enumerate([(-0.7, 2.0), (0.8, 1.9), (2.2, 1.1)]):
            shape = ball(np.array([x, y, 0.35]), 0.35, np.eye(3))
            surface(f"pot {number}", shape, material(f"pot {number}", blotches(60 + number)), True)
        _figure(self, 0.7, 70)
        _light()


class Turntable(Scene):
    """A pillar of things on a plain floor, nothing around; a ball flies about it."""

    def build(self) -> None:
        floor = 0.45 + 0.02 * paint.noise(1024, 1024, 24, 9)[..., None] * np.ones(3)
        wall("floor", (-6, -6, 0), (12, 0, 0), (0, 12, 0), material("floor", floor, 0.9))
        wears = [material(f"thing {number}", blotches(80 + number, 512, 420)) for number in range(6)]
        box("foot", (0, 0, 0.2), (0.9, 0.8, 0.4), wears[0], 0.2)
        box("middle", (0.05, -0.03, 0.62), (0.6, 0.5, 0.44), wears[1], 0.7)
        for number, (x, y, z, radius) in enumerate(
            [(0, 0, 1.12, 0.3), (0.55, 0.3, 0.2, 0.2), (-0.6, 0.25, 0.25, 0.25)]
        ):
            shape = ball(np.array([x, y, z]), radius, np.eye(3))
            surface(f"ball {number}", shape, wears[2 + number], True)

        def flying(time: float) -> Array:
            place = [0.75 * np.cos(2 * time), 0.75 * np.sin(2 * time), 0.8 + 0.3 * np.sin(3 * time)]
            return ball(np.array(place), 0.16, np.eye(3))

        self.add_moving("flying", flying, wears[5])
        _light()


ROOMS = {"workshop": Workshop, "turntable": Turntable}


def rigs() -> list[rig_cases.Case]:
    """All of them in step, and then with films that start late."""
    arc = rig_cases.shaken(rig_cases.arc(5, 17), 101)
    ring = rig_cases.ring(np.arange(8) * 45.0, 2.4, (0, 0, 0.6), 0.25)
    mixed = rig_cases.shaken(rig_cases.arc(4, 15), 103)
    lenses = [(1.2, (480, 270)), (0.75, (480, 270)), (0.9, (270, 480)), (1.0, (480, 270))]
    kinds = tuple(rig_cases.eye(n, place, *lens) for n, (place, lens) in enumerate(zip(mixed, lenses, strict=True)))
    late = (0.0, 0.31, -0.17, 0.52, 0.243, -0.41, 0.127, -0.28)
    found = [
        ("arc of 5 in a workshop", "workshop", rig_cases.eyes(arc, focal=0.85, size=(480, 270))),
        (
            "ring of 8 about a thing on a plain floor",
            "turntable",
            rig_cases.eyes(ring, focal=0.9, size=(400, 300)),
        ),
        ("4 focal lengths, one portrait", "workshop", kinds),
    ]
    in_step = [rig_cases.Case(f"{name}, in step", *rest) for name, *rest in found]
    return in_step + [rig_cases.Case(f"{name}, not in step", *rest, late[: len(rest[1])]) for name, *rest in found]


def _look_through(eye: Eye) -> None:
    """Makes it the camera of the scene, for Cycles on one core, without the denoiser, which would smear textures."""
    configure(eye, _SAMPLES, 1)
    cycles = bpy.context.scene.cycles
    cycles.use_denoising, cycles.sample_clamp_indirect = False, 2.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = 0  # the sky lights all that it sees
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = eye.pose[:, :3].T @ np.diag([1.0, -1.0, -1.0]), eye.center
    bpy.context.scene.camera = View(eye.name, eye.width, eye.height, eye.focal, matrix).add_camera()


def _rendered(folder: Path, samples: int, border: Border | None = None) -> tuple[Array, Border | None]:
    """The image (H, W, 3) BGR of what the scene's camera sees, and its border: beyond, nothing is rendered."""
    settings = bpy.context.scene
    render = settings.render
    settings.cycles.samples, settings.cycles.seed = samples, settings.cycles.seed + 1
    render.use_border, render.use_crop_to_border = border is not None, False
    if border is not None:
        render.border_min_x, render.border_max_x = (x / render.resolution_x for x in border[:2])
        render.border_min_y, render.border_max_y = (1 - y / render.resolution_y for y in border[:1:-1])
    render.filepath = str(folder / "unfinished.png")
    bpy.ops.render.render(write_still=True)
    return cv2.imread(render.filepath), border


def _standing(scene: Scene, path: Path) -> Array:
    """The image without what moves, of an earlier run or new."""
    if path.exists():
        return cv2.imread(str(path))
    for thing, _ in scene.moving:
        thing.hide_render = True
    image, _ = _rendered(path.parent, _STANDING_SAMPLES)
    for thing, _ in scene.moving:
        thing.hide_render = False
    cv2.imwrite(str(path), image)
    return image


def _border(scene: Scene, eye: Eye) -> Border:
    """Columns and rows, from and up to, about what moves now and its shadow on the floor."""
    places = np.concatenate([vertices(thing) for thing, _ in scene.moving])
    low, high = places.min(axis=0) - _MARGIN, places.max(axis=0) + _MARGIN
    low[2] = 0.0
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    seen = corners @ eye.pose[:, :3].T + eye.pose[:, 3]
    pixels = eye.focal * seen[:, :2] / np.maximum(seen[:, 2:], 0.1) + [eye.width / 2, eye.height / 2]
    first = np.floor(np.clip(pixels.min(axis=0), 0, [eye.width - 8, eye.height - 8])).astype(int)
    last = np.ceil(np.clip(pixels.max(axis=0), first + 8, [eye.width, eye.height])).astype(int)
    return int(first[0]), int(last[0]), int(first[1]), int(last[1])


def vertices(thing: bpy.types.Object) -> Array:
    """(N, 3) world places."""
    found = np.empty(3 * len(thing.data.vertices), np.float32)
    thing.data.vertices.foreach_get("co", found)
    return found.reshape(-1, 3).astype(float)


def _over(standing: Array, part: tuple[Array, Border | None]) -> Array:
    """The image in which the border's inside is that of the other where it differs, which few samples' noise does not.

    With noise in all of the border, which no camera has, calibration would take the border for what moves.
    """
    image, border = standing.astype(float), part[1]
    assert border is not None
    left, right, top, bottom = border
    inside = np.s_[top + 1 : bottom - 1, left + 1 : right - 1]
    image[inside] = part[0][inside]
    return changed(standing.astype(float), image)


def changed(standing: Array, image: Array) -> Array:
    """The standing image (H, W, 3), and the other where it differs, as far as that is more than noise."""
    apart = np.abs(cv2.GaussianBlur(image.astype(float) - standing, (0, 0), 2.0)).max(axis=2)
    return np.where((apart > _DIFFERS)[..., None], image, standing)


def film(case: rig_cases.Case, folder: Path) -> None:
    """A video of each camera that is not there yet."""
    missing = [n for n, eye in enumerate(case.eyes) if not (folder / f"{eye.name}.mp4").exists()]
    if not missing:
        return
    scene, rig = ROOMS[case.room](), case.name.rpartition(", ")[0]
    for number in missing:
        eye, late = case.eyes[number], case.shifts[number] if case.shifts else 0.0
        images = folder / "images" / eye.name
        images.mkdir(parents=True, exist_ok=True)
        _look_through(eye)
        standing = _standing(scene, folder.parent / f"{case.room} {rig} {eye.name}.png")
        paths = [images / f"{frame:03d}.png" for frame in range(LONGER if case.shifts else FRAMES)]
        for frame, path in enumerate(paths):
            if path.exists():
                continue
            scene.pose(1.0 + late + frame / RATE)
            image = _over(standing, _rendered(folder, _SAMPLES, _border(scene, eye)))
            noisy = image + np.random.default_rng((number, frame)).normal(0, _NOISE, image.shape)
            cv2.imwrite(str(path), noisy.round().clip(0, 255).astype(np.uint8))
        encode(folder, eye, (cv2.imread(str(path))[..., ::-1] for path in paths))
        print(f"{case.name}: {eye.name}", flush=True)
    shutil.rmtree(folder / "images")


def encode(folder: Path, eye: Eye, images: Iterable[Array]) -> None:
    """The video of a camera, of images (H, W, 3) uint8; a killed run leaves none."""
    unfinished = folder / f"{eye.name}.unfinished.mp4"
    size, quality = (eye.width, eye.height), ["-crf", "18", "-preset", "veryfast"]
    writer = imageio_ffmpeg.write_frames(
        str(unfinished), size, fps=RATE, codec="libx264", macro_block_size=1, output_params=quality
    )
    writer.send(None)
    for image in images:
        writer.send(np.ascontiguousarray(image))
    writer.close()
    unfinished.rename(folder / f"{eye.name}.mp4")


def measure(case: rig_cases.Case, films: Path, folder: Path) -> dict[str, Any]:
    """A calibration in a folder of a copy of the films, and its errors.

    Of films out of step also: by how many frames the worst film's start is wrong, whatever capture time starts with.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(films, folder)
    record: dict[str, Any] = {
        "rig": case.name,
        "room": case.room,
        "cameras": len(case.eyes),
        "in_step": not case.shifts,
    }
    before, started = cpu_seconds(), time.perf_counter()
    try:
        outcome = calibrate(folder, Options(in_step=not case.shifts), lambda *_: None, lambda: False)
        record["warnings"] = list(outcome.warnings)
        _, found, offsets = read_found(folder)
        written = json.loads((folder / "cameras_opencv.json").read_text())["cameras"]
        record |= compared(found, {each["name"]: (each["dist"] or [0.0])[0] for each in written}, case.eyes)
        if case.shifts:
            wrong = np.array([offsets[eye.name] - late for eye, late in zip(case.eyes, case.shifts, strict=True)])
            record["clocks"] = float(RATE * np.abs(wrong - np.median(wrong)).max())
    except CalibrationRefused as refusal:
        record["refusal"] = str(refusal)
    record["seconds"], record["cpu_seconds"] = time.perf_counter() - started, cpu_seconds() - before
    return record


def main() -> None:
    parser = arguments(__doc__.splitlines()[0])
    parser.add_argument("--films", action="store_true", help="only make the films, which OUT keeps")
    options = parser.parse_args()

    def filmed_and_measured(case: rig_cases.Case) -> dict[str, Any]:
        films = options.out / "films" / case.folder
        films.mkdir(parents=True, exist_ok=True)
        film(case, films)
        return {} if options.films else measure(case, films, options.out / "calibrated" / case.folder)

    run(options, rigs(), filmed_and_measured)


if __name__ == "__main__":
    main()
