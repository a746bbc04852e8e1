#!/usr/bin/env python3
"""Measures how many clicks bring the parts to those of a person: the curve of 1 − Rand against clicks.

    tools/clicks.py BENCHMARK [-n CLICKS] [--every M] [--people P] [--jobs J] [-o OUT.json]

BENCHMARK holds N.ply and people's N_j.seg; every M-th model is taken with its first P people. A click is one hint about
the largest error: of all connected regions whose part does not match the person's, the largest one; the place is its
deepest face, and the person says which part it belongs to instead, by a place on that part, or that it is a part of its
own. Places are points in space; the program runs as `cluster --work-dir W --edits FILE`. Needs numpy and scipy, and
BIN or a release build.
"""
import argparse
import json
import os
import pathlib
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

BIN = os.environ.get("BIN", "target/release/nystrom-stream")


def read_ply(path):
    """Corners' positions and triangles of a binary or text PLY, through trimesh."""
    import trimesh
    mesh = trimesh.load(path, process=False)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


class Model:
    def __init__(self, path):
        points, faces = read_ply(path)
        self.n = len(faces)
        self.centre = points[faces].mean(axis=1)
        # Faces that share an edge.
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        owner = np.tile(np.arange(self.n), 3)
        order = np.lexsort((edges[:, 1], edges[:, 0]))
        same = (edges[order][1:] == edges[order][:-1]).all(axis=1)
        self.pairs = np.stack([owner[order][1:][same], owner[order][:-1][same]], axis=1)
        gap = np.linalg.norm(self.centre[self.pairs[:, 0]] - self.centre[self.pairs[:, 1]], axis=1)
        self.graph = self.matrix(np.ones(len(self.pairs), bool), gap)

    def matrix(self, keep, weight):
        a, b = self.pairs[keep].T
        weight = weight[keep]
        return csr_matrix((np.r_[weight, weight], (np.r_[a, b], np.r_[b, a])), shape=(self.n, self.n))

    def deepest(self, mask):
        """The face of `mask` that is farthest from all others."""
        inside, outside = np.flatnonzero(mask), np.flatnonzero(~mask)
        if len(outside) == 0:
            return inside[0]
        depth = dijkstra(self.graph, indices=outside, min_only=True)[inside]
        return inside[np.argmax(np.where(np.isfinite(depth), depth, 0))]


def rand(labels, truth):
    """1 − Rand index over pairs of faces."""
    table = np.zeros((labels.max() + 1, truth.max() + 1))
    np.add.at(table, (labels, truth), 1)
    n = table.sum()
    differ = (table.sum(1) ** 2).sum() + (table.sum(0) ** 2).sum() - 2 * (table ** 2).sum()
    return differ / (n * (n - 1))


class Person:
    """Clicks as a person would whose labels are `truth`."""

    def __init__(self, model, truth):
        self.model, self.truth = model, truth
        # Clicked faces by part of the person.
        self.places = {}

    def knows(self, mask, part):
        return any(mask[face] for face in self.places.get(part, []))

    def click(self, labels):
        model, truth = self.model, self.truth
        table = np.zeros((labels.max() + 1, truth.max() + 1))
        np.add.at(table, (labels, truth), 1)
        # What the person has named is what it was called; the rest matches by overlap.
        mate, part_of = {}, {}
        for part, faces in self.places.items():
            label = labels[faces[0]]
            if label not in mate:
                mate[label], part_of[part] = part, label
        left = table.copy()
        for label, part in mate.items():
            left[label, :] = left[:, part] = 0
        while left.max() > 0:
            label, part = np.unravel_index(left.argmax(), left.shape)
            mate[label], part_of[part] = part, label
            left[label, :] = left[:, part] = 0
        wrong = np.array([mate.get(label, -1) for label in range(len(table))])[labels] != truth
        if not wrong.any():
            return False
        block = labels.astype(np.int64) * len(table[0]) + truth
        same = block[model.pairs[:, 0]] == block[model.pairs[:, 1]]
        count, region = connected_components(model.matrix(same, np.ones(len(same))), directed=False)
        mask = region == np.bincount(region, weights=wrong, minlength=count).argmax()
        face = model.deepest(mask)
        part, label = truth[face], labels[face]
        self.places.setdefault(part, [])
        if face in self.places[part]:
            return False
        self.places[part].append(face)
        # The page knows a place in the middle of the part that was clicked, and of the one that was chosen instead.
        for label, part in ((label, mate.get(label)), (part_of.get(part), part)):
            own = (labels == label) & (truth == part) if label is not None and part is not None else np.zeros(model.n, bool)
            if own.any() and not self.knows(own, part):
                self.places.setdefault(part, []).append(model.deepest(own))
        return True

    def edits(self):
        point = lambda face: [float(x) for x in self.model.centre[face]]
        edits = [{"edit": "together", "at": [point(face) for face in faces]} for faces in self.places.values() if len(faces) > 1]
        if len(self.places) > 1:
            edits.append({"edit": "apart", "at": [point(faces[0]) for faces in self.places.values()]})
        return {"format": "nystrom-stream edits", "version": 1, "edits": edits}


def measure(path, people, clicks, folder):
    work, out, file = folder / path.stem, folder / f"{path.stem}.seg", folder / f"{path.stem}.json"
    quiet = ["-q", "--threads", "1"]
    subprocess.run([BIN, "segment", path, *quiet, "--work-dir", work, "-o", out], check=True)
    read = lambda: np.loadtxt(out, dtype=int)
    before, model, curves = read(), Model(path), []
    for k in range(people):
        truth_path = path.with_name(f"{path.stem}_{k}.seg")
        if not truth_path.exists():
            continue
        truth = np.unique(np.loadtxt(truth_path, dtype=int), return_inverse=True)[1]
        person, labels = Person(model, truth), before
        curve = [rand(labels, truth)]
        while len(curve) <= clicks:
            if person.click(labels):
                file.write_text(json.dumps(person.edits()))
                done = subprocess.run([BIN, "cluster", *quiet, "--work-dir", work, "--edits", file, "-o", out],
                                      capture_output=True, text=True)
                if done.returncode:
                    # Two clicks in one cell: the person sees the message and gives up here.
                    print(f"{path.stem}_{k}: {done.stderr.strip()}", flush=True)
                else:
                    labels = read()
            curve.append(rand(labels, truth))
        curves.append(curve)
    subprocess.run(["rm", "-r", work])
    return curves


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("benchmark", type=pathlib.Path)
    parser.add_argument("-n", "--clicks", type=int, default=10)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--people", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("-o", "--output", type=pathlib.Path)
    args = parser.parse_args()
    models = sorted((p for p in args.benchmark.glob("*.ply") if p.stem.isdigit()), key=lambda p: int(p.stem))
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(args.jobs) as pool:
        one = lambda path: (path.stem, measure(path, args.people, args.clicks, pathlib.Path(folder)))
        curves = dict(pool.map(one, models[::args.every]))
    table = np.array([curve for model in curves.values() for curve in model])
    print(f"{len(curves)} models, {len(table)} pairs of model and person")
    print("clicks  mean 1 − Rand  median  share below .04")
    for k, column in enumerate(table.T):
        print(f"{k:6}  {column.mean():13.4f}  {np.median(column):6.4f}  {(column < .04).mean():15.2f}")
    if args.output:
        args.output.write_text(json.dumps(curves))


if __name__ == "__main__":
    main()
