#!/usr/bin/env python3
"""K-means in the Nyström embedding of sampled distance rows, in NumPy, SciPy and scikit-learn: the peer to race.

usage: peer_scipy.py MESH.ply K L     prints seconds a stage as JSON

The same maths as `segment --exact --cluster kmeans -k K -l L --metric paper --normalise none --sigma 1`: dual graph with the
paper's edge weights, farthest-point landmarks, one Dijkstra a landmark, Gaussian affinities with the mean distance as
width, A = U diag(lambda) U', extrapolation by eq. 1, unit rows, K-means.
"""
import json
import sys
import time

import numpy as np
from plyfile import PlyData
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from sklearn.cluster import KMeans


class Clock:
    """Seconds between calls, by name."""

    def __init__(self):
        self.last, self.seconds = time.perf_counter(), {}

    def stage(self, name):
        now = time.perf_counter()
        self.seconds[name], self.last = round(now - self.last, 3), now


def read(path):
    """Vertices (nv x 3) and triangles (n x 3)."""
    ply = PlyData.read(path)
    xyz = np.stack([np.asarray(ply["vertex"][axis], float) for axis in "xyz"], 1)
    face = ply["face"].data
    name = next(n for n in face.dtype.names if n.startswith("vertex_ind"))
    return xyz, np.vstack(face[name]).astype(np.int64)


def dual_graph(xyz, tri, delta=0.03, eta=0.1):
    """Sparse symmetric matrix of the paper's edge weights between faces that share an edge."""
    n = len(tri)
    corners = xyz[tri]
    centre = corners.mean(1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    edge = np.sort(tri[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    key = edge[:, 0] * len(xyz) + edge[:, 1]
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][1:] == key[order][:-1])
    i, j = order[pair] // 3, order[pair + 1] // 3
    middle = xyz[edge[order[pair]]].mean(1)
    length = np.linalg.norm(centre[i] - middle, axis=1) + np.linalg.norm(centre[j] - middle, axis=1)
    concave = ((normal[i] - normal[j]) * (centre[j] - centre[i])).sum(1) > 0
    angle = (1 - np.clip((normal[i] * normal[j]).sum(1), -1, 1)) * np.where(concave, 1, eta)
    weight = np.maximum(delta * length / length.mean() + (1 - delta) * angle / max(angle.mean(), 1e-30), 1e-9)
    half = coo_matrix((weight, (i, j)), shape=(n, n))
    return (half + half.T).tocsr()


def sampled_rows(graph, l):
    """Farthest-point landmarks (l) from an extremity, and a row of distances each (l x n)."""
    start = np.random.default_rng(0).integers(graph.shape[0])
    first = dijkstra(graph, indices=start)
    landmarks, rows = [int(np.where(np.isinf(first), -1, first).argmax())], []
    nearest = np.full(graph.shape[0], np.inf)
    for _ in range(l):
        rows.append(dijkstra(graph, indices=landmarks[-1]))
        nearest = np.minimum(nearest, rows[-1])
        landmarks.append(int(np.where(np.isinf(nearest), -1, nearest).argmax()))
    return landmarks[:l], np.array(rows)


def embedding(rows, landmarks, dimensions):
    """Leading Nyström eigenvectors (n x dimensions), rows of unit length."""
    sigma = rows[np.isfinite(rows)].mean()
    affinity = np.exp(-(rows**2) / (2 * sigma**2))
    inner = affinity[:, landmarks]
    value, vector = np.linalg.eigh((inner + inner.T) / 2)
    keep = np.flatnonzero(value > 1e-2 * value.max())[::-1][:dimensions]
    x = affinity.T @ (vector[:, keep] / value[keep])
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-30)


def main():
    path, k, l = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    clock = Clock()
    xyz, tri = read(path)
    clock.stage("read")
    graph = dual_graph(xyz, tri)
    clock.stage("graph")
    landmarks, rows = sampled_rows(graph, l)
    clock.stage("rows")
    x = embedding(rows, landmarks, max(k, 2))
    clock.stage("embed")
    KMeans(k, n_init=3, random_state=0).fit_predict(x)
    clock.stage("kmeans")
    print(json.dumps(dict(faces=len(tri), total=round(sum(clock.seconds.values()), 3), **clock.seconds)))


if __name__ == "__main__":
    main()
