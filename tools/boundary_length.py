#!/usr/bin/env python3
"""How long are the boundaries of parts where the surface is smooth, beside the shortest ones nearby?

  boundary_length.py [--bin PROGRAM] [--band 3] [--crease 8] MESH.ply... [-- OPTIONS of segment]

The boundary of two parts counts if 80 % of its length turns by less than --crease degrees. It is compared with the minimum cut, by
length alone, among the faces at most --band faces from it; where the band ends, and beside a third part, faces keep their part. Both run
along edges of the mesh. A line per mesh: parts, boundaries that count, their length over the shortest. The last line: the same for
all meshes, each scaled to unit area. Needs NumPy, SciPy and plyfile.
"""
import argparse
import os
import subprocess
import sys
import tempfile

import numpy as np
from plyfile import PlyData
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow


class Surface:
    """The dual graph of a triangle mesh of unit area."""

    def __init__(self, path):
        ply = PlyData.read(path)
        points = np.stack([ply["vertex"][axis] for axis in "xyz"], 1).astype(float)
        lists = ply["face"].data
        faces = np.stack(lists[next(name for name in lists.dtype.names if name.startswith("vertex_ind"))])
        across = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
        areas = np.linalg.norm(across, axis=1)
        normals = across / np.maximum(areas, 1e-300)[:, None]
        self.faces = len(faces)
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        owner = np.tile(np.arange(self.faces), 3)
        order = np.lexsort((edges[:, 1], edges[:, 0]))
        twin = np.flatnonzero((edges[order[1:]] == edges[order[:-1]]).all(1))
        self.a, self.b = owner[order[twin]], owner[order[twin + 1]]
        ends = edges[order[twin]]
        self.length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1) / np.sqrt(areas.sum() / 2)
        self.turning = np.degrees(np.arccos(np.clip((normals[self.a] * normals[self.b]).sum(1), -1, 1)))
        both = np.r_[self.a, self.b], np.r_[self.b, self.a]
        self.beside = csr_matrix((np.ones(2 * len(self.a)), both), shape=(self.faces, self.faces))

    def around(self, mask):
        """The faces beside those of `mask`."""
        return self.beside @ mask > 0


def shortest(surface, labels, pair, boundary, band):
    """Lengths of a boundary and of the minimum cut around it; None where its band has no end."""
    near = np.zeros(surface.faces, bool)
    near[surface.a[boundary]] = near[surface.b[boundary]] = True
    for _ in range(band - 1):
        near |= surface.around(near)
    near &= np.isin(labels, pair)
    third = surface.around(~np.isin(labels, pair))
    nodes = np.flatnonzero(near)
    ends = []
    for part in pair:
        beyond = surface.around(~near & (labels == part)) | third
        ends.append(np.flatnonzero(near & (labels == part) & beyond))
    if not all(map(len, ends)):
        return None
    number = np.zeros(surface.faces, int)
    number[nodes] = np.arange(len(nodes))
    source, sink = len(nodes), len(nodes) + 1
    inside = near[surface.a] & near[surface.b]
    scale = 1e6 / surface.length.max()
    lengths = np.round(surface.length[inside] * scale).astype(np.int64)
    i, j = number[surface.a[inside]], number[surface.b[inside]]
    fixed = np.full(sum(map(len, ends)), 10**9)
    rows = np.r_[i, j, np.full(len(ends[0]), source), number[ends[1]]]
    columns = np.r_[j, i, number[ends[0]], np.full(len(ends[1]), sink)]
    graph = csr_matrix((np.r_[lengths, lengths, fixed], (rows, columns)), shape=(sink + 1, sink + 1)).astype(np.int32)
    cut = maximum_flow(graph, source, sink).flow_value
    return np.round(surface.length[boundary & inside] * scale).sum() / scale, cut / scale


def main():
    words, options = sys.argv[1:], []
    if "--" in words:
        words, options = words[: words.index("--")], words[words.index("--") + 1 :]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+")
    parser.add_argument("--bin", default="target/release/nystrom-stream")
    parser.add_argument("--band", type=int, default=3)
    parser.add_argument("--crease", type=float, default=8)
    arg = parser.parse_args(words)
    everything = np.zeros(2)
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "labels.npy")
        for mesh in arg.meshes:
            subprocess.run([arg.bin, "segment", mesh, "-q", "-o", out, *options], check=True)
            labels, surface = np.load(out), Surface(mesh)
            sides = np.sort(np.stack([labels[surface.a], labels[surface.b]], 1), axis=1)
            cut = sides[:, 0] != sides[:, 1]
            sums, count = np.zeros(2), 0
            for pair in np.unique(sides[cut], axis=0):
                boundary = (sides == pair).all(1)
                smooth = boundary & (surface.turning < arg.crease)
                if surface.length[smooth].sum() >= 0.8 * surface.length[boundary].sum() > 0:
                    found = shortest(surface, labels, pair, boundary, arg.band)
                    if found:
                        sums, count = sums + found, count + 1
            everything += sums
            ratio = f"{sums[0] / sums[1]:.3f}" if sums[1] > 0 else "-"
            print(f"{os.path.basename(mesh)[:28]:28} {labels.max() + 1:3} parts  {count:3} boundaries  {ratio}", flush=True)
    print(f"{'all':28} {everything[0] / everything[1]:.3f}" if everything[1] > 0 else "no boundary counts")


if __name__ == "__main__":
    main()
