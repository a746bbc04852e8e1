#!/usr/bin/env python3
"""How far do stray vertices move the labels of the faces that do not touch them?

    pip install numpy scipy plyfile
    tools/strays.py MESH.ply…
    tools/strays.py --seeds 6 --distances 1e2,1e6,1e30 MESH.ply… [-- OPTIONS of segment]

For each mesh of triangles, seed and number of strays, vertices drawn at random are moved by so many diagonals from the middle, each in
a direction of its own. Parts of both results are matched so that most faces agree; what is told is the share of the faces without a stray
vertex whose part is another. Columns: for each number of strays the median and the greatest share, and the cases within 1 %, of all cases
over seeds; where distances disagree, the worst counts. "Same bytes" says in how many cases all distances gave the same labels.
"""
import argparse
import concurrent.futures
import os
import subprocess
import sys
import tempfile

import numpy as np
from plyfile import PlyData, PlyElement
from scipy.optimize import linear_sum_assignment


def changed(a, b):
    """The share of the faces whose part is another, after the best assignment of parts to each other."""
    k = int(b.max()) + 1
    joint = np.bincount(a.astype(np.int64) * k + b, minlength=(int(a.max()) + 1) * k).reshape(-1, k)
    return 1 - joint[linear_sum_assignment(-joint)].sum() / len(a)


def segment(program, mesh, options):
    """The label of each face."""
    out = mesh + ".npy"
    # One thread each: cases run side by side.
    subprocess.run([program, "segment", mesh, "-q", "--threads", "1", "-o", out, *options], check=True)
    return np.load(out)


class Mesh:
    """A mesh of triangles, and copies of it with strays."""

    def __init__(self, path):
        ply = PlyData.read(path)
        vertex, face = ply["vertex"], ply["face"]
        self.position = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=1)
        self.corner = np.vstack(face[face.properties[0].name]).astype(np.int32)

    def write(self, path, position):
        vertex = np.rec.fromarrays(position.T.astype("<f4"), names="x,y,z")
        face = np.empty(len(self.corner), [("vertex_indices", "<i4", 3)])
        face["vertex_indices"] = self.corner
        elements = [PlyElement.describe(np.asarray(vertex), "vertex"), PlyElement.describe(face, "face")]
        PlyData(elements, byte_order="<").write(path)

    def astray(self, count, distance, seed):
        """Positions with `count` vertices moved, and which faces do not touch them."""
        random = np.random.default_rng([seed, count])
        low, high = self.position.min(0), self.position.max(0)
        chosen = random.choice(np.unique(self.corner), count, replace=False)
        way = random.normal(size=(count, 3))
        way /= np.linalg.norm(way, axis=1)[:, None]
        position = self.position.copy()
        position[chosen] = (low + high) / 2 + way * (distance * np.linalg.norm(high - low))
        return position, ~np.isin(self.corner, chosen).any(1)


def main():
    words = sys.argv[1:]
    cut = words.index("--") if "--" in words else len(words)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+")
    parser.add_argument("--bin", default="target/release/nystrom-stream")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--strays", default="1,10", help="numbers of them")
    parser.add_argument("--distances", default="1e2,1e6,1e30", help="in diagonals")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arg = parser.parse_args(words[:cut])
    options = words[cut + 1:]
    counts = [int(x) for x in arg.strays.split(",")]
    distances = [float(x) for x in arg.distances.split(",")]

    with tempfile.TemporaryDirectory() as folder, concurrent.futures.ThreadPoolExecutor(arg.jobs) as pool:
        def case(mesh, base, name, count, seed):
            found = []
            for distance in distances:
                path = os.path.join(folder, f"{name}-{count}-{seed}-{distance:g}.ply")
                position, untouched = mesh.astray(count, distance, seed)
                mesh.write(path, position)
                found.append(segment(arg.bin, path, options))
                os.remove(path)
            shares = [changed(base[untouched], labels[untouched]) for labels in found]
            return max(shares), all(np.array_equal(found[0], labels) for labels in found)

        head = "".join(f"  {count:>5} {'most':>6} {'<= 1 %':>7}" for count in counts)
        print(f"{'strays':24}{head}")
        every, same = {count: [] for count in counts}, []
        line = lambda shares: f"  {np.median(shares):5.4f} {max(shares):6.4f} {sum(x <= .01 for x in shares):>2} of {len(shares):2}"
        for path in arg.meshes:
            mesh, name = Mesh(path), os.path.splitext(os.path.basename(path))[0]
            original = os.path.join(folder, name + ".ply")
            mesh.write(original, mesh.position)
            base = segment(arg.bin, original, options)
            columns = ""
            for count in counts:
                done = list(pool.map(lambda seed: case(mesh, base, name, count, seed), range(arg.seeds)))
                shares = [share for share, _ in done]
                every[count] += shares
                same += [alike for _, alike in done]
                columns += line(shares)
            print(f"{name[:24]:24}{columns}", flush=True)
        print(f"{'all':24}" + "".join(line(every[count]) for count in counts))
        print("mean " + ", ".join(f"{np.mean(every[count]):.4f} ({count})" for count in counts)
              + f"; same bytes at all distances: {sum(same)} of {len(same)}")


if __name__ == "__main__":
    main()
