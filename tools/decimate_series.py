#!/usr/bin/env python3
"""Series of decimated meshes whose vertices stay where they were, for tools/figure3.rs.

    pip install pymeshlab
    tools/decimate_series.py OUT MESH.ply [MESH.ply …]

For each mesh the folder OUT/NAME gets base.ply, of 8,000 vertices at the most, and 4000.ply to 250.ply. Edges are
collapsed by quadric error as in Garland and Heckbert (1997), onto one of their ends instead of the best place
(optimalplacement=False), so that each vertex of a smaller mesh is one of the base, at the same position to the bit.
Only sizes below the base's are made. About ten seconds a mesh.
"""

import pathlib
import sys

import pymeshlab

BASE = 8000
SIZES = [4000, 2000, 1000, 500, 350, 250]


def collapse(meshes, vertices):
    """Collapses edges until about `vertices` vertices are left."""
    faces = max(4, round(meshes.current_mesh().face_number() * vertices / meshes.current_mesh().vertex_number()))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=faces, optimalplacement=False, preserveboundary=True, preservenormal=True, preservetopology=True,
        autoclean=True)


def series(mesh, out):
    """Writes the series of `mesh` to the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(mesh))
    meshes.meshing_remove_unreferenced_vertices()
    if meshes.current_mesh().vertex_number() > BASE:
        collapse(meshes, BASE)
    meshes.save_current_mesh(str(out / "base.ply"), save_vertex_normal=False, save_vertex_color=False,
                             save_face_color=False, save_vertex_quality=False, save_face_quality=False)
    for size in SIZES:
        if size >= meshes.current_mesh().vertex_number():
            continue
        collapse(meshes, size)
        meshes.save_current_mesh(str(out / f"{size}.ply"), save_vertex_normal=False, save_vertex_color=False,
                                 save_face_color=False, save_vertex_quality=False, save_face_quality=False)


def main():
    """Makes the series of every mesh named on the command line."""
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    for mesh in map(pathlib.Path, sys.argv[2:]):
        series(mesh, pathlib.Path(sys.argv[1]) / mesh.stem)


if __name__ == "__main__":
    main()
