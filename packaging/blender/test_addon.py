#!/usr/bin/env python3
"""Tries the add-on with Blender as a module (`bpy`) and the wheel: `test_addon.py [MESH.ply]`."""
import pathlib
import sys

import bpy
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import nystrom_stream_parts as addon  # noqa: E402


def check(parts):
    thing = bpy.context.object
    mesh = thing.data
    before = len(mesh.polygons)
    assert bpy.ops.mesh.cut_into_parts(parts=parts) == {"FINISHED"}
    labels = np.empty(len(mesh.polygons), np.int32)
    mesh.attributes["label"].data.foreach_get("value", labels)
    found = labels.max() + 1
    assert len(mesh.polygons) == before and (parts == 0 or found == parts), found
    assert [group.name for group in thing.vertex_groups] == [f"part {k}" for k in range(found)]
    assert len(mesh.materials) == found
    index = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", index)
    assert (index == labels).all()
    for k in range(found):
        own = {v for polygon in mesh.polygons if labels[polygon.index] == k for v in polygon.vertices}
        group = thing.vertex_groups[k].index
        assert own == {v.index for v in mesh.vertices if any(member.group == group for member in v.groups)}, k
    return found


addon.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
addon.unregister()
addon.register()
bpy.ops.mesh.primitive_monkey_add()  # triangles and quads
assert {len(polygon.vertices) for polygon in bpy.context.object.data.polygons} == {3, 4}
counts = [check(3), check(0)]
if len(sys.argv) > 1:
    bpy.ops.wm.ply_import(filepath=sys.argv[1])
    counts += [check(5), check(0)]
bpy.ops.mesh.primitive_plane_add()
try:
    bpy.ops.mesh.cut_into_parts(parts=9)
    raise AssertionError("one face in nine parts")
except RuntimeError as error:
    assert "fewer than the 9 parts" in str(error), error
print(f"Blender {bpy.app.version_string}: the add-on cut meshes into {counts} parts")
