#!/usr/bin/env python3
"""Opens every form that `segment` writes with the program that people would open it with.

    nystrom-stream segment MESH -o F/out.npy -o F/out.seg -o F/out.ply -o F/out.parquet -o F/out.glb -o F/parts/ \\
        --vertex-labels
    tools/check_formats.py MESH.ply F [COLUMNS]

MESH.ply is a triangle mesh; F/ascii.ply, if it is there, is the same result as text; COLUMNS is how many columns of an
embedding F/out.parquet has. Labels must read back equal from every file. Needs numpy, plyfile, trimesh, pyarrow,
pygltflib and pymeshlab; opens the scene with Khronos' validator too where node finds the package gltf-validator.
"""
import json
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import plyfile
import pyarrow.parquet
import pygltflib
import pymeshlab
import trimesh


def corners(data):
    return np.vstack(data["face"]["vertex_indices"])


def main():
    mesh, folder = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    columns = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    labels = np.load(folder / "out.npy")
    source = plyfile.PlyData.read(mesh)
    vertices = np.column_stack([source["vertex"][axis] for axis in "xyz"]).astype(np.float64)
    faces = corners(source)
    assert len(labels) == len(faces)
    assert (np.loadtxt(folder / "out.seg", dtype=np.uint32) == labels).all(), "numpy: .seg"
    print(f"numpy {np.__version__}: .npy, .seg")

    colours = None
    for name in ["out.ply", "ascii.ply"]:
        path = folder / name
        if not path.exists():
            continue
        data = plyfile.PlyData.read(path)
        assert (data["face"]["label"] == labels).all(), f"plyfile: {name}"
        colours = np.column_stack([data["face"][part] for part in ["red", "green", "blue"]])
        if "scalar_label" in data["vertex"].data.dtype.names:
            check_vertices(faces, labels, data["vertex"]["scalar_label"])
            own = np.column_stack([data["vertex"][part] for part in ["red", "green", "blue"]])
            expected = np.full((data["vertex"]["scalar_label"].max().astype(int) + 2, 3), 128)
            expected[labels] = colours
            assert (own == expected[data["vertex"]["scalar_label"].astype(int)]).all(), f"colours of vertices: {name}"
        loaded = trimesh.load(path, process=False)
        assert (loaded.faces == faces).all(), f"trimesh: {name}"
        if "scalar_label" not in data["vertex"].data.dtype.names:
            assert (loaded.visual.face_colors[:, :3] == colours).all(), f"trimesh: colours of {name}"
        assert (loaded.metadata["_ply_raw"]["face"]["data"]["label"].ravel() == labels).all(), f"trimesh: {name}"
        lab = pymeshlab.MeshSet()
        lab.load_new_mesh(str(path))
        seen = lab.current_mesh()
        assert (seen.face_matrix() == faces).all(), f"pymeshlab: {name}"
        assert (np.rint(seen.face_color_matrix()[:, :3] * 255) == colours).all(), f"pymeshlab: colours of {name}"
        assert np.allclose(seen.face_scalar_array(), data["face"]["quality"]), f"pymeshlab: quality of {name}"
        print(f"plyfile, trimesh {trimesh.__version__}, pymeshlab: {name}")

    table = pyarrow.parquet.ParquetFile(folder / "out.parquet")
    rows = table.read()
    assert (rows["face"].to_numpy() == np.arange(len(faces))).all()
    assert (rows["label"].to_numpy() == labels).all(), "pyarrow: labels"
    assert str(rows["label"].type) == "uint32"
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert np.allclose(rows["area"].to_numpy(), areas), "pyarrow: areas"
    centre = np.column_stack([rows[f"centroid_{axis}"].to_numpy() for axis in "xyz"])
    assert np.allclose(centre, (a + b + c) / 3, atol=1e-9), "pyarrow: centroids"
    assert 0 <= rows["quality"].to_numpy().min() <= rows["quality"].to_numpy().max() <= 1
    assert sum(name.startswith("embedding_") for name in rows.column_names) == columns, rows.column_names
    print(f"pyarrow {pyarrow.__version__}: out.parquet, {table.num_row_groups} row groups")

    check_scene(folder / "out.glb", vertices, faces, labels)
    check_parts(folder / "parts", vertices, faces, labels)


def check_vertices(faces, labels, found):
    """Vertex labels against counts of all faces around each."""
    count = np.zeros((len(found), labels.max() + 1), int)
    for k in range(3):
        np.add.at(count, (faces[:, k], labels), 1)
    kinds = (count > 0).sum(axis=1)
    expected = np.where(kinds > 0, count.argmax(axis=1), -1)
    assert (found == expected)[kinds <= 3].all(), "labels of vertices"


def check_scene(path, vertices, faces, labels):
    gltf = pygltflib.GLTF2().load(str(path))
    blob = gltf.binary_blob()

    def array(number, dtype, width):
        accessor = gltf.accessors[number]
        view = gltf.bufferViews[accessor.bufferView]
        start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
        return np.frombuffer(blob, dtype, accessor.count * width, start).reshape(accessor.count, width)

    move = np.array(gltf.nodes[0].translation or [0, 0, 0])
    named = {gltf.nodes[child].name: gltf.nodes[child] for child in gltf.nodes[0].children}
    assert sorted(named) == sorted(f"part {label}" for label in np.unique(labels)), named
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    for node in named.values():
        label, [primitive] = node.extras["label"], gltf.meshes[node.mesh].primitives
        assert node.name == gltf.meshes[node.mesh].name == f"part {label}"
        assert node.extras["faces"] == (labels == label).sum()
        assert np.isclose(node.extras["area"], areas[labels == label].sum()), "area"
        normals = array(primitive.attributes.NORMAL, "<f4", 3)
        assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5), "normals"
        positions = array(primitive.attributes.POSITION, "<f4", 3)
        assert np.allclose(positions + move, vertices, rtol=1e-6, atol=1e-6 * np.abs(vertices).max())
        found = array(primitive.indices, "<u4", 1).reshape(-1, 3)
        assert (found == faces[labels == label]).all(), f"pygltflib: part {label}"
    scene = trimesh.load(path, process=False)
    assert sum(len(geometry.faces) for geometry in scene.geometry.values()) == len(faces), "trimesh: .glb"
    print(f"pygltflib, trimesh: {path.name}")
    node = shutil.which("node")
    script = ("const v = require('gltf-validator'), fs = require('fs');"
              "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])), {maxIssues: 10}).then("
              "r => console.log(JSON.stringify(r.issues)), e => { console.error(e); process.exit(1); });")
    if node and subprocess.run([node, "-e", "require('gltf-validator')"], capture_output=True).returncode == 0:
        told = subprocess.run([node, "-e", script, str(path)], capture_output=True, text=True, check=True).stdout
        issues = json.loads(told)
        assert issues["numErrors"] == 0 and issues["numWarnings"] == 0, told
        print(f"Khronos' glTF validator: {path.name}")


def check_parts(folder, vertices, faces, labels):
    listed = json.loads((folder / "parts.json").read_text())["parts"]
    seen = np.full(len(faces), -1)
    for part in listed:
        data = plyfile.PlyData.read(folder / part["file"])
        original, own = data["face"]["original_face"], corners(data)
        places = np.column_stack([data["vertex"][axis] for axis in "xyz"])
        assert (places[own] == vertices[faces[original]]).all(), part["file"]
        assert len(np.unique(own)) == len(places) == part["vertices"], "unused vertices"
        assert (data["face"]["label"] == part["label"]).all()
        seen[original] = part["label"]
        loaded = trimesh.load(folder / part["file"], process=False)
        assert len(loaded.faces) == part["faces"]
    assert (seen == labels).all(), "parts"
    print(f"plyfile, trimesh: {len(listed)} files of parts")


if __name__ == "__main__":
    main()
