"""Cut meshes into parts: an add-on of one file over the Python package.

Install the wheel into Blender's own Python (its `python -m pip install nystrom_stream-….whl`), then this file by Edit, Preferences,
Add-ons, Install from Disk. Select a mesh, then Object, Cut into parts: each part becomes a vertex group, a material and a value of
the face attribute `label`.
"""

bl_info = {
    "name": "Cut into parts",
    "description": "Cut meshes into their meaningful parts with nystrom-stream",
    "author": "The nystrom-stream developers",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "View3D > Object > Cut into parts",
    "category": "Mesh",
}

import bpy  # noqa: E402
import numpy as np  # noqa: E402

ATTRIBUTE = "label"


def polygons_of(mesh):
    """Positions (v, 3) and the corners of each polygon."""
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    totals = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_total", totals)
    vertices = vertices.reshape(-1, 3)
    if len(totals) and (totals == totals[0]).all():
        return vertices, corners.reshape(len(totals), totals[0])
    return vertices, [part.tolist() for part in np.split(corners, np.cumsum(totals)[:-1])]


def show(thing, cut):
    """Leaves the parts of `cut` on the object `thing`."""
    mesh = thing.data
    layer = mesh.attributes.get(ATTRIBUTE)
    if layer is not None and (layer.domain != "FACE" or layer.data_type != "INT"):
        mesh.attributes.remove(layer)
        layer = None
    if layer is None:
        layer = mesh.attributes.new(ATTRIBUTE, "INT", "FACE")
    layer.data.foreach_set("value", cut.labels.astype(np.int32))
    for group in [group for group in thing.vertex_groups if group.name.startswith("part ")]:
        thing.vertex_groups.remove(group)
    mesh.materials.clear()
    totals = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_total", totals)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    of_corner = np.repeat(cut.labels, totals)
    for part, colour in enumerate(cut.colours / 255.0):
        name = f"part {part}"
        group = thing.vertex_groups.new(name=name)
        group.add(np.unique(corners[of_corner == part]).tolist(), 1.0, "REPLACE")
        material = bpy.data.materials.new(name)
        # Materials hold linear light, colours of parts are sRGB.
        linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
        material.diffuse_color = (*linear, 1.0)
        if material.node_tree is None and hasattr(material, "use_nodes"):
            material.use_nodes = True
        for node in material.node_tree.nodes if material.node_tree else []:
            if node.type == "BSDF_PRINCIPLED":
                node.inputs["Base Color"].default_value = (*linear, 1.0)
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", cut.labels.astype(np.int32))
    mesh.update()


class MESH_OT_cut_into_parts(bpy.types.Operator):
    """Cut the active mesh into its meaningful parts"""

    bl_idname = "mesh.cut_into_parts"
    bl_label = "Cut into parts"
    bl_options = {"REGISTER", "UNDO"}

    parts: bpy.props.IntProperty(name="Parts", description="How many; 0: as many as are found", default=0, min=0)
    detail: bpy.props.FloatProperty(name="Detail", description="Coarser or finer", default=0.0, min=-1.0, max=1.0)

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "MESH" and context.object.mode == "OBJECT"

    def execute(self, context):
        try:
            import nystrom_stream
        except ImportError:
            self.report({"ERROR"}, "install the package nystrom-stream into Blender's Python first")
            return {"CANCELLED"}
        options = {"parts": self.parts} if self.parts else {"detail": self.detail}
        try:
            cut = nystrom_stream.segment(*polygons_of(context.object.data), **options)
        except (ValueError, MemoryError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        show(context.object, cut)
        self.report({"INFO"}, f"{cut.n_parts} parts")
        return {"FINISHED"}


def draw(menu, _context):
    menu.layout.operator(MESH_OT_cut_into_parts.bl_idname)


def register():
    bpy.utils.register_class(MESH_OT_cut_into_parts)
    bpy.types.VIEW3D_MT_object.append(draw)


def unregister():
    bpy.types.VIEW3D_MT_object.remove(draw)
    bpy.utils.unregister_class(MESH_OT_cut_into_parts)


if __name__ == "__main__":
    register()
