#!/usr/bin/env python3
"""One row of distances beside SciPy, igraph and NetworKit: the same graph, the same source, one thread each.

usage: peer_rows.py RACE MESH [REPEAT]     prints milliseconds a row as JSON; RACE: target/release/race

    pip install numpy scipy igraph networkit

`race` makes the graph and a row by our front, and keeps both. The peers read the graph and run Dijkstra's algorithm from the same
node; what they take to build a graph of their own is not counted. Their distances are compared with ours. Medians of REPEAT = 5 runs.
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
    race, mesh = sys.argv[1:3]
    repeat = int(sys.argv[3]) if len(sys.argv) > 3 else 5
    networkit.setNumberOfThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([race, mesh, "--repeat", str(repeat), "--keep", folder], check=True, stdout=subprocess.DEVNULL)
        ours = json.loads(Path(folder, "front.json").read_text())
        names = ("graph_indices", "graph_weights", "front")
        indices, weights, row = (numpy.load(f"{folder}/{name}.npy") for name in names)
        starts = row_starts(folder, len(row))
    graph = csr_matrix((weights.astype(float), indices.astype(numpy.int64), starts), shape=(len(row),) * 2)
    reached = numpy.isfinite(row)
    seconds = {"ours": ours["seconds"]}
    for name, run in peers(graph):
        times = []
        for _ in range(repeat):
            begun = time.perf_counter()
            distances = run(ours["source"])
            times.append(time.perf_counter() - begun)
        numpy.testing.assert_allclose(numpy.asarray(distances)[reached], row[reached], rtol=1e-4, err_msg=name)
        seconds[name] = float(numpy.median(times))
    milliseconds = {name: round(1e3 * value, 1) for name, value in seconds.items()}
    times_ours = {name: round(value / seconds["ours"], 1) for name, value in seconds.items() if name != "ours"}
    print(json.dumps({"faces": len(row), "milliseconds": milliseconds, "times ours": times_ours}))


if __name__ == "__main__":
    main()
