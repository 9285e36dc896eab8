"""Imports a USD file with Blender's own importer, without the add-on; run by tests in a process of its own.

    python stock_usd_import.py FILE FRAME... OUT.npz

Writes each splat cloud's attributes at each frame of the timeline, as an engine is given them.
"""

import sys
from pathlib import Path

import bpy
import numpy as np


def attributes(obj: bpy.types.Object) -> dict[str, np.ndarray]:
    """All attributes of points, flat."""
    arrays = {}
    for attribute in obj.data.attributes:
        width = {"FLOAT": 1, "FLOAT_VECTOR": 3, "QUATERNION": 4, "FLOAT4": 4, "FLOAT_COLOR": 4}.get(attribute.data_type)
        if width is None or attribute.domain != "POINT":
            continue
        field = {"FLOAT_VECTOR": "vector", "FLOAT4": "vector", "FLOAT_COLOR": "color"}.get(attribute.data_type, "value")
        values = np.empty(width * len(attribute.data), np.float32)
        attribute.data.foreach_get(field, values)
        arrays[attribute.name] = values.reshape(-1, width)
    return arrays


def main(file: str, *rest: str) -> None:
    *frames, out = rest
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.usd_import(filepath=file)
    clouds = [obj for obj in bpy.data.objects if obj.type == "POINTCLOUD"]
    arrays = {}
    for frame in frames:
        whole = int(float(frame))
        bpy.context.scene.frame_set(whole, subframe=float(frame) - whole)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        for obj in clouds:
            evaluated = obj.evaluated_get(depsgraph)
            arrays[f"{frame}/{obj.name}/place"] = np.array(evaluated.matrix_world)
            for name, values in attributes(evaluated).items():
                arrays[f"{frame}/{obj.name}/{name}"] = values
    np.savez(Path(out), **arrays)
    kinds = {getattr(obj.data, "type", "") for obj in clouds}
    names = sorted(obj.name for obj in bpy.data.objects if obj.type == "CAMERA")
    scene = bpy.context.scene
    print(kinds, names, scene.frame_start, scene.frame_end)


if __name__ == "__main__":
    main(*sys.argv[1:])
