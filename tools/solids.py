#!/usr/bin/env python3
"""Writes solids as CAD exports them, in few long triangles, and the same in short ones (docs/quality.md, long triangles).

  solids.py FOLDER      writes NAME.ply and NAME_fine.ply of each

A person would cut both of a pair alike. To compare: segment both, carry the labels with `transfer-labels
NAME_labelled.ply NAME_fine.ply -o labels/NAME_fine.seg`, and score them against those of NAME_fine.ply with `evaluate`.
Needs NumPy, manifold3d and trimesh.
"""
import pathlib
import sys

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold


def box(x, y, z, at=(0, 0, 0)):
    return Manifold.cube((x, y, z), True).translate(at)


def cylinder(height, radius, at=(0, 0, 0), sides=96, turned=(0, 0, 0)):
    return Manifold.cylinder(height, radius, radius, sides, True).rotate(turned).translate(at)


def joined(first, *others):
    for other in others:
        first += other
    return first


def hinge():
    leaves = [box(1, 1.5, 0.06, (side * 0.55, 0, 0)) for side in (-1, 1)]
    knuckles = [cylinder(0.29, 0.12, (0, -0.6 + 0.3 * i, 0.06), 64, (90, 0, 0)) for i in range(5)]
    solid = joined(*leaves, *knuckles, cylinder(1.6, 0.06, (0, 0, 0.06), turned=(90, 0, 0)))
    holes = [cylinder(1, 0.07, (x, y, 0), 40) for x in (-0.75, 0.75) for y in (-0.5, 0, 0.5)]
    return solid - joined(*holes)


def gear(teeth=16, hub=0.3):
    turn = 2 * np.pi / teeth
    outline = [(r * np.cos((i + f) * turn), r * np.sin((i + f) * turn)) for i in range(teeth)
               for f, r in ((0, 0.8), (0.25, 0.8), (0.35, 1), (0.65, 1), (0.75, 0.8))]
    disc = Manifold.extrude(CrossSection([np.array(outline)]), 0.25)
    return (disc + cylinder(0.4, hub, (0, 0, 0.125)) if hub else disc) - cylinder(2, 0.15)


def sprocket():
    return gear(hub=None)


def fine_gear():
    return gear(24)


def heatsink():
    return joined(box(2, 1.4, 0.15), *[box(0.06, 1.4, 0.8, (-0.95 + 0.19 * i, 0, 0.45)) for i in range(11)])


def comb():
    return joined(box(2, 0.3, 0.1, (0, 0.15, 0)), *[box(0.07, 0.7, 0.08, (-0.95 + 0.135 * i, -0.3, 0)) for i in range(15)])


def nut():
    return cylinder(0.5, 0.6, sides=6) - cylinder(3, 0.33)


def crown(points=9):
    ring = cylinder(0.5, 0.8, (0, 0, 0.25)) - cylinder(3, 0.72)
    point = Manifold.extrude(CrossSection([np.array([(-0.2, 0), (0.2, 0), (0, 0.5)])]), 0.08)
    point = point.rotate((90, 0, 90)).translate((0.72, 0, 0.48)) + Manifold.sphere(0.07, 48).translate((0.76, 0, 1))
    return joined(ring, *[point.rotate((0, 0, 360 / points * i)) for i in range(points)])


def bricks():
    shell = box(1.6, 0.8, 0.5) - box(1.5, 0.7, 0.5, (0, 0, -0.06))
    studs = [cylinder(0.1, 0.13, (-0.6 + 0.4 * i, -0.2 + 0.4 * j, 0.295), 64) for i in range(4) for j in range(2)]
    tubes = [cylinder(0.45, 0.14, (-0.4 + 0.4 * i, 0, -0.025), 64) - cylinder(2, 0.1, (-0.4 + 0.4 * i, 0, -0.7), 64)
             for i in range(3)]
    return joined(shell, *studs, *tubes)


def pipes():
    tube, disc = 0.25, 0.42
    ends = [(-1, 0, 1.46), (1, 0, 1.46)]
    solid = cylinder(4, tube, turned=(0, 90, 0)) + cylinder(1.5, tube, (0, -0.75, 0), turned=(90, 0, 0))
    solid += joined(*[cylinder(1.5, tube, (x, 0, 0.75)) + cylinder(0.12, disc, (x, y, z)) for x, y, z in ends])
    solid += joined(*[cylinder(0.12, disc, (x, 0, 0), turned=(0, 90, 0)) for x in (-2, 2)])
    return solid + cylinder(0.12, disc, (0, -1.46, 0), turned=(90, 0, 0))


def table():
    return joined(box(2, 1.2, 0.08), *[cylinder(1, 0.06, (x, y, -0.5), 32) for x in (-0.9, 0.9) for y in (-0.5, 0.5)])


def blind_holes():
    return box(4, 4, 1) - joined(*[cylinder(1, 0.6, (x, y, 0.4), 64) for x in (-1, 1) for y in (-1, 1)])


def pocket():
    return box(4, 3, 1) - box(2, 1.5, 1, (0, 0, 0.4))


def bore():
    return cylinder(2, 1.5) - cylinder(1, 1, (0, 0, 0.7)) - cylinder(2, 0.5, (0, 0, 0.2))


def moulding():
    shell = box(4, 2, 1.2) - box(3.7, 1.7, 1.2, (0, 0, -0.15))
    return joined(shell, *[cylinder(0.3, 0.3, (-1.5 + i, -0.5 + j, 0.7), 64) for i in range(4) for j in range(2)])


def pits():
    pit = [box(1, 1, 1, (x, y, 0.5)) for x in (-1, 1) for y in (-1, 1)]
    return box(4.8, 4.8, 1.4) - joined(*pit)


SOLIDS = {"hinge": (hinge, 0.015), "gear": (gear, 0.014), "heatsink": (heatsink, 0.025), "comb": (comb, 0.015),
          "nut": (nut, 0.015), "crown": (crown, 0.014), "bricks": (bricks, 0.013), "pipes": (pipes, 0.022),
          "table": (table, 0.02),
          "sprocket": (sprocket, 0.014), "fine_gear": (fine_gear, 0.014), "blind_holes": (blind_holes, 0.06),
          "pocket": (pocket, 0.06), "bore": (bore, 0.06), "pits": (pits, 0.06), "moulding": (moulding, 0.06)}


def write(solid, path):
    mesh = solid.to_mesh()
    vertices = np.asarray(mesh.vert_properties)[:, :3]
    trimesh.Trimesh(vertices, np.asarray(mesh.tri_verts), process=False).export(path)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = pathlib.Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, (solid, length) in SOLIDS.items():
        write(solid(), folder / f"{name}.ply")
        write(solid().refine_to_length(length), folder / f"{name}_fine.ply")


if __name__ == "__main__":
    main()
