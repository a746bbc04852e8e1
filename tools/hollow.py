#!/usr/bin/env python3
"""Hollows models as for printing, and compares the parts of hollow and solid (docs/quality.md, closed cavities).

  hollow.py make MESH WALL PREFIX      writes PREFIX-solid.ply and PREFIX-hollow.ply; WALL as a share of the longest side
  hollow.py compare SOLID HOLLOW       of both as cut: 1 − Rand on the outside, and the share of the cavity, by area,
                                       with the label of the nearest face outside

The solid is the zero level of a smoothed distance field on voxels of 1/250 of the longest side, the cavity another level,
wound inward. Needs NumPy, SciPy, scikit-image, trimesh and plyfile.
"""
import sys

import numpy as np

VOXELS = 250


def make(path, wall, prefix):
    import trimesh
    from scipy.ndimage import distance_transform_edt as distance, gaussian_filter
    from skimage.measure import marching_cubes

    mesh = trimesh.load(path, force="mesh")
    mesh.apply_scale(1 / mesh.extents.max())
    inside = np.pad(mesh.voxelized(1 / VOXELS).fill().matrix, 6)
    field = gaussian_filter(distance(inside) - distance(~inside), 1.5) / VOXELS

    def level(depth):
        vertices, faces, _, _ = marching_cubes(field, depth)
        surface = trimesh.Trimesh(vertices, faces)
        if surface.volume < 0:
            surface.invert()
        return surface

    solid, cavity = level(0), level(wall)
    cavity = trimesh.util.concatenate([piece for piece in cavity.split(only_watertight=False) if len(piece.faces) > 200])
    cavity.invert()
    solid.export(f"{prefix}-solid.ply")
    trimesh.util.concatenate([solid, cavity]).export(f"{prefix}-hollow.ply")


def compare(solid, hollow):
    from plyfile import PlyData
    from scipy.spatial import cKDTree

    def read(path):
        ply = PlyData.read(path)
        at = np.c_[tuple(ply["vertex"][axis] for axis in "xyz")][np.vstack(ply["face"]["vertex_indices"])]
        area = np.linalg.norm(np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]), axis=1) / 2
        return np.asarray(ply["face"]["label"]), area, at.mean(axis=1)

    (a, area, _), (b, areas, centres) = read(solid), read(hollow)
    n = len(a)
    both = np.zeros((a.max() + 1, b.max() + 1))
    np.add.at(both, (a, b[:n]), area / area.sum())
    differ = (both.sum(0) ** 2).sum() + (both.sum(1) ** 2).sum() - 2 * (both**2).sum()
    _, nearest = cKDTree(centres[:n]).query(centres[n:])
    alike = (areas[n:] * (b[nearest] == b[n:])).sum() / areas[n:].sum()
    print(f"{len(set(a))} parts solid, {len(set(b))} hollow, 1 - Rand {differ:.3f}, cavity like the outside {alike:.3f}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["make", path, wall, prefix]:
            make(path, float(wall), prefix)
        case ["compare", solid, hollow]:
            compare(solid, hollow)
        case _:
            sys.exit(__doc__)
