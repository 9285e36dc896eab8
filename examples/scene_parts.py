"""Parts that every rendered scene is built of in bpy: materials, meshes, lamps, and surfaces that move."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
import textures as paint


def material(
    name: str, albedo: np.ndarray, roughness: float = 0.8, tiling: tuple[float, float] = (1, 1)
) -> bpy.types.Material:
    """A material that wears an (H, W, 3) sRGB albedo, repeated `tiling` times over the surface's UV square."""
    height, width = albedo.shape[:2]
    image = bpy.data.images.new(name, width, height)
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = albedo
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    result = bpy.data.materials.new(name)
    result.use_nodes = True
    nodes, links = result.node_tree.nodes, result.node_tree.links
    surface = nodes["Principled BSDF"]
    surface.inputs["Roughness"].default_value = roughness
    surface.inputs["Specular IOR Level"].default_value = 0.25
    texture, mapping, coordinate = (nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "Mapping", "TexCoord"))
    texture.image = image
    mapping.inputs["Scale"].default_value = (*tiling, 1)
    links.new(coordinate.outputs["UV"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], surface.inputs["Base Color"])
    return result


def plain(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    return material(name, paint.finish(paint.flat(128, 128, color), 0.05, 7))


def mesh_object(
    name: str, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, wear: bpy.types.Material
) -> bpy.types.Object:
    """An object of quads: vertices (N, 3) metres, faces (F, 4) indices, uv (F, 4, 2)."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.reshape(-1, 3).tolist(), [], faces.tolist())
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv.astype(np.float32).ravel())
    mesh.materials.append(wear)
    result = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(result)
    return result


def wall(
    name: str, corner: tuple[float, ...], right: tuple[float, ...], up: tuple[float, ...], wear: bpy.types.Material
) -> None:
    """A rectangle from its lower left corner and two edges."""
    origin, u, v = np.array(corner), np.array(right), np.array(up)
    uv = np.array([[[0, 0], [1, 0], [1, 1], [0, 1]]])
    mesh_object(name, np.array([origin, origin + u, origin + u + v, origin + v]), np.array([[0, 1, 2, 3]]), uv, wear)


def box(
    name: str,
    center: tuple[float, float, float],
    size: tuple[float, float, float],
    wear: bpy.types.Material,
    turn: float = 0.0,
    columns: tuple[float, float] = (0.0, 1.0),
) -> None:
    """A box turned by `turn` radians about z; every side wears the part `columns` of the image's width."""
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    local = signs * np.array(size) / 2
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    faces = np.array([[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [4, 5, 7, 6], [2, 3, 1, 0]])
    low, high = columns
    uv = np.tile(np.array([[low, 0], [high, 0], [high, 1], [low, 1]]), (6, 1, 1))
    mesh_object(name, local @ rotation.T + np.array(center), faces, uv, wear)


def surface(name: str, vertices: np.ndarray, wear: bpy.types.Material, closed: bool) -> bpy.types.Object:
    """A smooth grid of vertices (rows, columns, 3); a closed one joins its last column to its first."""
    rows, columns = vertices.shape[:2]
    spans = columns if closed else columns - 1
    row, column = (index.ravel() for index in np.meshgrid(np.arange(rows - 1), np.arange(spans), indexing="ij"))
    corners = [(0, 0), (0, 1), (1, 1), (1, 0)]
    faces = np.stack([(row + up) * columns + (column + right) % columns for up, right in corners], axis=1)
    places = [np.stack([(column + right) / spans, (row + up) / (rows - 1)], axis=1) for up, right in corners]
    result = mesh_object(name, vertices, faces, np.stack(places, axis=1), wear)
    result.data.shade_smooth()
    return result


def lamp(name: str, kind: str, power: float, color: tuple[float, float, float], size: float) -> bpy.types.Object:
    """A lamp of `power` watts that no camera sees: AREA with an edge, or POINT with a radius, of `size` metres."""
    light = bpy.data.lights.new(name, kind)
    if kind == "AREA":
        light.size = size
    else:
        light.shadow_soft_size = size
    light.energy, light.color = power, color
    result = bpy.data.objects.new(name, light)
    result.visible_camera = False
    bpy.context.scene.collection.objects.link(result)
    return result


def surroundings(color: tuple[float, float, float], strength: float) -> None:
    """Even light from everywhere."""
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (*color, 1)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = strength
    bpy.context.scene.world = world


class Scene:
    """An emptied bpy that a subclass fills in `build`; `pose` moves what moves."""

    def __init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.moving: list[tuple[bpy.types.Object, Callable[[float], np.ndarray]]] = []
        self.build()

    def build(self) -> None:
        raise NotImplementedError

    def add_moving(
        self, name: str, shape: Callable[[float], np.ndarray], wear: bpy.types.Material, closed: bool = True
    ) -> bpy.types.Object:
        """A smooth surface whose vertices (rows, columns, 3) are a function of the phase (0 .. 1)."""
        item = surface(name, shape(0.0), wear, closed)
        self.moving.append((item, shape))
        return item

    def pose(self, phase: float) -> None:
        """Move every moving surface to the phase (0 .. 1) of the video."""
        for item, shape in self.moving:
            item.data.vertices.foreach_set("co", shape(phase).astype(np.float32).ravel())
            item.data.update()
