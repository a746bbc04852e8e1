#!/usr/bin/env python3
"""One row of distances beside SciPy, igraph and NetworKit: the same graph, the same sources, one thread.

usage: peer_rows.py PROGRAM MESH [L]     prints milliseconds a row as JSON; L = 5 landmarks

    pip install numpy scipy igraph networkit

The program makes L rows in a work directory; what its report says of them, shared by L, is its time. It includes the search for
landmarks and the writing of rows. The peers read the same graph from there and run Dijkstra's algorithm from the same landmarks; what
they take to build a graph of their own is not counted. Their distances are compared with the program's. Medians of L.
"""
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import igraph
import networkit
import numpy
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tools"))
from row_starts import row_starts  # noqa: E402


def peers(graph):
    """By name, a function from a node to the distances of all others."""
    n = graph.shape[0]
    rows = numpy.repeat(numpy.arange(n), numpy.diff(graph.indptr))
    once = rows < graph.indices
    ends, weights = numpy.stack([rows[once], graph.indices[once]], 1), graph.data[once]
    of_igraph = igraph.Graph(n, ends)
    of_networkit = networkit.GraphFromCoo((weights, (ends[:, 0], ends[:, 1])), n=n, weighted=True, directed=False)

    def by_networkit(source):
        search = networkit.distance.Dijkstra(of_networkit, source, storePaths=False)
        search.run()
        return search.getDistances(asarray=True)

    yield "SciPy", lambda source: dijkstra(graph, indices=source)
    yield "igraph", lambda source: of_igraph.distances(source, weights=weights)[0]
    yield "NetworKit", by_networkit


def main():
    program, mesh = sys.argv[1:3]
    count = sys.argv[3] if len(sys.argv) > 3 else "5"
    networkit.setNumberOfThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        command = [program, "rows", mesh, "--work-dir", folder, "-l", count, "--threads", "1", "-q", f"--json={folder}/report.json"]
        subprocess.run(command, check=True)
        report = json.loads(Path(folder, "report.json").read_text())
        indices, weights, landmarks, ours = (
            numpy.load(f"{folder}/{name}.npy") for name in ("graph_indices", "graph_weights", "landmarks", "distances")
        )
        starts = row_starts(folder, ours.shape[1])
    graph = csr_matrix((weights.astype(float), indices.astype(numpy.int64), starts), shape=(ours.shape[1],) * 2)
    seconds = {"ours": report["seconds"]["rows"] / len(landmarks)}
    for name, run in peers(graph):
        times = []
        for source, row in zip(landmarks.tolist(), ours):
            begun = time.perf_counter()
            distances = run(source)
            times.append(time.perf_counter() - begun)
            reached = numpy.isfinite(row)
            numpy.testing.assert_allclose(numpy.asarray(distances)[reached], row[reached], rtol=1e-4, err_msg=name)
        seconds[name] = float(numpy.median(times))
    milliseconds = {name: round(1e3 * value, 1) for name, value in seconds.items()}
    times_ours = {name: round(value / seconds["ours"], 1) for name, value in seconds.items() if name != "ours"}
    print(json.dumps({"faces": ours.shape[1], "milliseconds": milliseconds, "times ours": times_ours}))


if __name__ == "__main__":
    main()
