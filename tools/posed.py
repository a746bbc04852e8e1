#!/usr/bin/env python3
"""Matches posed meshes of one connectivity, vertices of the second permuted by a seed, and prints errors as a table.

    tools/posed.py PROGRAM [--seed S] GROUP [OPTIONS of correspond…]

GROUP is a folder of binary little-endian PLY files of triangles that share their numbering; the first by name is matched
with each of the others. Needs NumPy. A second or two a pair of 10,000 vertices.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

import numpy as np


def read(path):
    """Positions and triangles of a mesh."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + 11
    header = data[:end].decode()
    vertices, faces = (int(header.split(f"element {name} ")[1].split()[0]) for name in ("vertex", "face"))
    points = np.frombuffer(data, "<f4", 3 * vertices, end).reshape(vertices, 3)
    records = np.frombuffer(data, [("count", "u1"), ("corners", "<i4", 3)], faces, end + 12 * vertices)
    return points, records["corners"]


def write(path, points, faces):
    """Writes a mesh."""
    header = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
              f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    records = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    records["count"], records["corners"] = 3, faces
    path.write_bytes(header.encode() + np.ascontiguousarray(points, "<f4").tobytes() + records.tobytes())


def main():
    """Matches every pair of a group."""
    words = sys.argv[1:]
    seed = 0
    if "--seed" in words:
        at = words.index("--seed")
        seed = int(words[at + 1])
        del words[at:at + 2]
    if len(words) < 2:
        sys.exit(__doc__)
    program, group, options = words[0], pathlib.Path(words[1]), words[2:]
    first, *others = sorted(group.glob("*.ply"))
    print("| pair | mean | median | matched | orientation | ambiguous |\n| --- | --- | --- | --- | --- | --- |")
    means = []
    for other in others:
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            points, faces = read(other)
            place = np.random.default_rng(seed).permutation(len(points))
            moved = np.empty_like(points)
            moved[place] = points
            write(folder / "b.ply", moved, np.random.default_rng(seed + 1).permutation(place[faces]))
            np.save(folder / "truth.npy", place.astype("<i8"))
            subprocess.run([program, "correspond", first, folder / "b.ply", "-q", "-o", folder / "m.npy",
                            f"--json={folder / 'r.json'}", *options], check=True)
            subprocess.run([program, "evaluate", "-q", "--matches", folder / "m.npy", "--mesh", folder / "b.ply", "--truth",
                            folder / "truth.npy", f"--json={folder / 'e.json'}"], check=True, stdout=subprocess.DEVNULL)
            errors = json.loads((folder / "e.json").read_text())["errors"]
            report = json.loads((folder / "r.json").read_text())
        means.append(errors["mean"])
        share = errors["evaluated"] / (errors["evaluated"] + errors["unmatched"])
        print(f"| {first.stem} – {other.stem} | {errors['mean']:.4f} | {errors['median']:.4f} | {share:.0%} "
              f"| {report['alignments'][0]['orientation']:.2f} | {'yes' if report['ambiguous'] else 'no'} |", flush=True)
    print(f"| mean of {len(means)} | {np.mean(means):.4f} | | | | |")


if __name__ == "__main__":
    main()
