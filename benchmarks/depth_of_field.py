"""Two ways to depth of field beside Cycles: images from points of the lens, and splats blurred one by one.

    python benchmarks/depth_of_field.py [CASE ...] [--counts 8 16 32 64]

Needs bpy. A textured card is rendered by Cycles, and drawn as a grid of splats. Printed is a JSON line for each case:
PSNR in dB and seconds of the sharp image, of the blurred splats, and of averages over points of the lens.

A splat is blurred by the variance that a uniform disc of its circle of confusion has, and its opacity is scaled by what
its area on the screen grows by. Splats are then ordered as before.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import bpy
import cv2
import numpy as np
from mathutils import Euler, Matrix

import frog_blender
from frog_blender.cameras import engine_camera
from frog_blender.color_spaces import image_to_linear
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.gaussians import GaussianArrays, joined
from frog_blender.engine.playback.lens import Lens, seen_from
from frog_blender.engine.playback.render import Drawing, draw
from frog_blender.engine.playback.transform import rotations_of

SIZE, ACROSS, GREY, SH_DC = 160, 110, 0.05, 0.28209479177387814


def at(x: float, y: float, depth: float, size: float = 1.0, turn: float = 0.0) -> Matrix:
    """A card's place before the camera."""
    return Matrix.LocRotScale((x, y, -depth), Euler((0.0, turn, 0.0)), (size, size, size))


CASES: dict[str, tuple[list[Matrix], float, float, int]] = {
    "in focus": ([at(0, 0, 2.0)], 0.5, 2.0, 0),
    "behind": ([at(0, 0, 3.0, 1.4)], 0.5, 2.0, 0),
    "before": ([at(0, 0, 1.4, 0.7)], 0.5, 2.0, 0),
    "tilted": ([at(0, 0, 2.2, 1.4, 1.0)], 0.5, 2.0, 0),
    "two cards": ([at(-0.2, 0, 2.6, 1.2), at(0.25, 0.1, 1.3, 0.35)], 0.5, 2.6, 0),
    "six blades": ([at(0, 0, 3.0, 0.6)], 0.3, 2.0, 6),
}
"""Cards, f-stop, focus distance and blades."""


def texture(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    waves = [np.sin(9 * u) * np.cos(7 * v), np.sin(5 * u + 6 * v), np.cos(8 * v - 3 * u)]
    return 0.5 + 0.4 * np.stack(waves, axis=-1)


def add_mesh(place: Matrix) -> None:
    side = 256
    v, u = (np.mgrid[:side, :side] + 0.5) / side
    image = bpy.data.images.new("card", side, side)
    image.pixels.foreach_set(np.dstack([texture(u, v), np.ones((side, side))]).astype(np.float32).ravel())
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    card = bpy.context.object
    card.matrix_world = place
    material = bpy.data.materials.new("card")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    nodes = [tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "Emission", "OutputMaterial")]
    nodes[0].image, nodes[0].extension = image, "EXTEND"
    tree.links.new(nodes[0].outputs["Color"], nodes[1].inputs["Color"])
    tree.links.new(nodes[1].outputs[0], nodes[2].inputs[0])
    card.data.materials.append(material)


def splats(place: Matrix) -> GaussianArrays:
    """A grid of splats whose outer edges are the card's."""
    v, u = (np.mgrid[:ACROSS, :ACROSS] + 0.5) / ACROSS
    shrunk, matrix = 1 - 0.55 / ACROSS, np.array(place)
    local = np.stack([(u - 0.5) * shrunk, (v - 0.5) * shrunk, 0 * u, 0 * u + 1], axis=-1).reshape(-1, 4)
    size, count = 0.4 * np.linalg.norm(matrix[:3, 0]) / ACROSS, ACROSS**2
    return GaussianArrays(
        means=(local @ matrix.T)[:, :3].astype(np.float32),
        quaternions=np.tile(np.array([*place.to_quaternion()], np.float32), (count, 1)),
        scales=np.tile(np.array([size, size, size / 50], np.float32), (count, 1)),
        opacities=np.full(count, 0.99, np.float32),
        sh=((texture(u, v).reshape(-1, 1, 3) - 0.5) / SH_DC).astype(np.float32),
    )


def blurred(gaussians: GaussianArrays, camera: Camera, lens: Lens) -> GaussianArrays:
    """Each splat with its circle of confusion."""
    local = gaussians.means @ camera.rotation.T + camera.world_to_camera[:3, 3]
    depth = local[:, 2]
    radius = lens.radius * np.abs(depth - lens.focus) / lens.focus
    turn = rotations_of(gaussians.quaternions.astype(np.float64))
    sharp = (turn * gaussians.scales[:, None, :] ** 2) @ turn.transpose(0, 2, 1)
    plane = camera.rotation[:2].T @ camera.rotation[:2]
    wide = sharp + (radius**2 / 4)[:, None, None] * plane
    focal = camera.intrinsics[0, 0]
    jacobian = np.zeros((len(depth), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = focal / depth
    jacobian[:, :, 2] = -focal * local[:, :2] / depth[:, None] ** 2
    across = jacobian @ camera.rotation

    def area(covariance: np.ndarray) -> np.ndarray:
        return np.sqrt(np.linalg.det(across @ covariance @ across.transpose(0, 2, 1) + 0.3 * np.eye(2)))

    variances, axes = np.linalg.eigh(wide)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    return replace(
        gaussians,
        quaternions=np.array([[*Matrix(each.tolist()).to_quaternion()] for each in axes], np.float32),
        scales=np.sqrt(np.maximum(variances, 1e-14)).astype(np.float32),
        opacities=(gaussians.opacities * area(sharp) / area(wide)).astype(np.float32),
    )


def display(linear: np.ndarray) -> np.ndarray:
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def over_grey(drawing: Drawing) -> np.ndarray:
    """Scene-linear, over the world's grey."""
    over = drawing.rgb + (1 - np.clip(drawing.alpha, 0, 1))[..., None] * display(np.full(3, GREY))
    return image_to_linear(np.clip(over, 0, 1).astype(np.float32))


def rendered(places: list[Matrix], stop: float, focus: float, blades: int) -> tuple[np.ndarray, Camera, float]:
    """Cycles' image (H, W, 3) in [0, 1], its camera, and the lens in millimetres."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 128, False
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "Standard"
    scene.world = bpy.data.worlds.new("grey")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (GREY, GREY, GREY, 1.0)
    for place in places:
        add_mesh(place)
    data = bpy.data.cameras.new("eye")
    scene.camera = bpy.data.objects.new("eye", data)
    scene.collection.objects.link(scene.camera)
    data.dof.use_dof, data.dof.aperture_fstop, data.dof.focus_distance = True, stop, focus
    data.dof.aperture_blades = blades
    bpy.context.view_layer.update()
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "cycles.png")
        bpy.ops.render.render(write_still=True)
        image = cv2.imread(scene.render.filepath)[..., 2::-1] / 255.0
    return image, engine_camera(scene.camera, scene.camera.matrix_world, scene.render, SIZE, SIZE), data.lens


def judged(work: Callable[[], np.ndarray], truth: np.ndarray) -> dict[str, float]:
    started = time.perf_counter()
    image = work()
    seconds = time.perf_counter() - started
    return {"db": round(-10 * np.log10(np.square(display(image) - truth).mean()), 1), "s": round(seconds, 3)}


def measure(name: str, counts: list[int]) -> dict[str, object]:
    """One case."""
    places, stop, focus, blades = CASES[name]
    truth, camera, millimetres = rendered(places, stop, focus, blades)
    gaussians = joined([splats(place) for place in places])
    lens = Lens(millimetres * 1e-3 / (2 * stop), focus, blades)
    wide = blurred(gaussians, camera, lens)
    found: dict[str, object] = {"case": name}
    found["sharp"] = judged(lambda: over_grey(draw(gaussians, camera)), truth)
    found["splats"] = judged(lambda: over_grey(draw(wide, camera)), truth)
    for count in counts:
        found[f"lens {count}"] = judged(partial(averaged, gaussians, camera, lens, count), truth)
    return found


def averaged(gaussians: GaussianArrays, camera: Camera, lens: Lens, count: int) -> np.ndarray:
    """Through points of the lens."""
    eyes = [seen_from(camera, point, lens.focus) for point in lens.points(count)]
    return np.mean([over_grey(draw(gaussians, eye)) for eye in eyes], axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], default=list(CASES))
    parser.add_argument("--counts", type=int, nargs="+", default=[8, 16, 32, 64])
    arguments = parser.parse_args()
    frog_blender.register()
    for name in arguments.cases:
        print(json.dumps(measure(name, arguments.counts)), flush=True)


if __name__ == "__main__":
    main()
