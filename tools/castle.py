#!/usr/bin/env python3
"""Writes a castle: thin walls, towers with battlements and a keep, of any number of faces (docs/quality.md, walls and rods).

  castle.py LENGTH OUT.ply      edges are at most LENGTH long: .2 gives 14,340 faces, .065 54,194, .05 77,486

A person would cut it into some fifteen parts. Needs NumPy, manifold3d and trimesh.
"""
import sys

import numpy as np
import trimesh
from manifold3d import Manifold


def box(x, y, z, at):
    return Manifold.cube((x, y, z), True).translate(at)


def cylinder(height, low, high, at, sides=64):
    return Manifold.cylinder(height, low, high, sides).translate(at)


def tower(at):
    body = cylinder(1.5, 0.3, 0.3, (0, 0, 0)) + cylinder(0.25, 0.36, 0.36, (0, 0, 1.4)) - cylinder(1, 0.26, 0.26, (0, 0, 1.5))
    for turn in (0, 60, 120):
        body -= box(1, 0.1, 0.3, (0, 0, 1.65)).rotate((0, 0, turn))
    return body.translate(at)


def castle():
    towers = [tower((x, y, 0)) for x in (-1, 1) for y in (-1, 1)]
    walls = [part for s in (-1, 1) for part in (box(2, 0.2, 1, (0, s, 0.5)), box(0.2, 2, 1, (s, 0, 0.5)))]
    roof = Manifold.cylinder(0.6, 0.65, 0.02, 4).rotate((0, 0, 45)).translate((0, 0, 1.8))
    keep = box(0.8, 0.8, 1.8, (0, 0, 0.9)) + roof
    solid = keep + box(2.2, 2.2, 0.1, (0, 0, 0.05))
    for part in towers + walls:
        solid += part
    return solid - box(0.35, 0.5, 0.5, (0, -1, 0.3))


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    mesh = castle().refine_to_length(float(sys.argv[1])).to_mesh()
    vertices = np.asarray(mesh.vert_properties)[:, :3]
    trimesh.Trimesh(vertices, np.asarray(mesh.tri_verts), process=False).export(sys.argv[2])


if __name__ == "__main__":
    main()
