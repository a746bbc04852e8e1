#!/usr/bin/env python3
"""Decimates meshes to a given number of faces, by quadric edge collapse.

    pip install numpy plyfile fast-simplification      # --meshlab: pip install pymeshlab
    tools/decimate.py 4000 OUT a.ply b.ply …           # OUT/a.ply, OUT/b.ply, … with 4,000 faces each
    tools/decimate.py --psb FOLDER 4000 OUT            # the twelve meshes of docs/dev/sampling-and-kernels.md

The twelve: the first model of at least 6,000 faces of each of the first twelve categories of the Princeton Segmentation
Benchmark that have one. A target that cannot be met is missed by a face or two.
"""

import argparse
import csv
from pathlib import Path


def twelve(folder: Path) -> list[Path]:
    chosen = {}
    with open(folder / "models.tsv") as table:
        for row in csv.DictReader(table, delimiter="\t"):
            if int(row["faces"]) >= 6000:
                chosen.setdefault(row["category"], folder / f"{row['model']}.ply")
    return list(chosen.values())[:12]


def by_meshlab(mesh: Path, faces: int, out: Path) -> int:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(mesh))
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=faces)
    meshes.save_current_mesh(str(out), save_vertex_normal=False)
    return meshes.current_mesh().face_number()


def by_fast_simplification(mesh: Path, faces: int, out: Path) -> int:
    import fast_simplification
    import numpy as np
    import plyfile

    source = plyfile.PlyData.read(str(mesh))
    vertex = source["vertex"]
    points = np.column_stack([vertex["x"], vertex["y"], vertex["z"]]).astype(np.float32)
    corners = np.vstack(source["face"].data[source["face"].properties[0].name]).astype(np.int32)
    points, corners = fast_simplification.simplify(points, corners, target_count=faces)
    vertices = np.array([tuple(p) for p in points], dtype=[("x", "f4"), ("y", "f4"), ("z", "f4")])
    lists = np.empty(len(corners), dtype=[("vertex_indices", "i4", (3,))])
    lists["vertex_indices"] = corners
    elements = [plyfile.PlyElement.describe(vertices, "vertex"), plyfile.PlyElement.describe(lists, "face")]
    plyfile.PlyData(elements, byte_order="<").write(str(out))
    return len(corners)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--psb", type=Path, metavar="FOLDER")
    parser.add_argument("--meshlab", action="store_true", help="MeshLab's, with its defaults")
    parser.add_argument("faces", type=int)
    parser.add_argument("out", type=Path)
    parser.add_argument("meshes", type=Path, nargs="*")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    decimate = by_meshlab if args.meshlab else by_fast_simplification
    for mesh in (twelve(args.psb) if args.psb else []) + args.meshes:
        print(mesh.name, decimate(mesh, args.faces, args.out / (mesh.stem + ".ply")), flush=True)


if __name__ == "__main__":
    main()
