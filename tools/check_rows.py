#!/usr/bin/env python3
"""Checks the rows of a run against SciPy's Dijkstra.

    nystrom-stream segment MESH -k 6 --exact --work-dir WORK
    python3 tools/check_rows.py MESH WORK

Rebuilds the graph from WORK/graph_*.npy, computes the distances from every landmark with
scipy.sparse.csgraph.dijkstra in double precision and compares them with WORK/distances.npy.
Ends with 1 if any differs by more than a ten-thousandth of the greatest distance, or if the
graph is not what a graph of MESH has to be. Needs numpy and scipy.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from row_starts import row_starts

TOLERANCE = 1e-4


def header_faces(mesh):
    """The number of faces that the header of a plain PLY promises, or None (strips, gzip)."""
    with open(mesh, "rb") as file:
        head = file.read(1 << 20).split(b"end_header")[0]
    for line in head.splitlines():
        words = line.split()
        if words[:2] == [b"element", b"face"]:
            return int(words[2])
    return None


def main(mesh, work):
    load = lambda name: np.load(Path(work) / f"{name}.npy", mmap_mode="r")
    indices, weights = load("graph_indices"), load("graph_weights")
    landmarks, distances = load("landmarks"), load("distances")
    n = len(load("node_geometry"))
    indptr = row_starts(work, n)
    faces = header_faces(mesh)
    problems = []
    if faces not in (None, n):
        problems.append(f"{n} nodes for {faces} faces")
    if distances.shape != (len(landmarks), n):
        problems.append(f"distances have shape {distances.shape}, not {(len(landmarks), n)}")
    graph = csr_matrix((weights.astype(np.float64), indices.astype(np.int64), indptr), (n, n))
    if not graph.has_canonical_format:
        problems.append("rows are not sorted or have duplicates")
    if (graph != graph.T).nnz:
        problems.append("the matrix is not symmetric")
    if connected_components(graph, directed=False)[0] != 1:
        problems.append("the graph falls apart")
    worst, greatest = 0.0, 0.0
    for row, landmark in enumerate(landmarks):
        exact = dijkstra(graph, indices=int(landmark))
        worst = max(worst, float(np.abs(exact - distances[row]).max()))
        greatest = max(greatest, float(exact.max()))
    if not worst <= TOLERANCE * greatest:
        problems.append(f"distances differ by more than {TOLERANCE} of the greatest")
    share = worst / greatest if greatest else 0.0
    print(f"{mesh}: {len(landmarks)} rows of {n}, worst difference {worst:.3g} = {share:.2g} of the greatest distance")
    for problem in problems:
        print(f"{mesh}: {problem}", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], sys.argv[2]))
