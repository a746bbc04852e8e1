#!/usr/bin/env python3
"""How steady is a segmentation? Segments copies of each model and compares with people and with the original's parts.

  stability.py BENCHMARK OUT [--bin PROGRAM] [--subdivide PROGRAM] [--every 5] [--only a,b] [-- OPTIONS of segment]

Copies: another seed; faces quartered twice, the same with noise of 15 % of a (fine) edge; noise of 5, 15 and 30 % of an
edge; turned and rescaled; faces and vertices shuffled; decimated to a quarter of the faces (where the package
fast_simplification is installed); the surface of 50 and 100 voxels along the longest side, as blocks or by marching
cubes without smoothing (with trimesh and scikit-image). BENCHMARK holds N.ply, N_j.seg and models.tsv; OUT gets labels
and results.json, and what it has is not made again. Labels go from copy to original face by face: quartered faces by
people's and the original's labels on all 16, decimated ones and voxels by the nearest centre. Columns: 1 - Rand to people, mean over people and
models; the paired difference from the original's with its standard error; 1 - Rand between copy and original; parts.
Needs NumPy, SciPy and plyfile.
"""
import argparse
import glob
import importlib.util
import json
import os
import subprocess
import sys
import tempfile

import numpy as np

VARIANTS = {
    "original": [],
    "seed": None,
    "quartered twice": ["--times", "2"],
    "quartered and noise 15 %": ["--times", "2", "--noise", "0.15"],
    "noise 5 %": ["--noise", "0.05"],
    "noise 15 %": ["--noise", "0.15"],
    "noise 30 %": ["--noise", "0.3"],
    "turned and rescaled": ["--turn", "40", "--scale", "37"],
    "shuffled": ["--shuffle"],
    "decimated": None,
    "blocks 50": None,
    "blocks 100": None,
    "cubes 50": None,
    "cubes 100": None,
}

VOXELS = [name for name in VARIANTS if name.split()[0] in ("blocks", "cubes")]


def rand_distance(label, truth):
    """1 - Rand index over pairs of faces."""
    pairs = lambda x: (x * (x - 1.)).sum() / 2
    joint = np.bincount(label * (truth.max() + 1) + truth)
    n = len(label)
    return (pairs(np.bincount(label)) + pairs(np.bincount(truth)) - 2 * pairs(joint)) / (n * (n - 1) / 2)


def read_seg(path):
    return np.unique(np.fromfile(path, sep="\n", dtype=np.int64), return_inverse=True)[1].ravel()


def read_ply(path):
    from plyfile import PlyData
    ply = PlyData.read(path)
    v, f = ply["vertex"], ply["face"]
    name = "vertex_indices" if "vertex_indices" in f.data.dtype.names else "vertex_index"
    return np.c_[v["x"], v["y"], v["z"]].astype(np.float32), np.vstack(f[name]).astype(np.int64)


def write_ply(path, v, f):
    records = np.zeros(len(f), [("n", "u1"), ("v", "<i4", 3)])
    records["n"], records["v"] = 3, f
    head = ("ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
            "property float z\nelement face %d\nproperty list uchar int vertex_indices\nend_header\n")
    with open(path, "wb") as out:
        out.write((head % (len(v), len(f))).encode() + v.astype("<f4").tobytes() + records.tobytes())


def decimate(source, target):
    """Quadric decimation to a quarter; the nearest new face of each old one."""
    import fast_simplification
    from scipy.spatial import cKDTree
    v, f = read_ply(source)
    w, g = fast_simplification.simplify(v, f.astype(np.int32), 0.75)
    g = np.asarray(g, np.int64)
    write_ply(target, np.asarray(w), g)
    return cKDTree(w[g].mean(1)).query(v[f].mean(1))[1]


def blocks(solid):
    """The squares between voxels inside and outside, each in two triangles."""
    unit, squares = np.eye(3, dtype=int), []
    for axis in range(3):
        along = np.diff(solid.astype(np.int8), axis=axis)
        up, one, two = (unit[(axis + k) % 3] for k in range(3))
        for side in (1, -1):
            low = np.argwhere(along == side) + up
            ring = [low, low + one, low + one + two, low + two]
            squares.append(np.stack(ring[::-1] if side == 1 else ring, 1))
    squares = np.concatenate(squares)
    v, number = np.unique(squares.reshape(-1, 3), axis=0, return_inverse=True)
    number = number.reshape(-1, 4)
    return v, np.concatenate([number[:, [0, 1, 2]], number[:, [0, 2, 3]]], 1).reshape(-1, 3)


def voxels(source, target, kind, count):
    """The surface of the voxels, as blocks or by marching cubes; the nearest new face of each old one."""
    import trimesh
    from scipy.spatial import cKDTree
    from skimage.measure import marching_cubes
    v, f = read_ply(source)
    mesh = trimesh.Trimesh(v, f, process=False)
    grid = mesh.voxelized(mesh.extents.max() / count).fill()
    solid = np.pad(grid.matrix, 1)
    if kind == "blocks":
        w, g = blocks(solid)
        w = w - 0.5
    else:
        w, g, _, _ = marching_cubes(solid.astype(np.float32), 0.5)
        g = g[:, ::-1]
    w = (w - 1) * grid.pitch + grid.transform[:3, 3]
    write_ply(target, w, g)
    return cKDTree(w[g].mean(1)).query(v[f].mean(1))[1]


def labels_of(arg, model, variant, mesh):
    """Labels of the copy, and how to bring labels of the original and people's to its faces, or its to theirs."""
    with tempfile.TemporaryDirectory(dir=arg.out) as tmp:
        copy, seg, carry, back, options = mesh, os.path.join(tmp, "x.seg"), None, None, list(arg.options)
        if variant == "seed":
            options += ["--seed", "1"]
        elif variant == "decimated":
            copy = os.path.join(tmp, "x.ply")
            back = decimate(mesh, copy)
        elif variant.split()[0] in ("blocks", "cubes"):
            copy = os.path.join(tmp, "x.ply")
            back = voxels(mesh, copy, variant.split()[0], int(variant.split()[1]))
        elif VARIANTS[variant]:
            copy = os.path.join(tmp, "x.ply")
            subprocess.run([arg.subdivide, mesh, copy, *VARIANTS[variant]], check=True)
            if variant == "shuffled":
                order = np.load(os.path.join(tmp, "x.npy"))
                carry = lambda label: label[order]
            elif "--times" in VARIANTS[variant]:
                carry = lambda label: np.repeat(label, 16)
        subprocess.run([arg.bin, "segment", copy, "-q", "--threads", "1", "--tmp", tmp, "-o", seg, *options], check=True)
        label = read_seg(seg)
    if back is not None:
        label = np.unique(label[back], return_inverse=True)[1].ravel()
    return label, carry or (lambda label: label)


def measure(arg, model, results):
    mesh = os.path.join(arg.benchmark, model + ".ply")
    people = [read_seg(path) for path in sorted(glob.glob(os.path.join(arg.benchmark, model + "_*.seg")))]
    kept = os.path.join(arg.out, model + ".npy")
    for variant in VARIANTS:
        done = results.setdefault(variant, {})
        if model in done or variant not in arg.chosen:
            continue
        label, carry = labels_of(arg, model, variant, mesh)
        if variant == "original":
            np.save(kept, label)
        done[model] = dict(people=float(np.mean([rand_distance(label, carry(truth)) for truth in people])),
                           original=float(rand_distance(label, carry(np.load(kept)))), parts=int(label.max() + 1))


def main():
    words = sys.argv[1:]
    cut = words.index("--") if "--" in words else len(words)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("benchmark")
    parser.add_argument("out")
    parser.add_argument("--bin", default="target/release/nystrom-stream")
    parser.add_argument("--subdivide", default="target/release/subdivide")
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--only", help="variants, separated by commas; the original always")
    arg = parser.parse_args(words[:cut])
    arg.options = words[cut + 1:]
    arg.chosen = {"original", *(arg.only.split(",") if arg.only else VARIANTS)}
    for package, kinds in (("fast_simplification", ["decimated"]), ("trimesh", VOXELS), ("skimage", VOXELS)):
        if importlib.util.find_spec(package) is None and not arg.chosen.isdisjoint(kinds):
            arg.chosen -= set(kinds)
            print(f"stability: {package} is not installed; nothing is made {' or '.join(kinds)}", file=sys.stderr)
    os.makedirs(arg.out, exist_ok=True)
    with open(os.path.join(arg.benchmark, "models.tsv")) as f:
        models = [line.split("\t")[0] for line in f.read().split("\n")[1:] if line][::arg.every]
    path = os.path.join(arg.out, "results.json")
    results = json.load(open(path)) if os.path.exists(path) else {}
    for model in models:
        measure(arg, model, results)
        with open(path + ".partial", "w") as f:
            json.dump(results, f)
        os.replace(path + ".partial", path)
    print(f"{'copy':<24}{'models':>7}{'1-rand':>9}{'change':>9}{'error':>8}{'between':>9}{'parts':>7}")
    for variant, done in results.items():
        names = [model for model in models if model in done]
        if not names:
            continue
        of = lambda key, table=done: np.array([table[model][key] for model in names])
        change = of("people") - of("people", results["original"])
        error = change.std(ddof=1) / np.sqrt(len(names)) if len(names) > 1 else 0
        print(f"{variant:<24}{len(names):>7}{of('people').mean():>9.4f}{change.mean():>9.4f}{error:>8.4f}"
              f"{of('original').mean():>9.4f}{of('parts').mean():>7.1f}")


if __name__ == "__main__":
    main()
