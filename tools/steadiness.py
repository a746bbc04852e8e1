#!/usr/bin/env python3
"""How far do the parts of a mesh depend on the seed? Cuts each mesh under several seeds, and compares every two results.

  steadiness.py [--bin PROGRAM] [--seeds 8] MESH... [-- OPTIONS of segment]

A line per mesh: 1 - Rand over pairs of faces between two seeds, mean and greatest; parts under each seed; seconds of a run. The last
line has the mean over the meshes. Needs NumPy.
"""
import argparse
import itertools
import os
import subprocess
import sys
import tempfile
import time

import numpy as np


def rand_distance(a, b):
    """1 - Rand index over pairs of faces."""
    square = lambda counts: np.square(counts.astype(float)).sum()
    joint = np.bincount(a.astype(np.int64) * (int(b.max()) + 1) + b)
    n = len(a)
    return (square(np.bincount(a)) + square(np.bincount(b)) - 2 * square(joint)) / (n * (n - 1.0))


def main():
    words, options = sys.argv[1:], []
    if "--" in words:
        words, options = words[: words.index("--")], words[words.index("--") + 1 :]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+")
    parser.add_argument("--bin", default="target/release/nystrom-stream")
    parser.add_argument("--seeds", type=int, default=8)
    arg = parser.parse_args(words)
    means = []
    print(f"{'mesh':28} {'mean':>6} {'most':>6} {'seconds':>8}  parts")
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "labels.npy")
        for mesh in arg.meshes:
            found, start = [], time.monotonic()
            for seed in range(arg.seeds):
                command = [arg.bin, "segment", mesh, "-q", "--seed", str(seed), "-o", out, *options]
                subprocess.run(command, check=True)
                found.append(np.load(out))
            seconds = (time.monotonic() - start) / arg.seeds
            apart = [rand_distance(a, b) for a, b in itertools.combinations(found, 2)]
            means.append(np.mean(apart))
            parts = " ".join(str(int(labels.max()) + 1) for labels in found)
            name = os.path.basename(mesh)[:28]
            print(f"{name:28} {means[-1]:6.4f} {max(apart):6.4f} {seconds:8.2f}  {parts}", flush=True)
    print(f"{'mean':28} {np.mean(means):6.4f}")


if __name__ == "__main__":
    main()
