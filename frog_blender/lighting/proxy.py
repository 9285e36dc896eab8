"""The proxy mesh of a capture: objects that its root moves, for shadows, holdouts, collisions and other programs."""

import bpy

from ..engine.surfaces.fusion import Mesh
from ..engine.surfaces.proxy import Proxy
from ..nodes.node_builder import Builder, made_once, new_geometry_group, set_input
from ..scene_import.capture_objects import root_of
from ..timeline.retiming import stretched

SHADOWS, HOLDOUT, PLAIN = "SHADOWS", "HOLDOUT", "PLAIN"
"""What a proxy is for."""
_ALWAYS = 1e9  # frames
_MODIFIER, _GROUP = "Frames", "FRoG Proxy Frames"
_FRAMES, _FIRST, _COUNT = "Frames", "First Frame", "Frame Count"
"""Inputs of the group: a collection whose objects, by their names, are the frames; the frame of the timeline, after
Time Stretching, that shows the first one; how many there are. Before and after them the first and last are shown."""
_STRETCH, _FROM, _UNTIL = "Time Stretching", "From", "Until"
"""Inputs: how many frames pass while Time Stretching has one pass; the first frame, after Time Stretching, at which
there is anything, and the first after that at which there is nothing."""
_INPUTS = {_FRAMES: "Collection", _FIRST: "Float", _COUNT: "Int", _STRETCH: "Float", _FROM: "Float", _UNTIL: "Float"}
_ROUNDING = 1e-3  # frames


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
    earlier, timing = proxies_of(obj), _timing(obj, scene, first_frame)
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
    local = (collection for collection in obj.users_collection if collection.library is None)
    return [collection for collection in local if collection.override_library is None]


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


def _timing(obj: bpy.types.Object, scene: bpy.types.Scene, first_frame: int) -> dict[str, float]:
    """The group's inputs for what a capture shows in a scene."""
    begin, end = (obj.frog.range_start, obj.frog.range_end) if obj.frog.use_range else (-_ALWAYS, _ALWAYS)
    first, stretch = stretched(scene, first_frame), 1 / stretched(scene, 1)
    return {_FIRST: first, _STRETCH: stretch, _FROM: begin, _UNTIL: end}


def _play(obj: bpy.types.Object, meshes: list[bpy.types.Mesh], timing: dict[str, float]) -> None:
    """Shows a mesh a frame on an object, and neither these nor its own outside the capture's range.

    By Geometry Nodes: without a handler, it plays, renders and exports anywhere.
    """
    modifier = obj.modifiers.new(_MODIFIER, "NODES")
    modifier.node_group = _frames_group()
    if meshes:
        frames = bpy.data.collections.new(f"{obj.name} Frames")
        for index, mesh in enumerate(meshes):  # which Blender takes in the order of their names, cut at 63 bytes
            frames.objects.link(bpy.data.objects.new(f"{index:06d} {obj.name}", mesh))
        set_input(modifier, _FRAMES, frames)
    for name, value in {_COUNT: len(meshes), **timing}.items():
        set_input(modifier, name, value)


def _frames_group() -> bpy.types.GeometryNodeTree:
    """The Geometry Nodes group, made once per file: joins the frame of the timeline to an object's own mesh."""
    for known in bpy.data.node_groups:  # one that a user has changed may not do
        if known.name.startswith(_GROUP) and known.library is None and _plays_frames(known):
            return known
    group = new_geometry_group(_GROUP)
    for name, kind in _INPUTS.items():
        group.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    build = Builder(group)
    source = build.node("NodeGroupInput").outputs
    parts = {"Collection": source[_FRAMES], "Separate Children": True, "Reset Children": True}
    frames = build.out("GeometryNodeCollectionInfo", parts)
    now = build.node("GeometryNodeInputSceneTime").outputs["Frame"]
    passed = build.math("MULTIPLY", build.math("SUBTRACT", now, source[_FIRST]), source[_STRETCH])
    latest = build.math("SUBTRACT", source[_COUNT], 1.0)
    index = build.math("MAXIMUM", build.math("MINIMUM", build.math("ROUND", passed), latest), 0.0)
    chosen = {"Instance": frames, "Pick Instance": True, "Instance Index": index}
    chosen["Points"] = build.out("GeometryNodePoints")
    shown = build.out("GeometryNodeRealizeInstances", {0: build.out("GeometryNodeInstanceOnPoints", chosen)})
    joined = build.node("GeometryNodeJoinGeometry", {0: shown})
    group.links.new(source[0], joined.inputs[0])  # a second one into the same socket
    begun = build.math("GREATER_THAN", build.math("ADD", now, _ROUNDING), source[_FROM])
    ended = build.math("LESS_THAN", build.math("ADD", now, _ROUNDING), source[_UNTIL])
    limits = {"Switch": build.math("MULTIPLY", begun, ended), "True": joined.outputs[0]}
    build.node("NodeGroupOutput", {0: build.out("GeometryNodeSwitch", limits, input_type="GEOMETRY")})
    build.arrange()
    return group


def _plays_frames(group: bpy.types.NodeTree | None) -> bool:
    """Whether a group, if there is one, has the inputs of that which plays frames."""
    return group is not None and all(name in group.interface.items_tree for name in _INPUTS)


@made_once("materials", "FRoG Proxy")
def _material(build: Builder) -> None:
    """Grey in Cycles, whose shadow catchers need a surface. EEVEE has none: there cameras see through it."""
    grey, rays = build.out("ShaderNodeBsdfDiffuse"), build.node("ShaderNodeLightPath")
    clear = {0: rays.outputs["Is Camera Ray"], 1: grey, 2: build.out("ShaderNodeBsdfTransparent")}
    for engine, shader in (("CYCLES", grey), ("EEVEE", build.out("ShaderNodeMixShader", clear))):
        build.node("ShaderNodeOutputMaterial", {"Surface": shader}, target=engine)


def _mesh(name: str, content: Mesh, material: bpy.types.Material | None) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(content.vertices.tolist(), (), content.quads.tolist(), shade_flat=False)
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
    if modifier.type != "NODES" or not _plays_frames(modifier.node_group):
        return None
    identifier = modifier.node_group.interface.items_tree[_FRAMES].identifier
    if hasattr(modifier, "properties"):  # since Blender 5.2
        return getattr(modifier.properties.inputs, identifier).value
    return modifier.get(identifier)
