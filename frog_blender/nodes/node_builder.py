"""Blender nodes as expressions."""

from __future__ import annotations

from typing import Any

import bpy


def new_geometry_group(name: str) -> Any:
    """An empty Geometry Nodes group for a modifier: geometry in, geometry out."""
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.is_modifier = True
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    return group


def new_material(name: str) -> Any:
    """A material without any nodes."""
    made = bpy.data.materials.new(name)
    if made.node_tree is None:  # before 5.0 a new material has no nodes
        made.use_nodes = True
    made.node_tree.nodes.clear()
    return made


def set_input(modifier: bpy.types.Modifier, name: str, value: Any) -> None:
    """Sets an input of a modifier's nodes, of which a modifier knows only an identifier."""
    identifier = modifier.node_group.interface.items_tree[name].identifier
    if hasattr(modifier, "properties"):  # since Blender 5.2, which refuses the other way
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value


class Builder:
    """Nodes as expressions: each method adds a node and returns its output socket."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree
        self.is_shader = tree.bl_idname == "ShaderNodeTree"

    def node(self, kind: str) -> Any:
        return self.tree.nodes.new(kind)

    def link(self, source: Any, target: Any) -> None:
        """Connect a socket, or set a constant."""
        if isinstance(source, (int, float, tuple)):
            target.default_value = source
        else:
            self.tree.links.new(source, target)

    def _operation(self, kind: str, operation: str, values: tuple[Any, ...]) -> Any:
        node = self.node(kind)
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            self.link(value, socket)
        return next(socket for socket in node.outputs if socket.enabled)

    def math(self, operation: str, *values: Any) -> Any:
        return self._operation("ShaderNodeMath", operation, values)

    def vector(self, operation: str, *values: Any) -> Any:
        return self._operation("ShaderNodeVectorMath", operation, values)

    def separate(self, value: Any) -> list[Any]:
        node = self.node("ShaderNodeSeparateXYZ")
        self.link(value, node.inputs[0])
        return list(node.outputs)

    def combine(self, *values: Any) -> Any:
        node = self.node("ShaderNodeCombineXYZ")
        for value, socket in zip(values, node.inputs, strict=True):
            self.link(value, socket)
        return node.outputs[0]

    def named(self, name: str, kind: str) -> Any:
        """A Geometry Nodes attribute."""
        node = self.node("GeometryNodeInputNamedAttribute")
        node.data_type = kind
        node.inputs["Name"].default_value = name
        return next(socket for socket in node.outputs if socket.enabled)

    def store(self, geometry: Any, name: str, value: Any) -> Any:
        """Store a vector on the points."""
        node = self.node("GeometryNodeStoreNamedAttribute")
        node.data_type, node.domain = "FLOAT_VECTOR", "POINT"
        node.inputs["Name"].default_value = name
        self.link(geometry, node.inputs["Geometry"])
        self.link(value, next(socket for socket in node.inputs if socket.name == "Value" and socket.enabled))
        return node.outputs[0]

    def attribute(self, name: str, kind: str = "GEOMETRY") -> tuple[Any, Any]:
        """A shader's attribute, of "GEOMETRY" or of the "INSTANCER": its vector and its fourth component."""
        node = self.node("ShaderNodeAttribute")
        node.attribute_type, node.attribute_name = kind, name
        return node.outputs["Vector"], node.outputs["Alpha"]

    def to_object(self, value: Any, kind: str) -> Any:
        node = self.node("ShaderNodeVectorTransform")
        node.vector_type, node.convert_from, node.convert_to = kind, "WORLD", "OBJECT"
        self.link(value, node.inputs[0])
        return node.outputs[0]

    def arrange(self) -> None:
        """Spread the nodes in the order they were made, so that a curious user can read them."""
        for i, node in enumerate(self.tree.nodes):
            node.location = (220.0 * (i // 6), -190.0 * (i % 6))
