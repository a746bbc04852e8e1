#!/usr/bin/env python3
"""Makes twelve flat plates with rounded rims: a gingerbread man, a wrench, a key, a starfish, a fork, scissors, a comb, a guitar,
glasses, a plus, a hand and a spanner with a slot, of 18,000 to 40,000 faces; for "Plates" in docs/dev/segmentation-experiments.md.

    tools/plates.py OUT; tools/steadiness.py --seeds 6 OUT/*.ply
    tools/plates.py --sheets OUT                                     # planar meshes of the same outlines

An outline is the union and difference of thick segments, boxes and rings, given by their signed distance. Needs NumPy and scikit-image.
"""
import pathlib
import sys

import numpy as np
from skimage.measure import marching_cubes

THICK, ROUNDED = 0.09, 0.01
WIDTH, POINTS, LAYERS = 1.3, 190, 8


def segment(p, a, b, radius, end=None):
    a, b = np.array(a, float), np.array(b, float)
    along = np.clip(((p - a) @ (b - a)) / max((b - a) @ (b - a), 1e-12), 0, 1)
    return np.linalg.norm(p - a - along[..., None] * (b - a), axis=-1) - (radius + ((end or radius) - radius) * along)


def box(p, middle, half):
    q = np.abs(p - np.array(middle, float)) - np.array(half, float)
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def ring(p, middle, radius, width):
    return np.abs(np.linalg.norm(p - np.array(middle, float), axis=-1) - radius) - width


def disc(p, middle, radius):
    return segment(p, middle, middle, radius)


def union(*shapes):
    return np.minimum.reduce(shapes)


def ray(k, of):
    return np.cos(2 * np.pi * k / of + 0.3), np.sin(2 * np.pi * k / of + 0.3)


OUTLINES = {
    "gingerbread": lambda p: union(disc(p, (0, 0.75), 0.25), segment(p, (0, 0.1), (0, 0.35), 0.28),
                                   *[segment(p, (0, 0.35), (x, 0.45), 0.13) for x in (-0.6, 0.6)],
                                   *[segment(p, (x, 0), (3.5 * x, -0.7), 0.15) for x in (-0.1, 0.1)]),
    "wrench": lambda p: np.maximum(union(segment(p, (-0.6, 0), (0.6, 0), 0.1), disc(p, (-0.75, 0), 0.25), disc(p, (0.75, 0), 0.22)),
                                   -union(box(p, (-0.95, 0), (0.2, 0.1)), disc(p, (0.75, 0), 0.11))),
    "key": lambda p: union(ring(p, (-0.7, 0), 0.25, 0.08), segment(p, (-0.42, 0), (0.8, 0), 0.07),
                           *[box(p, (x, -0.14), (0.05, 0.13)) for x in (0.55, 0.72)]),
    "starfish": lambda p: union(*[segment(p, (0, 0), 0.9 * np.array(ray(k, 5)), 0.25, 0.0875) for k in range(5)]),
    "fork": lambda p: union(segment(p, (-1, 0), (0.2, 0), 0.07, 0.05), box(p, (0.35, 0), (0.18, 0.2)),
                            *[segment(p, (0.5, y), (1, y), 0.035) for y in (-0.17, -0.057, 0.057, 0.17)]),
    "scissors": lambda p: union(*[union(segment(p, (-0.3, -s * 0.1), (1, s * 0.18), 0.09, 0.03), ring(p, (-0.6, s * 0.25), 0.2, 0.06),
                                        segment(p, (-0.3, s * 0.1), (-0.42, s * 0.16), 0.08)) for s in (-1, 1)]),
    "comb": lambda p: union(box(p, (0, 0.3), (0.9, 0.1)), *[segment(p, (x, 0.25), (x, -0.3), 0.04) for x in np.linspace(-0.8, 0.8, 7)]),
    "guitar": lambda p: union(disc(p, (-0.7, 0), 0.36), disc(p, (-0.25, 0), 0.27), segment(p, (-0.2, 0), (0.75, 0), 0.06),
                              box(p, (0.85, 0), (0.12, 0.1))),
    "glasses": lambda p: union(*[union(ring(p, (s * 0.4, 0), 0.26, 0.05), segment(p, (s * 0.65, 0.05), (s * 1.1, 0.25), 0.05))
                                 for s in (-1, 1)], segment(p, (-0.15, 0.05), (0.15, 0.05), 0.045)),
    "plus": lambda p: union(box(p, (0, 0), (0.9, 0.2)), box(p, (0, 0), (0.2, 0.9))),
    "hand": lambda p: union(segment(p, (0, -0.2), (0, 0.05), 0.33), segment(p, (0.2, -0.3), (0.65, 0.1), 0.09),
                            segment(p, (0, -0.4), (0, -0.95), 0.2),
                            *[segment(p, (0.8 * x, 0.1), (1.3 * x, y), 0.075)
                              for x, y in ((-0.3, 0.75), (-0.1, 0.9), (0.1, 0.88), (0.3, 0.72))]),
    "spanner": lambda p: np.maximum(union(segment(p, (-0.7, 0), (0.7, 0), 0.12), ring(p, (-0.8, 0), 0.16, 0.07),
                                          ring(p, (0.8, 0), 0.13, 0.06)), -box(p, (0, 0), (0.45, 0.03))),
}


def plate(outline, x):
    """Vertices and triangles of the plate, by marching cubes."""
    step = x[1] - x[0]
    z = np.arange(-LAYERS, LAYERS + 1) * step / 1.3
    across = outline(np.stack(np.meshgrid(x, x, indexing="ij"), -1))[..., None] + ROUNDED
    through = (np.abs(z) - THICK / 2 + ROUNDED)[None, None]
    distance = np.minimum(np.maximum(across, through), 0) + np.hypot(np.maximum(across, 0), np.maximum(through, 0)) - ROUNDED
    points, corners, _, _ = marching_cubes(distance, 0, spacing=(step, step, step / 1.3))
    return points, corners


def sheet(outline, x):
    """Vertices and triangles in the plane: a grid whose vertices near the outline are moved onto it."""
    count, step, eps = len(x), x[1] - x[0], 1e-4
    points = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    distance = outline(points)
    slope = np.stack([outline(points + eps * axis) - outline(points - eps * axis) for axis in np.eye(2)], -1) / (2 * eps)
    near = np.abs(distance) < 0.5 * step
    points[near] -= (distance[:, None] * slope)[near]
    i = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    corners = np.concatenate([np.stack([i, i + count, i + count + 1], 1), np.stack([i, i + count + 1, i + 1], 1)])
    corners = corners[(distance[corners] < 0.5 * step).all(1) & (outline(points[corners].mean(1)) < -1e-3)]
    used, corners = np.unique(corners, return_inverse=True)
    return np.pad(points[used], ((0, 0), (0, 1))), corners.reshape(-1, 3)


def main():
    *options, out = sys.argv[1:] or [""]
    if not out or out.startswith("-") or options not in ([], ["--sheets"]):
        sys.exit(__doc__)
    out = pathlib.Path(out)
    out.mkdir(parents=True, exist_ok=True)
    for name, outline in OUTLINES.items():
        points, corners = sheet(outline, np.linspace(-WIDTH, WIDTH, 260)) if options else plate(outline, np.linspace(-WIDTH, WIDTH, POINTS))
        faces = np.empty(len(corners), [("count", "u1"), ("corners", "<i4", 3)])
        faces["count"], faces["corners"] = 3, corners
        head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *[f"property float {axis}" for axis in "xyz"],
                f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
        (out / f"{name}.ply").write_bytes("\n".join(head).encode() + points.astype("<f4").tobytes() + faces.tobytes())
        print(f"{name}: {len(faces)} faces")


if __name__ == "__main__":
    main()
