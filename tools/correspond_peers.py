#!/usr/bin/env python3
"""Matches posed meshes by this program and by pyFM (functional maps with ZoomOut), side by side in one run.

    pip install pyfmaps numpy
    tools/correspond_peers.py PROGRAM FOLDER [FIRST SECOND …]

FOLDER has binary little-endian PLY files of triangles that share their numbering, as tools/posed.py wants them; the first by name is matched
with each of the others, or FIRST with SECOND. Vertices and faces of the second are permuted. pyFM starts by itself from wave kernel
signatures (35 functions), and is refined by ZoomOut to 100; also from this program's matches without refinement. All errors are measured by `evaluate`.
Times are seconds by the clock, and in brackets those of processors, which other work on the machine changes less.
"""

import json
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np
from posed import read, write
from pyFM.functional import FunctionalMapping
from pyFM.mesh import TriMesh
from pyFM.refine import zoomout_refine
from pyFM.spectral import FM_to_p2p, p2p_to_FM


class Clock:
    """Seconds by the clock and of processors, of this process and those it has waited for."""

    def __init__(self):
        self.start = self.now()

    @staticmethod
    def now():
        """Both since some time."""
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return np.array([time.perf_counter(), sum(one.ru_utime + one.ru_stime for one in used)])

    def passed(self):
        """Both since the beginning."""
        return self.now() - self.start


def judged(program, folder, matches):
    """Mean error of matches, as `evaluate` measures it."""
    np.save(folder / "found.npy", np.asarray(matches, "<i8"))
    subprocess.run([program, "evaluate", "-q", "--matches", folder / "found.npy", "--mesh", folder / "b.ply", "--truth",
                    folder / "truth.npy", f"--json={folder / 'e.json'}"], check=True, stdout=subprocess.DEVNULL)
    return json.loads((folder / "e.json").read_text())["errors"]["mean"]


def ours(program, a, b, out, *options):
    """Matches by this program, and seconds."""
    clock = Clock()
    subprocess.run([program, "correspond", a, b, "-q", "-o", out, *options], check=True)
    return np.load(out)["match"], clock.passed()


def peer(a, b, first):
    """pyFM's matches from its own start and from `first`, and the seconds of either."""
    clock = Clock()
    # Its maps lead from the second mesh to the first.
    to, of = (TriMesh(*read(path)) for path in (b, a))
    to.process(k=100)
    of.process(k=100)
    basis = clock.passed()
    clock = Clock()
    model = FunctionalMapping(to, of)
    model.preprocess(n_descr=100, descr_type="WKS", subsample_step=5, k_process=100, k_descr=100)
    model.fit(K=(35, 35))
    model.zoomout_refine(nit=13, step=5)
    alone = model.get_p2p()
    own = clock.passed()
    clock = Clock()
    c = p2p_to_FM(first, to.eigenvectors[:, :20], of.eigenvectors[:, :20], A2=of.A)
    c = zoomout_refine(c, to.eigenvectors, of.eigenvectors, nit=16, step=5, A2=of.A)
    given = FM_to_p2p(c, to.eigenvectors, of.eigenvectors)
    return alone, basis + own, given, basis + clock.passed()


def main():
    """Prints a row per pair."""
    program, group, names = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3:]
    if names:
        pairs = [tuple(group / f"{name}.ply" for name in names[k:k + 2]) for k in range(0, len(names), 2)]
    else:
        first, *others = sorted(group.glob("*.ply"))
        pairs = [(first, other) for other in others]
    print("| pair | vertices | not refined | refined | pyFM by itself | ZoomOut of pyFM from ours |\n"
          "| --- | --- | --- | --- | --- | --- |")
    for a, b in pairs:
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            points, faces = read(b)
            place = np.random.default_rng(0).permutation(len(points))
            moved = np.empty_like(points)
            moved[place] = points
            write(folder / "b.ply", moved, np.random.default_rng(1).permutation(place[faces]))
            np.save(folder / "truth.npy", place.astype("<i8"))
            plain, plain_time = ours(program, a, folder / "b.ply", folder / "m.npy", "--refine", "none")
            refined, refined_time = ours(program, a, folder / "b.ply", folder / "m.npy")
            alone, alone_time, given, given_time = peer(a, folder / "b.ply", plain)
            cells = [(plain, plain_time), (refined, refined_time), (alone, alone_time), (given, given_time + plain_time)]
            cells = " | ".join(f"{judged(program, folder, m):.4f}, {t[0]:.1f} s ({t[1]:.1f})" for m, t in cells)
            print(f"| {a.stem} – {b.stem} | {len(points):,} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
