#!/usr/bin/env python3
"""How many people have the parts that the program finds: the tables of unsure parts and of confidence in docs/quality.md.

    tools/agreement.py BENCHMARK OUT [OPTIONS of segment…]

BENCHMARK holds N.ply and people's N_j.seg. OUT keeps labelled meshes and reports.json; a run that has the latter only prints. A
person has a part if one of that person's parts overlaps it by more than half of their union, by area. A person agrees about a
face if it lies in that person's part with the most faces in common with ours. Needs NumPy and plyfile, and BIN or a release build.
"""
import glob
import json
import os
import pathlib
import subprocess
import sys

import numpy as np
from plyfile import PlyData

from steadiness import Surface, rand_distance

BIN = os.environ.get("BIN", "target/release/nystrom-stream")
EXPECTED = [0, .2, .35, .5, .65, .8, .9, 1.01]
CONFIDENCE = [0, .2, .3, .4, .5, .6, .7, .8, .9, 1.01]


def segment(benchmark, out, options):
    out.mkdir(parents=True, exist_ok=True)
    if not (out / "reports.json").exists():
        meshes = sorted(glob.glob(f"{benchmark}/*.ply"))
        subprocess.run([BIN, "segment", *meshes, "-q", "-o", f"{out}/{{}}.ply", f"--json={out}/reports.json", *options], check=True)
    return json.loads((out / "reports.json").read_text())


def measure(report, out):
    """A row per part: area, expected, people who have it, overlap. A row per face: confidence, people who agree. 1 - Rand."""
    mesh = pathlib.Path(report["input"]["path"])
    face = PlyData.read(out / mesh.name, known_list_len={"face": {"vertex_indices": 3}})["face"]
    labels, area = np.asarray(face["label"]).astype(int), Surface(mesh).area
    count, people = labels.max() + 1, glob.glob(f"{mesh.with_suffix('')}_*.seg")
    has, overlap, agrees, rand = np.zeros(count), np.zeros(count), np.zeros(len(labels)), 0
    for person in people:
        theirs = np.unique(np.loadtxt(person, dtype=int), return_inverse=True)[1]
        table, common = np.zeros((2, count, theirs.max() + 1))
        np.add.at(table, (labels, theirs), area)
        np.add.at(common, (labels, theirs), 1)
        share = table / np.maximum(table.sum(1)[:, None] + table.sum(0) - table, 1e-300)
        has += share.max(1) > .5
        overlap += share.max(1)
        agrees += common.argmax(1)[labels] == theirs
        rand += rand_distance(labels, theirs)
    by_label = {part["label"]: part for part in report["parts"]}
    expected = [by_label[k].get("expected_agreement", np.nan) if k in by_label else np.nan for k in range(count)]
    parts = np.c_[np.bincount(labels, area, count) / area.sum(), expected, has / len(people), overlap / len(people)]
    return parts[np.isfinite(expected)], np.c_[np.asarray(face["quality"]), agrees / len(people)], rand / len(people)


def main():
    benchmark, out, *options = sys.argv[1:]
    out = pathlib.Path(out)
    reports = segment(benchmark, out, options)
    each = [measure(report, out) for report in reports]
    parts = np.concatenate([rows for rows, _, _ in each])
    area, expected, has, overlap = parts.T
    unsure, rare = expected < .5, has < .1
    print(f"{len(parts)} parts on {len(each)} models; no clear parts on {sum(r.get('clear_parts') is False for r in reports)}; "
          f"of parts that less than a tenth of people have {unsure[rare].mean():.1%} are unsure")
    for name, rows in (("unsure", unsure), ("others", ~unsure)):
        print(f"{name}: {rows.mean():.1%} of parts, {area[rows].sum() / area.sum():.1%} of area, people {has[rows].mean():.3f}, "
              f"overlap {overlap[rows].mean():.3f}, rare {rare[rows].mean():.1%}")
    for low, high in zip(EXPECTED, EXPECTED[1:]):
        rows = (expected >= low) & (expected < high)
        print(f"expected from {low}: {rows.sum()} parts, mean {expected[rows].mean():.3f}, people {has[rows].mean():.3f}")
    # Models have equal weight.
    weight = np.concatenate([np.full(len(rows), 1 / len(rows) / len(each)) for _, rows, _ in each])
    confidence, agrees = np.concatenate([rows for _, rows, _ in each]).T
    for low, high in zip(CONFIDENCE, CONFIDENCE[1:]):
        rows = (confidence >= low) & (confidence < high)
        print(f"confidence from {low}: {weight[rows].sum():.3f} of the faces, people {np.average(agrees[rows], weights=weight[rows]):.3f}")
    told = np.array([report["decision"]["expected_disagreement"] for report in reports])
    found = np.array([rand for _, _, rand in each])
    print(f"1 - Rand: expected {told.mean():.4f}, found {found.mean():.4f}, root mean square of the difference "
          f"{np.sqrt(np.square(told - found).mean()):.3f}")
    for quarter in np.array_split(np.argsort(told, kind="stable"), 4):
        print(f"quarter of the models: expected {told[quarter].mean():.3f}, found {found[quarter].mean():.3f}")


if __name__ == "__main__":
    main()
