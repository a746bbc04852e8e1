#!/usr/bin/env python3
"""Matches parts of posed meshes with wholes in another pose (`correspond --partial`), and measures errors and what is told as unmatched.

    pip install numpy scipy
    tools/posed_parts.py PROGRAM FIRST.ply SECOND.ply KIND [KIND …]

FIRST and SECOND share their numbering (binary little-endian PLY of triangles). KIND is how FIRST becomes a part: `front`, `back` or `top`
keep 60, 60 and 55 % of its longest extent; `holes` takes eight balls out. Vertices and faces of SECOND are permuted. A row per kind and direction:
mean error on the overlap by `evaluate`, the share of it that is matched, and precision and recall of what is told as unmatched.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
import scipy.sparse as sp
from posed import read, write
from scipy.sparse.csgraph import connected_components


def part(points, faces, kind):
    """The vertices that are left, those of the largest piece, and its faces in their numbers."""
    axis = np.argmax(np.ptp(points, 0))
    x = (points[:, axis] - points[:, axis].min()) / np.ptp(points[:, axis])
    if kind == "holes":
        draw = np.random.default_rng(3)
        radius = 0.05 * np.linalg.norm(np.ptp(points, 0))
        middles = points[draw.choice(len(points), 8, False)]
        keep = np.all([np.linalg.norm(points - middle, axis=1) > radius for middle in middles], 0)
    else:
        keep = {"front": x > 0.4, "back": x < 0.6, "top": x > 0.45}[kind]
    faces = faces[keep[faces].all(1)]
    ends = np.vstack([faces[:, :2], faces[:, 1:]])
    piece = connected_components(sp.csr_matrix((np.ones(len(ends)), ends.T), (len(points),) * 2), False)[1]
    faces = faces[piece[faces[:, 0]] == np.bincount(piece[faces[:, 0]]).argmax()]
    left = np.unique(faces)
    return left, np.searchsorted(left, faces)


def main():
    """Prints the table."""
    program, first, second = sys.argv[1], *map(pathlib.Path, sys.argv[2:4])
    (points, faces), (other, other_faces) = read(first), read(second)
    place = np.random.default_rng(0).permutation(len(other))
    moved = np.empty_like(other)
    moved[place] = other
    print("| part | vertices | whole | mean error | overlap matched | unmatched: precision | recall | seconds |\n"
          "| --- | --- | --- | --- | --- | --- | --- | --- |")
    for kind in sys.argv[4:]:
        with tempfile.TemporaryDirectory() as folder:
            at = pathlib.Path(folder)
            left, part_faces = part(points.astype("f8"), faces, kind)
            write(at / "part.ply", points[left], part_faces.astype("<i4"))
            write(at / "whole.ply", moved, np.random.default_rng(1).permutation(place[other_faces]).astype("<i4"))
            for a, b in (("part", "whole"), ("whole", "part")):
                start = time.perf_counter()
                subprocess.run([program, "correspond", at / f"{a}.ply", at / f"{b}.ply", "--partial", "-q", "-o", at / "m.npy"],
                               check=True)
                seconds = time.perf_counter() - start
                found = np.load(at / "m.npy")["match"]
                truth = place[left]
                if a == "whole":
                    truth = np.full(len(found), -1)
                    truth[place[left]] = np.arange(len(left))
                inside, none = truth >= 0, found < 0
                judged = inside & ~none
                np.save(at / "found.npy", found[judged])
                np.save(at / "truth.npy", truth[judged].astype("<i8"))
                subprocess.run([program, "evaluate", "-q", "--matches", at / "found.npy", "--mesh", at / f"{b}.ply", "--truth",
                                at / "truth.npy", f"--json={at / 'e.json'}"], check=True, stdout=subprocess.DEVNULL)
                mean = json.loads((at / "e.json").read_text())["errors"]["mean"]
                told = [f"{(none & ~inside).sum() / max(1, of.sum()):.3f}" if a == "whole" else "" for of in (none, ~inside)]
                print(f"| {first.stem} {kind} – {second.stem}, from the {a} | {len(left):,} | {len(other):,} | {mean:.4f} "
                      f"| {judged.sum() / inside.sum():.3f} | {told[0]} | {told[1]} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
