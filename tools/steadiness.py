#!/usr/bin/env python3
"""How far do the parts of a mesh depend on the seed? Cuts each mesh under several seeds, and compares every two results.

  steadiness.py [--bin PROGRAM] [--seeds 8] MESH... [-- OPTIONS of segment]
  steadiness.py --large .02 [--against "--exact"] [--against-seeds 2] MESH...

A line per mesh: 1 - Rand over pairs of faces between two seeds, mean and greatest; seconds of a run, and of processor time; parts
under each seed. The last line has the means over the meshes. Needs NumPy.

With `--large`, what is compared are large parts, by area: a part below this share of the area joins the neighbour with which it has the
longest boundary, smallest first. `against` is 1 - Rand between the results and those with other options (`--against`) under the first
seeds, mean and greatest; `true` that to the parts of NAME.truth.npy beside NAME.ply, where there are any. Needs plyfile too, and
meshes that are PLY of triangles.
"""
import argparse
import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np


def rand_distance(a, b, weight=None):
    """1 - Rand index over pairs of faces, or of points where each face has a `weight`."""
    square = lambda counts: np.square(counts.astype(float)).sum()
    joint = a.astype(np.int64) * (int(b.max()) + 1) + b
    sums = [square(np.bincount(labels, weight)) for labels in (a, b, joint)]
    pairs = len(a) * (len(a) - 1.0) if weight is None else weight.sum() ** 2
    return (sums[0] + sums[1] - 2 * sums[2]) / pairs


class Surface:
    """Areas and normals of triangles, and the edges that two of them share."""

    def __init__(self, path):
        from plyfile import PlyData

        ply = PlyData.read(path, known_list_len={"face": {"vertex_indices": 3}})
        position = np.stack([np.asarray(ply["vertex"][axis], float) for axis in "xyz"], axis=1)
        corner = np.asarray(ply["face"]["vertex_indices"])
        if corner.ndim == 1:
            # Of text, lists come one by one.
            corner = np.stack(corner)
        a, b, c = (position[corner[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        twice = np.linalg.norm(across, axis=1)
        self.area, self.normal = twice / 2, across / np.maximum(twice, 1e-300)[:, None]
        n = len(corner)
        ends = np.concatenate([np.sort(corner[:, [k, (k + 1) % 3]], axis=1) for k in range(3)]).astype(np.int64)
        key = ends[:, 0] * len(position) + ends[:, 1]
        order = np.argsort(key, kind="stable")
        twin = np.flatnonzero(key[order][1:] == key[order][:-1])
        self.pairs = np.stack([order[twin] % n, order[twin + 1] % n])
        first = ends[order[twin]]
        self.length = np.linalg.norm(position[first[:, 0]] - position[first[:, 1]], axis=1)

    def large(self, labels, share):
        """The parts of `share` of the area and more; each smaller one joins the neighbour with the longest common boundary."""
        k = int(labels.max()) + 1
        area = np.bincount(labels, self.area, k)
        i, j = labels[self.pairs].astype(np.int64)
        apart = i != j
        border = np.bincount(i[apart] * k + j[apart], self.length[apart], k * k).reshape(k, k)
        border = border + border.T
        into, limit = np.arange(k), share * self.area.sum()
        open_ = area < limit
        while open_.any():
            small = min(np.flatnonzero(open_), key=lambda part: area[part])
            open_[small] = False
            to = int(border[small].argmax())
            if border[small, to] > 0:
                area[to] += area[small]
                open_[to] &= area[to] < limit
                into[into == small] = to
                border[to] += border[small]
                border[:, to] += border[:, small]
                border[small] = border[:, small] = border[to, to] = 0
        return np.unique(into[labels], return_inverse=True)[1]


class Cuts:
    """Cuts a mesh under several seeds."""

    def __init__(self, program, mesh, seeds, options, out):
        self.labels, start, used = [], time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        for seed in range(seeds):
            command = [program, "segment", mesh, "-q", "--seed", str(seed), "-o", out, *options]
            subprocess.run(command, check=True)
            self.labels.append(np.load(out))
        self.seconds = (time.monotonic() - start) / max(seeds, 1)
        self.processor = (resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - used) / max(seeds, 1)


def split_words():
    """The words of the command line, and those after `--`."""
    words, options = sys.argv[1:], []
    if "--" in words:
        words, options = words[: words.index("--")], words[words.index("--") + 1 :]
    return words, options


def main():
    words, options = split_words()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+")
    parser.add_argument("--bin", default="target/release/nystrom-stream")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--large", type=float, default=0, metavar="SHARE")
    parser.add_argument("--against", type=str.split, metavar="OPTIONS")
    parser.add_argument("--against-seeds", type=int, default=2, metavar="N")
    arg = parser.parse_args(words)
    if arg.against and not arg.large:
        parser.error("--against needs --large")
    means = []
    head = f"{'mesh':28} {'mean':>6} {'most':>6} {'seconds':>8} {'user':>8}"
    print(head + (f" {'true':>6} {'most':>6} {'against':>7} {'most':>6}" if arg.large else "") + "  parts")
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "labels.npy")
        for mesh in arg.meshes:
            cuts = Cuts(arg.bin, mesh, arg.seeds, options, out)
            surface = Surface(mesh) if arg.large else None
            large = lambda labels: surface.large(labels, arg.large)
            found = [large(labels) for labels in cuts.labels] if surface else cuts.labels
            distance = lambda a, b: rand_distance(a, b, surface.area if surface else None)
            apart = [distance(a, b) for a, b in itertools.combinations(found, 2)] or [0.0]
            columns = [np.mean(apart), max(apart)]
            if surface:
                truth = os.path.splitext(mesh)[0] + ".truth.npy"
                true = [distance(a, np.load(truth)) for a in found] if os.path.exists(truth) else [np.nan]
                other = [np.nan]
                if arg.against:
                    others = Cuts(arg.bin, mesh, arg.against_seeds, [*options, *arg.against], out)
                    other = [distance(a, large(b)) for a in found for b in others.labels]
                columns += [np.mean(true), max(true), np.mean(other), max(other)]
            means.append(columns)
            parts = " ".join(str(int(labels.max()) + 1) for labels in found)
            text = [f"{x:6.4f}" for x in columns]
            text[2:2] = [f"{cuts.seconds:8.2f}", f"{cuts.processor:8.2f}"]
            print(f"{os.path.basename(mesh)[:28]:28} {' '.join(text)}  {parts}", flush=True)
    # Without `--against` or true parts a column has no figures.
    known = [[x for x in column if not np.isnan(x)] or [np.nan] for column in zip(*means)]
    print(f"{'mean':28} " + " ".join(f"{np.mean(column):6.4f}" for column in known))


if __name__ == "__main__":
    main()
