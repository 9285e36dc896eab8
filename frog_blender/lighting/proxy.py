"""The proxy mesh of a capture: objects that its root moves, for shadows, holdouts, collisions and other programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..nodes.node_builder import Builder, new_material, set_input
from ..nodes.proxy_nodes import COUNT, FIRST, FRAMES, FROM, STRETCH, UNTIL, frames_group, plays_frames
from ..scene_import.capture_objects import root_of
from ..timeline.retiming import stretched

if TYPE_CHECKING:
    from ..engine.surfaces.fusion import Mesh
    from ..engine.surfaces.proxy import Proxy

SHADOWS, HOLDOUT, PLAIN = "SHADOWS", "HOLDOUT", "PLAIN"
"""What a proxy is for."""
_ALWAYS = 1e9  # frames
_MODIFIER, _MATERIAL = "Frames", "FRoG Proxy"


def proxies_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """The proxy meshes of a capture, of which others may share its root: of what stays and of what moves."""
    return [child for child in root_of(obj).children if child.frog.is_proxy and child.frog.proxy_of in (obj, None)]


def place(
    obj: bpy.types.Object, scene: bpy.types.Scene, proxy: Proxy, first_frame: int, use: str
) -> list[bpy.types.Object]:
    """Gives a capture its proxy mesh, in place of an earlier one.

    Args:
        scene: whose timeline the meshes are for.
        first_frame: of the timeline, at which the first mesh of what moves is shown.
        use: SHADOWS, HOLDOUT or PLAIN.
    """
    earlier, timing = proxies_of(obj), _Timing.of(obj, scene, first_frame)
    name, material, made = f"{root_of(obj).name} Proxy", _material() if use == SHADOWS else None, {}
    if len(proxy.still.quads):
        still = made[name] = bpy.data.objects.new(name, _mesh(name, proxy.still, material))
        _set_use(still, use, casts_shadows=False)
        if obj.frog.use_range:
            _play(still, [], timing)
    if proxy.moving:
        name = f"{name} Moving"
        moving = made[name] = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        different = {id(mesh): mesh for mesh in proxy.moving}
        meshes = {key: _mesh(name, mesh, material) for key, mesh in different.items()}
        _play(moving, [meshes[id(mesh)] for mesh in proxy.moving], timing)
        _set_use(moving, use, casts_shadows=True)
    for mesh in made.values():
        mesh.frog.is_proxy, mesh.frog.proxy_of = True, obj
        mesh.parent = root_of(obj)
        if obj.parent is not None:  # without a root the capture itself moves them
            mesh.matrix_parent_inverse, mesh.matrix_basis = obj.matrix_parent_inverse, obj.matrix_basis
        mesh.lock_location = mesh.lock_rotation = mesh.lock_scale = (True, True, True)
        for collection in _own_collections(obj) or [scene.collection]:
            collection.objects.link(mesh)
    for older in earlier:  # last, so that they are there if anything fails
        _remove(older)
    for name, mesh in made.items():
        mesh.name = mesh.data.name = name
    return list(made.values())


def _own_collections(obj: bpy.types.Object) -> list[bpy.types.Collection]:
    """The collections of an object to which this file can add others."""
    return [
        collection
        for collection in obj.users_collection
        if collection.library is None and collection.override_library is None
    ]


def _set_use(obj: bpy.types.Object, use: str, *, casts_shadows: bool) -> None:
    """Sets what other engines show of a proxy.

    A room casts no shadows although it catches them: its walls would keep the world's light out, which stands for the
    light of the very same walls.
    """
    obj.is_shadow_catcher, obj.is_holdout = use == SHADOWS, use == HOLDOUT
    obj.visible_shadow = use == PLAIN or (use == SHADOWS and casts_shadows)
    for rays in ("diffuse", "glossy", "transmission", "volume_scatter"):
        setattr(obj, f"visible_{rays}", use == PLAIN)
    obj.display_type = "TEXTURED" if use == PLAIN else "BOUNDS"  # viewports show the splats


def is_for_shadows(obj: bpy.types.Object) -> bool:
    """Whether a proxy was made for shadows, also while it catches none: then nothing else shows it."""
    return not obj.is_holdout and not obj.visible_diffuse


@dataclass(frozen=True)
class _Timing:
    """Numbers of the timeline, see nodes.proxy_nodes."""

    first: float
    stretch: float
    begin: float
    end: float

    @classmethod
    def of(cls, obj: bpy.types.Object, scene: bpy.types.Scene, first_frame: int) -> _Timing:
        """Of what a capture shows in a scene."""
        limits = (obj.frog.range_start, obj.frog.range_end) if obj.frog.use_range else (-_ALWAYS, _ALWAYS)
        return cls(stretched(scene, first_frame), 1 / stretched(scene, 1), *limits)


def _play(obj: bpy.types.Object, meshes: list[bpy.types.Mesh], timing: _Timing) -> None:
    """Shows a mesh a frame on an object, and neither these nor its own outside the capture's range."""
    modifier = obj.modifiers.new(_MODIFIER, "NODES")
    modifier.node_group = frames_group()
    if meshes:
        frames = bpy.data.collections.new(f"{obj.name} Frames")
        for index, mesh in enumerate(meshes):  # which Blender takes in the order of their names, cut at 63 bytes
            frames.objects.link(bpy.data.objects.new(f"{index:06d} {obj.name}", mesh))
        set_input(modifier, FRAMES, frames)
    numbers = ((FIRST, timing.first), (STRETCH, timing.stretch), (FROM, timing.begin), (UNTIL, timing.end))
    for name, value in ((COUNT, len(meshes)), *numbers):
        set_input(modifier, name, value)


def _material() -> bpy.types.Material:
    """Grey in Cycles, whose shadow catchers need a surface. EEVEE has none: there cameras see through it."""
    found = bpy.data.materials.get(_MATERIAL)
    if found is not None:
        return found
    made = new_material(_MATERIAL)
    build = Builder(made.node_tree)
    grey, rays, clear = (build.node(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "LightPath", "BsdfTransparent"))
    mix = build.node("ShaderNodeMixShader")
    build.link(rays.outputs["Is Camera Ray"], mix.inputs[0])
    build.link(grey.outputs[0], mix.inputs[1])
    build.link(clear.outputs[0], mix.inputs[2])
    for engine, shader in (("CYCLES", grey), ("EEVEE", mix)):
        output = build.node("ShaderNodeOutputMaterial")
        output.target = engine
        build.link(shader.outputs[0], output.inputs["Surface"])
    build.arrange()
    return made


def _mesh(name: str, content: Mesh, material: bpy.types.Material | None) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(content.vertices))
    mesh.vertices.foreach_set("co", content.vertices.ravel())
    mesh.loops.add(content.quads.size)
    mesh.loops.foreach_set("vertex_index", content.quads.ravel())
    mesh.polygons.add(len(content.quads))
    mesh.polygons.foreach_set("loop_start", np.arange(0, content.quads.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    if material is not None:
        mesh.materials.append(material)
    return mesh


def _remove(obj: bpy.types.Object) -> None:
    """Removes a proxy with everything that only it uses."""
    blocks: set[bpy.types.ID] = {obj, *([obj.data] if obj.data.users == 1 else [])}
    modifier = obj.modifiers.get(_MODIFIER)
    frames = _frames(modifier) if modifier is not None else None
    if frames is not None and frames.users == 1:
        blocks |= {frames, *frames.objects, *(frame.data for frame in frames.objects)}
    bpy.data.batch_remove(blocks)


def _frames(modifier: bpy.types.Modifier) -> bpy.types.Collection | None:
    if modifier.type != "NODES" or not plays_frames(modifier.node_group):
        return None
    identifier = modifier.node_group.interface.items_tree[FRAMES].identifier
    if hasattr(modifier, "properties"):  # since Blender 5.2
        found: bpy.types.Collection | None = getattr(modifier.properties.inputs, identifier).value
        return found
    return modifier.get(identifier)
