"""Blender nodes as expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

import bpy


def new_geometry_group(name: str) -> Any:
    """An empty Geometry Nodes group for a modifier: geometry in, geometry out."""
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.is_modifier = True
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    return group


def _new_material(name: str) -> Any:
    """A material without any nodes."""
    made = bpy.data.materials.new(name)
    if made.node_tree is None:  # before 5.0 a new material has no nodes
        made.use_nodes = True
    made.node_tree.nodes.clear()
    return made


def made_once(kind: str, name: str) -> Callable[[Callable[[Builder], None]], Callable[[], Any]]:
    """Of a function that builds nodes, one that gives their data-block, which is made once per file.

    Args:
        kind: "materials" or "node_groups", of Geometry Nodes.
        name: of the data-block.
    """

    def decorate(build_nodes: Callable[[Builder], None]) -> Callable[[], Any]:
        @wraps(build_nodes)
        def block() -> Any:
            made = getattr(bpy.data, kind).get(name)
            if made is None:
                made = _new_material(name) if kind == "materials" else new_geometry_group(name)
                build = Builder(made.node_tree if kind == "materials" else made)
                build_nodes(build)
                build.arrange()
            return made

        return block

    return decorate


def set_input(modifier: bpy.types.Modifier, name: str, value: Any) -> None:
    """Sets an input of a modifier's nodes, of which a modifier knows only an identifier."""
    identifier = modifier.node_group.interface.items_tree[name].identifier
    if hasattr(modifier, "properties"):  # since Blender 5.2, which refuses the other way
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value


class Builder:
    """Nodes as expressions: each method but ``node`` adds a node and returns its output socket."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def node(self, kind: str, inputs: Mapping[Any, Any] | None = None, **properties: Any) -> Any:
        """A new node with these properties, and sockets or constants at its inputs, by their names or numbers."""
        node = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        for name, value in (inputs or {}).items():
            by_name = (socket for socket in node.inputs if socket.name == name and socket.enabled)
            socket = node.inputs[name] if isinstance(name, int) else next(by_name)
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            else:
                socket.default_value = value
        return node

    def out(self, kind: str, inputs: Mapping[Any, Any] | None = None, **properties: Any) -> Any:
        """The first output of a new node, see ``node``."""
        return next(socket for socket in self.node(kind, inputs, **properties).outputs if socket.enabled)

    def math(self, operation: str, *values: Any) -> Any:
        return self.out("ShaderNodeMath", dict(enumerate(values)), operation=operation)

    def vector(self, operation: str, *values: Any) -> Any:
        return self.out("ShaderNodeVectorMath", dict(enumerate(values)), operation=operation)

    def separate(self, value: Any) -> list[Any]:
        return list(self.node("ShaderNodeSeparateXYZ", {0: value}).outputs)

    def combine(self, *values: Any) -> Any:
        return self.out("ShaderNodeCombineXYZ", dict(enumerate(values)))

    def named(self, name: str, kind: str) -> Any:
        """A Geometry Nodes attribute."""
        return self.out("GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind)

    def store(self, geometry: Any, name: str, value: Any) -> Any:
        """Store a vector on the points."""
        inputs = {"Geometry": geometry, "Name": name, "Value": value}
        return self.out("GeometryNodeStoreNamedAttribute", inputs, data_type="FLOAT_VECTOR", domain="POINT")

    def attribute(self, name: str) -> tuple[Any, Any]:
        """A shader's attribute: its vector and its fourth component."""
        node = self.node("ShaderNodeAttribute", attribute_type="GEOMETRY", attribute_name=name)
        return node.outputs["Vector"], node.outputs["Alpha"]

    def to_object(self, value: Any, kind: str) -> Any:
        turned = {"vector_type": kind, "convert_from": "WORLD", "convert_to": "OBJECT"}
        return self.out("ShaderNodeVectorTransform", {0: value}, **turned)

    def arrange(self) -> None:
        """Spread the nodes in the order they were made, so that a curious user can read them."""
        for i, node in enumerate(self.tree.nodes):
            node.location = (220.0 * (i // 6), -190.0 * (i % 6))
