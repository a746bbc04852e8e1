#!/usr/bin/env python3
"""How long are the boundaries of parts where the surface is smooth, beside the shortest ones nearby?

  boundary_length.py [--bin PROGRAM] [--band 3] [--crease 8] MESH.ply... [-- OPTIONS of segment]

The boundary of two parts counts if 80 % of its length turns by less than --crease degrees. It is compared with the minimum cut, by
length alone, among the faces at most --band faces from it; where the band ends, and beside a third part, faces keep their part. Both run
along edges of the mesh. A line per mesh: parts, boundaries that count, their length over the shortest; then the same boundaries with
--split-faces, which cross faces, over the shortest along edges, and all boundaries with --split-faces over those without. The last line:
the same for all meshes, each scaled to unit area. Needs NumPy, SciPy and plyfile, and
meshes that are PLY of triangles.
"""
import argparse
import os
import subprocess
import tempfile

import numpy as np
from plyfile import PlyData
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow

from steadiness import Surface, split_words


class DualGraph(Surface):
    """The dual graph of a triangle mesh of unit area."""

    def __init__(self, path):
        super().__init__(path)
        self.faces = len(self.area)
        self.a, self.b = self.pairs
        self.length /= np.sqrt(self.area.sum())
        cosine = (self.normal[self.a] * self.normal[self.b]).sum(1)
        self.turning = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
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


def ratios(sums):
    """Smooth boundaries over the shortest, along edges and across faces; all boundaries across faces over those along edges."""
    over = lambda a, b: f"{a / b:.3f}" if b > 0 else "-"
    return f"{over(sums[0], sums[1])}  split {over(sums[2], sums[1])}  all {over(sums[4], sums[3])}"


def sides(surface, labels):
    """The two parts of each edge, the lower one first."""
    return np.sort(np.stack([labels[surface.a], labels[surface.b]], 1), axis=1)


def main():
    words, options = split_words()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+")
    parser.add_argument("--bin", default="target/release/nystrom-stream")
    parser.add_argument("--band", type=int, default=3)
    parser.add_argument("--crease", type=float, default=8)
    arg = parser.parse_args(words)
    # Of boundaries that count: length, shortest, length where faces are split; of all: length, and where faces are split.
    everything = np.zeros(5)
    with tempfile.TemporaryDirectory() as folder:
        out, cross = (os.path.join(folder, name) for name in ("labels.npy", "split.ply"))
        for mesh in arg.meshes:
            subprocess.run([arg.bin, "segment", mesh, "-q", "-o", out, *options], check=True)
            labels, surface = np.load(out), DualGraph(mesh)
            subprocess.run([arg.bin, "segment", mesh, "-q", "--split-faces", "-o", cross, *options], check=True)
            split = DualGraph(cross)
            beside = sides(surface, labels)
            across = sides(split, np.asarray(PlyData.read(cross)["face"]["label"]))
            cut, cut_across = (parts[:, 0] != parts[:, 1] for parts in (beside, across))
            sums, count = np.zeros(5), 0
            sums[3:] = surface.length[cut].sum(), split.length[cut_across].sum()
            for pair in np.unique(beside[cut], axis=0):
                boundary = (beside == pair).all(1)
                smooth = boundary & (surface.turning < arg.crease)
                if surface.length[smooth].sum() >= 0.8 * surface.length[boundary].sum() > 0:
                    found = shortest(surface, labels, pair, boundary, arg.band)
                    if found:
                        sums[:2], count = sums[:2] + found, count + 1
                        sums[2] += split.length[(across == pair).all(1)].sum()
            everything += sums
            line = f"{os.path.basename(mesh)[:28]:28} {labels.max() + 1:3} parts  {count:3} boundaries"
            print(line, ratios(sums), flush=True)
    print(f"{'all':28}", ratios(everything))


if __name__ == "__main__":
    main()
