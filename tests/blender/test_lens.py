"""Depth of field and panoramas beside Cycles: the same things made of meshes and of splats, through one camera."""

import math

import bpy
import mathutils
import numpy as np
import pytest
from support.builders import refused, refuses
from support.small_scenes import glowing, passes_of, world_of
from support.still_scenes import write_still
from support.users_scene import eye_in

from frog_blender.engine.evaluation.metrics import psnr
from frog_blender.render import blur

SIZE, ACROSS, GREY = 160, 110, 0.05


def texture(u, v):
    waves = [np.sin(9 * u) * np.cos(7 * v), np.sin(5 * u + 6 * v), np.cos(8 * v - 3 * u)]
    return 0.5 + 0.4 * np.stack(waves, axis=-1)


def mesh_card(place):
    side = 128
    v, u = (np.mgrid[:side, :side] + 0.5) / side
    image = bpy.data.images.new("card", side, side)
    image.pixels.foreach_set(np.dstack([texture(u, v), np.ones((side, side))]).astype(np.float32).ravel())
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    card = bpy.context.object
    card.matrix_world = place
    material = glowing((1.0, 1.0, 1.0))
    nodes = material.node_tree.nodes
    emission = next(node for node in nodes if node.type == "EMISSION")
    picture = nodes.new("ShaderNodeTexImage")
    picture.image, picture.extension = image, "EXTEND"
    material.node_tree.links.new(picture.outputs["Color"], emission.inputs["Color"])
    card.data.materials.append(material)
    return card


def splat_card(place):
    """Positions, scales and colours of ACROSS x ACROSS splats whose outer edges are the card's."""
    v, u = (np.mgrid[:ACROSS, :ACROSS] + 0.5) / ACROSS
    shrunk = 1 - 0.55 / ACROSS
    local = np.stack([(u - 0.5) * shrunk, (v - 0.5) * shrunk, 0 * u, 0 * u + 1], axis=-1).reshape(-1, 4)
    matrix = np.array(place)
    size = 0.4 * np.linalg.norm(matrix[:3, 0]) / ACROSS
    return (local @ matrix.T)[:, :3], np.full((len(local), 3), (size, size, 0.02 * size)), texture(u, v).reshape(-1, 3)


def at(x, y, z, size=1.0):
    return mathutils.Matrix.LocRotScale((x, y, z), None, (size, size, size))


@pytest.fixture
def eye(empty):
    """The scene's camera at the origin, looking along -z, before a grey world; Cycles takes enough samples."""
    empty.world = world_of("Grey", (GREY, GREY, GREY))
    empty.render.resolution_x = empty.render.resolution_y = SIZE
    empty.view_settings.view_transform = "Standard"
    empty.cycles.samples, empty.cycles.use_denoising = 128, False
    return eye_in(empty)


def both(scene, meshes, splats, rendered):
    """The images of Cycles and of FROG, of the same things, (H, W, 3) in [0, 1]."""
    camera, kept = scene.camera, {name: getattr(scene.view_settings, name) for name in ("view_transform", "look")}
    assert bpy.ops.import_scene.frog(filepath=str(splats)) == {"FINISHED"}
    scene.camera = camera
    scene.render.resolution_percentage = 100
    for name, value in kept.items():
        setattr(scene.view_settings, name, value)
    images = []
    for engine in ("CYCLES", "FROG"):
        for obj in bpy.data.objects:
            obj.hide_render = obj != camera and (obj in meshes) != (engine == "CYCLES")
        side = {"resolution_x": scene.render.resolution_x, "resolution_y": scene.render.resolution_y}
        images.append(rendered(scene, engine=engine, **side)[..., :3] / 255.0)
    return images


def test_cards_out_of_focus_are_as_cycles_renders_them(empty, eye, rendered, tmp_path):
    """One behind the focus, one before it."""
    dof = eye.data.dof
    dof.use_dof, dof.aperture_fstop, dof.focus_distance = True, 0.5, 2.0
    places = [at(-0.2, 0, -2.8, 1.2), at(0.25, 0.1, -1.3, 0.35)]
    parts = [np.concatenate(part) for part in zip(*map(splat_card, places), strict=True)]
    meshes = [mesh_card(place) for place in places]
    mesh, splats = both(empty, meshes, write_still(tmp_path / "cards.frog", *parts), rendered)
    assert psnr(mesh, splats) >= 35.0
    dof.use_dof = False
    sharp = rendered(empty)[..., :3] / 255.0
    assert psnr(mesh, sharp) < psnr(mesh, splats) - 4.0, "the blur matters"


def test_blades_rotation_and_ratio_shape_a_point_as_in_cycles(empty, eye, rendered, tmp_path):
    """A small ball far out of focus is the picture of the aperture."""
    dof = eye.data.dof
    dof.use_dof, dof.aperture_fstop, dof.focus_distance = True, 0.1, 1.0
    dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 3, 0.5, 1.6
    empty.frog.lens_samples = 512
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.1, location=(0.0, 0.0, -2.0))
    ball = bpy.context.object
    ball.data.materials.append(glowing((1.0, 1.0, 1.0)))
    splats = write_still(tmp_path / "ball.frog", [(0.0, 0.0, -2.0)], (0.055, 0.055, 0.055), [(1.0, 1.0, 1.0)])
    mesh, drawn = (image[..., 0] - image[0, 0, 0] for image in both(empty, [ball], splats, rendered))
    mesh, drawn = (np.where(image > 0.05, image, 0) for image in (mesh, drawn))
    rows, columns = np.indices(mesh.shape)

    def moments(image):
        """Where the aperture's image lies, and how it spreads and leans."""
        image = image / image.sum()
        down, right = (image * rows).sum(), (image * columns).sum()
        y, x = rows - down, columns - right
        second = [math.sqrt((image * y * y).sum()), math.sqrt((image * x * x).sum()), (image * x * y).sum() / 10]
        return np.array([down, right, *second, np.cbrt((image * y**3).sum()), np.cbrt((image * x**3).sum())])

    np.testing.assert_allclose(moments(drawn), moments(mesh), atol=1.5)
    assert abs(moments(mesh)[5]) > 4.0, "a triangle points somewhere"


def test_the_focus_follows_its_object(empty, eye):
    target = bpy.data.objects.new("target", None)
    empty.collection.objects.link(target)
    target.location = (5.0, 1.0, -3.0)
    dof = eye.data.dof
    dof.use_dof, dof.focus_object, dof.aperture_fstop = True, target, 2.0
    graph = bpy.context.evaluated_depsgraph_get()
    lens = blur.lens_of(eye.evaluated_get(graph), graph)
    assert lens.focus == pytest.approx(3.0) and lens.radius == pytest.approx(0.05 / 4)
    dof.focus_object, dof.focus_distance = None, 0.0
    graph.update()
    refused("found its focus at 0", blur.lens_of, eye.evaluated_get(graph), graph)


KINDS = ("EQUIRECTANGULAR", "FISHEYE_EQUIDISTANT", "FISHEYE_EQUISOLID", "MIRRORBALL")
DIRECTIONS = np.array([(0, 0, -1), (0.6, 0.3, -1), (-1, 0.2, -0.4), (1, -0.5, 0.5), (-0.5, 0.9, -0.6), (0.3, -1, -0.8)])


def balls(scene, tmp_path):
    """Small balls of clear colours around the camera, as meshes and as splats."""
    places = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True) * 2.0
    colors = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)], float)
    meshes = []
    for place, color in zip(places, colors, strict=True):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.12, location=place)
        bpy.context.object.data.materials.append(glowing(tuple(color)))
        meshes.append(bpy.context.object)
    return meshes, write_still(tmp_path / "balls.frog", places, (0.05, 0.05, 0.05), colors), colors


def centre(image, color):
    """Where an image has a colour: the middle in pixels (row, column), and how much there is."""
    grey = 1.055 * GREY ** (1 / 2.4) - 0.055  # display-referred
    beside, wanted = image - grey, color - grey
    strength = np.linalg.norm(beside, axis=-1)
    alike = beside @ wanted / np.maximum(strength, 1e-9) / np.linalg.norm(wanted)
    weight = np.where((alike > 0.9) & (strength > 0.1), strength, 0.0)
    rows, columns = np.indices(weight.shape)
    total = weight.sum()
    return np.array([(weight * rows).sum(), (weight * columns).sum()]) / max(total, 1e-9), total


@pytest.mark.parametrize("kind", KINDS)
def test_a_panorama_shows_things_where_cycles_does(empty, eye, kind, rendered, tmp_path):
    data = eye.data
    data.type, data.panorama_type = "PANO", kind
    data.fisheye_fov, data.fisheye_lens, data.sensor_width = math.radians(200), 10.0, 36.0
    eye.rotation_euler = (0.2, 0.1, 0.3)
    meshes, splats, colors = balls(empty, tmp_path)
    empty.render.resolution_x, empty.render.resolution_y = (192, 96) if kind != "FISHEYE_EQUIDISTANT" else (128, 128)
    mesh, drawn = both(empty, meshes, splats, rendered)
    seen = 0
    for color in colors:
        (expected, much), (found, little) = centre(mesh, color), centre(drawn, color)
        if much > 4:
            seen += 1
            assert little > 0.1 * much, f"{color} is missing"
            np.testing.assert_allclose(found, expected, atol=0.7)
    assert seen >= 3


def test_a_panorama_has_no_seams_and_distances_for_depths(empty, eye, tmp_path):
    """A shell of splats around the camera: equally far, and as dense, everywhere."""
    steps = np.arange(12000) + 0.5
    height, angle = 1 - 2 * steps / 12000, steps * math.pi * (3 - math.sqrt(5))
    flat = np.sqrt(1 - height**2)
    shell = 3.0 * np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)
    splats = write_still(tmp_path / "shell.frog", shell, (0.1, 0.1, 0.1), np.full((12000, 3), 0.6))
    assert bpy.ops.import_scene.frog(filepath=str(splats)) == {"FINISHED"}
    empty.camera, empty.render.engine = eye, "FROG"
    eye.data.type, eye.data.panorama_type = "PANO", "EQUIRECTANGULAR"
    empty.render.resolution_x, empty.render.resolution_y, empty.render.film_transparent = 128, 64, True
    combined, depth = passes_of(empty, tmp_path)
    assert combined[..., 3].min() > 0.99
    assert combined[..., :3].std() < 0.01
    np.testing.assert_allclose(depth, 3.0, atol=0.01)


def test_what_no_panorama_can_be_is_refused_in_a_sentence(empty, eye, capture, rendered):
    empty.camera, empty.render.engine = eye, "FROG"
    data = eye.data
    data.type, data.panorama_type = "PANO", "CENTRAL_CYLINDRICAL"
    refuses("found a panorama of the kind central cylindrical, expected", rendered, empty)
    data.panorama_type = "EQUIRECTANGULAR"
    bpy.context.view_layer.use_pass_vector = True
    refuses("a panoramic camera and a Vector pass", rendered, empty)
    bpy.context.view_layer.use_pass_vector = False
    data.stereo.use_spherical_stereo = empty.render.use_multiview = True
    refuses("found spherical stereo", rendered, empty)
