#!/usr/bin/env python3
"""A prototype of domain decomposition: what blocks of a graph would have to tell each other for one row of distances.

    nystrom-stream graph MESH --order hilbert --work-dir DIR && nystrom-stream rows MESH --order hilbert --work-dir DIR -l 4
    tools/domain_blocks.py DIR [BLOCKS:WINDOWS…]

The nodes, sorted along the curve, are cut into blocks of equal length, and the distances from 0 to the greatest into windows
of equal width. In a round, every block runs Dijkstra up to the end of the window from the distances that came in, and sends
those that fell at its border; a window ends when nothing is sent. Few windows mean few rounds and much work that is done
again; many windows the reverse.

Printed per row: rounds; bytes exchanged, 8 per distance sent (node and value); how many nodes are worked on, as a multiple
of all; the speed-up if every block had a machine and messages cost nothing. The distances are compared with the program's
own. Needs numpy and scipy; its own seconds mean nothing.
"""

import json
import sys
from pathlib import Path

import numpy
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from row_starts import row_starts

folder = Path(sys.argv[1])
cases = [tuple(map(int, word.split(":"))) for word in sys.argv[2:]] or [(16, 1), (16, 64)]


def array(name):
    return numpy.load(folder / f"{name}.npy", mmap_mode="r")


indices, weights = array("graph_indices"), array("graph_weights")
rows, landmarks = array("distances"), array("landmarks")
n = rows.shape[1]
indptr = row_starts(folder, n)
of = numpy.repeat(numpy.arange(n, dtype=numpy.uint32), numpy.diff(indptr))


class Block:
    """The nodes from `start` to `end`: their graph, and the steps that lead out."""

    def __init__(self, start, end):
        self.start, self.size = start, end - start
        a, b = int(indptr[start]), int(indptr[end])
        source, target = of[a:b].astype(numpy.int64) - start, numpy.asarray(indices[a:b], dtype=numpy.int64)
        weight = weights[a:b].astype(float)
        inside = (target >= start) & (target < end)
        self.inner = (source[inside], target[inside] - start, weight[inside])
        self.out = (source[~inside], target[~inside], weight[~inside])

    def begin(self):
        self.distance = numpy.full(self.size, numpy.inf)
        # Nodes whose steps are still to be taken.
        self.waiting = numpy.zeros(self.size, dtype=bool)
        self.sent = numpy.full(len(self.out[0]), numpy.inf)

    def take(self, nodes, values):
        better = values < self.distance[nodes]
        self.distance[nodes[better]] = values[better]
        self.waiting[nodes[better]] = True

    def run(self, bound):
        """Takes all steps up to `bound`; returns what falls outside, and how many nodes were worked on."""
        begin = numpy.flatnonzero(self.waiting & (self.distance < bound))
        if len(begin):
            source, target, weight = self.inner
            # A node more, from which the front starts at the distances that are there; +1, since 0 would be no edge.
            ends = numpy.concatenate([target, begin]), numpy.concatenate([weight, self.distance[begin] + 1])
            sources = numpy.concatenate([source, numpy.full(len(begin), self.size)])
            graph = csr_matrix((ends[1], (sources, ends[0])), shape=(self.size + 1,) * 2)
            reached = dijkstra(graph, indices=self.size, limit=bound + 1)[: self.size] - 1
            done = reached < self.distance - 1e-9
            done[begin] = True
            numpy.minimum(self.distance, reached, out=self.distance)
            self.waiting[done] = False
            # Steps from there beyond the bound wait for a later window.
            steps = done[source]
            told = self.distance[source[steps]] + weight[steps]
            far = (told >= bound) & (told < self.distance[target[steps]])
            numpy.minimum.at(self.distance, target[steps][far], told[far])
            self.waiting[target[steps][far]] = True
            work = int(done.sum())
        else:
            work = 0
        at, to, step = self.out
        told = self.distance[at] + step
        # Nothing is said before its window.
        new = ~self.waiting[at] & (told < bound) & (told < self.sent - 1e-9)
        self.sent[new] = told[new]
        return to[new], told[new], work


def row(blocks, edges, landmark, bounds):
    """One row, window by window to `bounds`: rounds, distances sent, nodes worked on, and the sum over rounds of the busiest block's."""
    for block in blocks:
        block.begin()
    home = numpy.searchsorted(edges, landmark, side="right") - 1
    blocks[home].take(numpy.array([landmark - blocks[home].start]), numpy.array([0.0]))
    rounds = sent = work = critical = 0
    for bound in bounds:
        while True:
            answers = [block.run(bound) for block in blocks]
            rounds, most = rounds + 1, max(count for *_, count in answers)
            work, critical = work + sum(count for *_, count in answers), critical + most
            nodes = numpy.concatenate([nodes for nodes, *_ in answers])
            values = numpy.concatenate([values for _, values, _ in answers])
            if not len(nodes):
                break
            # The least for each node; a sender would see to that.
            order = numpy.lexsort((values, nodes))
            nodes, values = nodes[order], values[order]
            first = numpy.concatenate([[True], nodes[1:] != nodes[:-1]])
            nodes, values = nodes[first], values[first]
            sent += len(nodes)
            homes = numpy.searchsorted(edges, nodes, side="right") - 1
            for k in numpy.unique(homes):
                blocks[k].take(nodes[homes == k] - blocks[k].start, values[homes == k])
    return rounds, sent, work, critical


for p, windows in cases:
    edges = numpy.linspace(0, n, p + 1).astype(int)
    blocks = [Block(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    border = sum(len(numpy.unique(block.out[0])) for block in blocks)
    found = []
    for k, landmark in enumerate(landmarks[:4]):
        expected = numpy.asarray(rows[k], dtype=float)
        reached = numpy.isfinite(expected)
        greatest = expected[reached].max()
        found.append(row(blocks, edges, int(landmark), numpy.arange(1, windows + 1) * (1.001 * greatest / windows)))
        distance = numpy.concatenate([block.distance for block in blocks])
        assert numpy.array_equal(numpy.isfinite(distance), reached)
        wrong = numpy.abs(distance[reached] - expected[reached]).max() / greatest
        assert wrong < 1e-4, f"row {k} is off by {wrong}"
    rounds, sent, work, critical = numpy.mean(found, axis=0)
    answer = {"faces": n, "blocks": p, "windows": windows, "border nodes": border, "rounds": float(rounds)}
    print(json.dumps({**answer, "bytes": int(8 * sent), "work": round(work / n, 2), "speed-up": round(n / critical, 2)}))
