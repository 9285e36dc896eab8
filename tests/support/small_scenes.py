"""Small .frog scenes and readers of what Blender wrote, for tests inside Blender."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from support import builders
from support.builders import looking_at, scene_header

from frog_blender import point_cloud
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import SceneFile
from frog_blender.engine.scene.scene_file import write_scene as write_file
from frog_blender.render.world import background_node
from frog_blender.scene_import.capture_objects import active_capture

HIDDEN, EMBEDDING = 16, builders.MODEL["embedding_size"]
MODEL = {**builders.MODEL, "hidden_width": HIDDEN, "motion_unit": 1.0}


def lens(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def rig_of_three() -> list[Camera]:
    return [
        looking_at("cam00", (0.0, -4.0, 1.0), (96, 64), lens(90.0, 90.0, 48.0, 32.0)),
        looking_at("cam01", (3.0, -2.5, 0.5), (56, 80), lens(77.3, 77.3, 33.7, 35.2)),
        looking_at("cam02", (-3.0, -2.5, 1.5), (80, 64), lens(88.0, 83.5, 36.4, 40.1)),
    ]


def moving_camera(count: int) -> list[Camera]:
    cameras = []
    for i, angle in enumerate(np.linspace(-0.6, 0.6, count)):
        eye = 4.0 * np.sin(angle), -4.0 * np.cos(angle), 0.5 + angle
        intrinsics = lens(70.0 + i, 70.0 + i, 35.0 + 0.2 * i, 25.0)
        cameras.append(looking_at(f"frame_{i:03d}", eye, (72, 48), intrinsics))
    return cameras


def write_scene(
    path: Path,
    cameras: list[Camera],
    *,
    frame_count: int = 10,
    count: int = 60,
    seed: int = 0,
    sh_count: int = 4,
    **header: Any,
) -> Path:
    """A scene of ``count`` moving Gaussians around the origin; with what else its header is to say."""
    random = np.random.default_rng(seed)
    arrays = gaussian_arrays(random, count, sh_count)
    write_file(path, SceneFile(scene_header(cameras, frame_count, **{"model": MODEL, **header}), arrays))
    return path


def imported(path: Path, **options: Any) -> bpy.types.Object:
    """The capture of a file, imported into the open scene."""
    assert bpy.ops.import_scene.frog(filepath=str(path), **options) == {"FINISHED"}
    return active_capture(bpy.context)


def gaussian_arrays(random: np.random.Generator, count: int, sh_count: int) -> dict[str, np.ndarray]:
    """Random Gaussians and a small random deformation network that moves, turns, fades and tints them."""
    sh = random.normal(0.0, 0.4, (count, sh_count, 3))
    sh[:, 0] = random.uniform(-1.6, 1.6, (count, 3))
    arrays = {
        "means": random.normal(0.0, 0.5, (count, 3)),
        "quaternions": random.normal(0.0, 1.0, (count, 4)),
        "log_scales": np.log(random.uniform(0.05, 0.4, (count, 3))),
        "opacity_logits": random.normal(1.5, 1.5, count),
        "sh": sh,
        "embeddings": random.normal(0.0, 1.0, (count, EMBEDDING)),
        "temporal_table": random.normal(1.0, 0.3, (MODEL["temporal_rows"], MODEL["temporal_size"])),
        "network.embedding_weight": random.normal(0.0, 0.5, (HIDDEN, EMBEDDING)),
        "network.temporal_weight": random.normal(0.0, 0.5, (HIDDEN, MODEL["temporal_size"])),
        "network.bias": random.normal(0.0, 0.1, HIDDEN),
        "network.output_weight": random.normal(0.0, 0.1, (3 + 3 + 4 + 1 + 3, HIDDEN)),
        "network.output_bias": np.zeros(3 + 3 + 4 + 1 + 3),
    }
    return {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in arrays.items()}


def world_of(name: str, color: tuple[float, float, float]) -> bpy.types.World:
    """A new world of a colour."""
    world = bpy.data.worlds.new(name)
    if world.node_tree is None:
        world.use_nodes = True
    world.color = color
    background_node(world).inputs["Color"].default_value = (*color, 1.0)
    return world


def of_one_shader(kind: str, **inputs: Any) -> bpy.types.Material:
    """A material of a shader node with values at its inputs."""
    material = bpy.data.materials.new(kind)
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def glowing(color: tuple[float, float, float]) -> bpy.types.Material:
    """A material that shows one scene-linear colour whatever the light."""
    return of_one_shader("ShaderNodeEmission", Color=(*color, 1.0))


def animate(block: Any, name: str, *keys: tuple[float, Any]) -> None:
    """Gives a property of a data-block, or of a group in it, keys of a frame and a value."""
    for frame, value in keys:
        setattr(block, name, value)
        block.keyframe_insert(name, frame=frame)


def cropped(capture: bpy.types.Object, shape: str = "BOX", scale: float = 1.0) -> bpy.types.Object:
    """A new crop of a capture, so many times as large as it would be."""
    assert bpy.ops.frog.add_crop(shape=shape) == {"FINISHED"}
    crop = capture.frog_edits.crops[-1].object
    crop.scale *= scale
    bpy.context.view_layer.update()
    return crop


def edit_everything(obj: bpy.types.Object) -> None:
    """Crops, grades and hides something of the active capture, whose object this is."""
    assert bpy.ops.frog.add_crop(shape="SPHERE") == {"FINISHED"}
    obj.frog_edits.crops[0].feather = 0.3
    obj.frog_edits.grade.exposure, obj.frog_edits.grade.saturation = 0.6, 0.4
    bpy.ops.frog.select_gaussians(by="OPACITY", opacity=0.6)
    bpy.ops.frog.add_grade()
    obj.frog_edits.grades[0].temperature = 1.0
    bpy.ops.frog.select_gaussians(by="SIZE", size=0.42)
    bpy.ops.frog.hide_gaussians()


def channels_of(image: bpy.types.Image) -> np.ndarray:
    """(H, W, channels) float32, rows from the top."""
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], -1)[::-1]


def read_png(path: Path) -> np.ndarray:
    """(H, W, 4) uint8, rows from the top, as stored."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    values = channels_of(image)
    bpy.data.images.remove(image)
    return np.round(values * 255.0).astype(np.uint8)


def shows(obj: bpy.types.Object, path: Path, frame: float) -> None:
    """Asserts that an object's points are those of a file's frame, to the bit."""
    shown, gaussians = point_cloud.read(obj), ScenePlayer.load(path).at_frame(frame)
    columns = {"position": gaussians.means, "rotation": gaussians.quaternions, "scale": gaussians.scales}
    columns["radiance:base"] = np.concatenate([gaussians.sh[:, 0], gaussians.opacities[:, None]], axis=1)
    columns |= {f"radiance:sh_{k - 1}": gaussians.sh[:, k] for k in range(1, gaussians.sh.shape[1])}
    assert columns.keys() <= shown.keys()
    for name, values in columns.items():
        np.testing.assert_array_equal(shown[name], values, err_msg=name)


def plays(obj: bpy.types.Object, path: Path, *frames: float) -> None:
    """Asserts the same at frames of the open scene's timeline, whose first one is the capture's."""
    for frame in frames:
        bpy.context.scene.frame_set(int(frame), subframe=frame % 1)
        shows(obj, path, frame - 1)


def expected_png(path: Path, camera: Camera, frame: float) -> np.ndarray:
    """What the engine itself draws at a capture frame, as (H, W, 3) float in units of 1/255."""
    scene = ScenePlayer.load(path)
    drawing = draw(scene.at_frame(frame), camera, background=scene.header.background)
    return np.clip(drawing.rgb, 0.0, 1.0) * 255.0


def passes_of(scene, tmp_path):
    """Combined (H, W, 4) and Depth (H, W) of the current frame as a render stores them, rows from the top."""
    from support.exr import pass_of, render_channels

    for layer in scene.view_layers:
        layer.use_pass_z = True
    channels = render_channels(scene, tmp_path / "passes.exr")
    return pass_of(channels, "Combined", "RGBA"), pass_of(channels, "Depth")
