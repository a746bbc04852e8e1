#!/usr/bin/env python3
"""Opens what `segment` writes with one program, and compares what arrives there with the labels.

    nystrom-stream segment MESH -o F/plain.ply -o F/out.npy -o F/out.glb -o F/out.parquet -o F/out.csv \\
        -o F/out.obj --work-dir W
    nystrom-stream export --work-dir W --vertex-labels -o F/out.ply
    tools/check_programs.py PROGRAM F

PROGRAM is blender, cloudcompare, open3d, pyvista, trimesh, duckdb or polars. What docs/formats.md says of a program is asserted
here. Exit code 3 says that the program is not there.
"""
import importlib.util
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

MISSING = 3


def need(module):
    if importlib.util.find_spec(module) is None:
        print(f"{module} is not there")
        sys.exit(MISSING)


def read_ply(path):
    """Vertices and faces of a little-endian or text PLY of triangles, as structured arrays; NumPy alone."""
    import numpy as np

    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4", "char": "i1", "short": "<i2"}
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    elements, text = [], False
    for line in data[:end].decode().splitlines():
        words = line.split()
        if words[:2] == ["format", "ascii"]:
            text = True
        elif words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property" and words[1] == "list":
            elements[-1][2].extend([("count", kinds[words[2]]), ("corners", kinds[words[3]], 3)])
        elif words[0] == "property":
            elements[-1][2].append((words[2], kinds[words[1]]))
    found, lines = {}, iter(data[end:].splitlines()) if text else None
    for name, count, fields in elements:
        kind = np.dtype(fields)
        if text:
            rows = []
            for _ in range(count):
                values = iter(next(lines).split())
                rows.append(tuple(
                    tuple(float(next(values)) for _ in range(3)) if len(field) == 3 else float(next(values))
                    for field in fields))
            found[name] = np.array(rows, kind)
        else:
            found[name] = np.frombuffer(data, kind, count, end)
            end += count * kind.itemsize
    return found["vertex"], found["face"]


def colours_of(records):
    import numpy as np

    return np.column_stack([records[part] for part in ["red", "green", "blue"]])


def blender(folder):
    need("bpy")
    import bpy
    import numpy as np

    vertices, faces = read_ply(folder / "out.ply")
    labels = np.load(folder / "out.npy")

    def opened(name, **options):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.ply_import(filepath=str(folder / name), import_attributes=True, **options)
        return bpy.context.object.data

    mesh = opened("plain.ply")
    assert len(mesh.polygons) == len(faces) and len(mesh.color_attributes) == 0, "plain: faces, and no colours"
    mesh = opened("out.ply", import_colors="SRGB")
    assert len(mesh.polygons) == len(faces)
    field = np.empty(len(vertices), np.float32)
    mesh.attributes["scalar_label"].data.foreach_get("value", field)
    assert (field == vertices["scalar_label"]).all(), "scalar_label"
    layer = mesh.color_attributes[0]
    assert layer.domain == "POINT"
    seen = np.empty(4 * len(vertices), np.float32)
    layer.data.foreach_get("color_srgb", seen)
    assert np.abs(seen.reshape(-1, 4)[:, :3] * 255 - colours_of(vertices)).max() < 1.01, "colours of vertices"

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(folder / "out.glb"))
    parts = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    assert sorted(part.name for part in parts) == sorted(f"part {label}" for label in np.unique(labels)), "an object each"
    for part in parts:
        label = int(part["label"])
        assert part.name == f"part {label}" and len(part.data.polygons) == (labels == label).sum() == part["faces"]
        area = sum(polygon.area for polygon in part.data.polygons)
        assert abs(area - part["area"]) < 1e-4 * area, "area"
        assert [material.name for material in part.data.materials] == [part.name]
        assert part.data.has_custom_normals, "normals"
        assert part.parent.name == "parts"

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.obj_import(filepath=str(folder / "out.obj"))
    groups = {thing.name: thing for thing in bpy.data.objects if thing.type == "MESH"}
    assert len(groups) == len(parts) == len(np.unique(labels))
    for label in np.unique(labels):
        thing = groups[f"part_{label}"]
        assert len(thing.data.polygons) == (labels == label).sum(), label
        assert [material.name for material in thing.data.materials] == [f"part_{label}"]
    print(f"Blender {bpy.app.version_string}: .ply, .glb and .obj with {len(parts)} objects")


def cloudcompare(folder):
    need("numpy")
    import numpy as np

    program = shutil.which("CloudCompare") or shutil.which("cloudcompare.CloudCompare")
    if program is None:
        print("CloudCompare is not there")
        sys.exit(MISSING)
    with tempfile.TemporaryDirectory() as work:
        for name in ["plain.ply", "out.ply"]:
            copy = pathlib.Path(work) / name
            shutil.copy(folder / name, copy)
            words = [program, "-SILENT", "-O", copy, "-M_EXPORT_FMT", "PLY", "-PLY_EXPORT_FMT", "ASCII",
                     "-NO_TIMESTAMP", "-SAVE_MESHES"]
            # What it has understood it writes over the copy.
            subprocess.run(words, check=True, capture_output=True, env={**os.environ, "QT_QPA_PLATFORM": "offscreen"})
            vertices, faces = read_ply(copy)
            expected, all_faces = read_ply(folder / name)
            assert b"CloudCompare" in copy.read_bytes()[:200] and (faces["corners"] == all_faces["corners"]).all()
            if name == "plain.ply":
                assert set(vertices.dtype.names) == {"x", "y", "z"}, "colours of faces are dropped"
                continue
            assert (colours_of(vertices) == colours_of(expected)).all(), "colours"
            assert (vertices["scalar_label"] == expected["scalar_label"]).all(), "scalar field"
    print("CloudCompare: colours and the scalar field of out.ply; of plain.ply the shape alone")


def open3d(folder):
    need("open3d")
    import numpy as np
    import open3d

    vertices, faces = read_ply(folder / "out.ply")
    mesh = open3d.io.read_triangle_mesh(str(folder / "out.ply"))
    assert (np.asarray(mesh.triangles) == faces["corners"]).all()
    assert (np.rint(np.asarray(mesh.vertex_colors) * 255) == colours_of(vertices)).all(), "colours of vertices"
    assert not open3d.io.read_triangle_mesh(str(folder / "plain.ply")).has_vertex_colors()
    print(f"Open3D {open3d.__version__}: colours of vertices")


def pyvista(folder):
    need("pyvista")
    import numpy as np
    import pyvista

    vertices, faces = read_ply(folder / "out.ply")
    plain, both = (pyvista.read(folder / name) for name in ["plain.ply", "out.ply"])
    for mesh in [plain, both]:
        assert (mesh.cell_data["RGB"] == colours_of(faces)).all(), "colours of faces"
        assert "label" not in mesh.cell_data, "labels come from .npy"
    assert (both.point_data["RGB"] == colours_of(vertices)).all(), "colours of vertices"
    plain.cell_data["label"] = np.load(folder / "out.npy")
    assert len(np.unique(plain.threshold(0.5, scalars="label").cell_data["label"])) == plain["label"].max()
    print(f"PyVista {pyvista.__version__}: RGB of faces and of vertices")


def trimesh(folder):
    need("trimesh")
    import numpy as np
    import trimesh

    vertices, faces = read_ply(folder / "out.ply")
    labels = np.load(folder / "out.npy")
    plain, both = (trimesh.load(folder / name, process=False) for name in ["plain.ply", "out.ply"])
    assert (plain.visual.face_colors[:, :3] == colours_of(faces)).all(), "colours of faces"
    assert (both.visual.vertex_colors[:, :3] == colours_of(vertices)).all(), "colours of vertices"
    scene = trimesh.load(folder / "out.glb", process=False)
    for label in np.unique(labels):
        assert len(scene.geometry[f"part {label}"].faces) == (labels == label).sum(), label
    print(f"trimesh {trimesh.__version__}: .ply, .glb with {len(scene.geometry)} geometries")


def duckdb(folder):
    need("duckdb")
    import duckdb
    import numpy as np

    labels = np.load(folder / "out.npy")
    rows = duckdb.sql(f"select label, count(*) as faces, sum(area) as area from '{folder}/out.parquet' "
                      "group by label order by label").fetchall()
    assert [row[:2] for row in rows] == [(int(label), int((labels == label).sum())) for label in np.unique(labels)]
    table = duckdb.sql(f"select label, faces, area from '{folder}/out.csv' order by label").fetchall()
    assert [row[:2] for row in table] == [row[:2] for row in rows]
    assert all(abs(a[2] - b[2]) < 1e-4 * b[2] for a, b in zip(rows, table)), "areas of both tables"
    print(f"DuckDB {duckdb.__version__}: .parquet, .csv")


def polars(folder):
    need("polars")
    import numpy as np
    import polars

    labels = np.load(folder / "out.npy")
    frame = polars.read_parquet(folder / "out.parquet")
    assert (frame["label"].to_numpy() == labels).all()
    table = polars.read_csv(folder / "out.csv")
    assert table["faces"].to_list() == [int((labels == label).sum()) for label in range(labels.max() + 1)]
    assert table.columns[:4] == ["label", "faces", "area", "volume"]
    print(f"Polars {polars.__version__}: .parquet, .csv")


if __name__ == "__main__":
    programs = {known.__name__: known for known in [blender, cloudcompare, open3d, pyvista, trimesh, duckdb, polars]}
    programs[sys.argv[1]](pathlib.Path(sys.argv[2]))
