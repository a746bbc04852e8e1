#!/usr/bin/env python3
"""Makes tubes: a hose, a spring, a knot, a snake, a paper clip, an S-hook, an open ring, a hose and a spring with thick ends, two
rods with ripples, a bolt with a thread, a chain of beads, and a match, of 13,000 to 64,000 faces; for "Tubes" in docs/quality.md.

    tools/tubes.py OUT; tools/steadiness.py --seeds 8 OUT/*.ply

A tube follows a curve at a given radius; its ends are closed by fans. Needs NumPy, SciPy and plyfile.
"""
import pathlib
import sys

import numpy as np
from scipy.interpolate import splev, splprep

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import stability


def tube(curve, radius, around=48, closed=False):
    """Vertices and faces of a tube along `curve` (m x 3)."""
    m, q = len(curve), np.arange(around)
    along = np.roll(curve, -1, 0) - np.roll(curve, 1, 0) if closed else np.gradient(curve, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    sides = [np.cross(along[0], [.3, .5, .81])]
    for a in along:
        side = sides[-1] - a * (sides[-1] @ a)
        sides.append(side / np.linalg.norm(side))
    one = np.array(sides[1:])
    two, angle = np.cross(along, one), np.linspace(0, 2 * np.pi, around, endpoint=False)[:, None]
    radius = np.broadcast_to(radius, m)[:, None, None]
    v = curve[:, None] + radius * (np.cos(angle) * one[:, None] + np.sin(angle) * two[:, None])
    i, j = np.meshgrid(np.arange(m if closed else m - 1), q, indexing="ij")
    at = lambda i, j: i % m * around + j % around
    a, b, c, d = at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)
    faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    v = v.reshape(-1, 3)
    if not closed:
        v = np.vstack([v, curve[0], curve[-1]])
        n, last = m * around, (m - 1) * around
        faces.append(np.stack([(q + 1) % around, q, np.full(around, n)], 1))
        faces.append(np.stack([last + q, last + (q + 1) % around, np.full(around, n + 1)], 1))
    return v, np.concatenate(faces)


def bolt(m=500, around=64):
    """A hexagonal head, a shank, and a thread of twelve turns."""
    z = np.linspace(0, 10, m)
    radius = np.where(z < 1.2, 1.6, .8) * np.minimum(1, 20 * (10 - z) + .02)
    v, f = tube(np.stack([0 * z, 0 * z, z], 1), radius, around)
    wall = v[: m * around]
    angle, high = np.arctan2(wall[:, 1], wall[:, 0]), wall[:, 2]
    turn = (2.2 * high - angle / (2 * np.pi)) % 1
    thread = 1 + .1 * (1 - 2 * abs(2 * turn - 1)) * ((high > 4.5) & (high < 9.8))
    hexagon = np.cos(np.pi / 6) / np.cos(angle % (np.pi / 3) - np.pi / 6)
    wall[:, :2] *= np.where(high < 1.2, hexagon, thread)[:, None]
    return v, f


def through(points, m=400):
    """A smooth curve through the points."""
    spline = splprep(np.array(points, float).T, s=0, k=3)[0]
    return np.stack(splev(np.linspace(0, 1, m), spline), 1)


def rounded(points, radius, m=500):
    """The polygon through the points, with rounded corners."""
    points = np.array(points, float)
    curve, t = [points[0]], np.linspace(0, 1, 24)[:, None]
    for a, b, c in zip(points, points[1:], points[2:]):
        p, q = (b + radius * (x - b) / np.linalg.norm(x - b) for x in (a, c))
        curve += list((1 - t) ** 2 * p + 2 * t * (1 - t) * b + t**2 * q)
    curve = np.array(curve + [points[-1]])
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    return np.stack([np.interp(np.linspace(0, length[-1], m), length, x) for x in curve.T], 1)


def main():
    out = pathlib.Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    s, k = np.linspace(0, 1, 400), np.linspace(0, 2 * np.pi, 600, endpoint=False)
    hose = np.stack([10 * s, 1.5 * np.sin(5 * s), 1.2 * np.cos(4 * s)], 1)
    helix = lambda turns: np.stack([np.cos(turns * s), np.sin(turns * s), 4 * s], 1)
    rod = np.stack([0 * s, 0 * s, 8 * s], 1)
    ends = 1 / (1 + np.exp((.95 - s) / .002)) + 1 / (1 + np.exp((s - .05) / .002))
    ripples = lambda count: .5 + .05 * np.sin(2 * np.pi * count * s)
    wire = [[0, 1, 0], [5, 1, 0], [5, -1, .1], [-1, -1, .15], [-1, 1.6, .3], [6, 1.6, .35], [6, -1.6, .35], [0, -1.6, .3]]
    hook = [[0, 0, 0], [1, 1, 0], [2, 0, 0], [1.5, -1.2, 0], [1, -2.4, 0], [2, -3.4, 0], [3, -2.4, 0]]
    off = (6 * s - 5.68) / .32
    gap = .93 * np.linspace(0, 2 * np.pi, 500)
    tubes = {
        "hose": tube(hose, .3),
        "spring": tube(helix(40), .15, 24),
        "knot": tube(np.stack([np.sin(k) + 2 * np.sin(2 * k), np.cos(k) - 2 * np.cos(2 * k), -np.sin(3 * k)], 1), .35, 32, True),
        "snake": tube(np.stack([10 * s, 1.2 * np.sin(9 * s), 0 * s], 1), .35 * np.clip(np.minimum(20 * s, 2.2 * (1 - s)) + .02, 0, 1)),
        "paper-clip": tube(rounded(wire, .75), .15, 32),
        "s-hook": tube(through(hook), .2, 32),
        "open-ring": tube(np.stack([2 * np.cos(gap), 2 * np.sin(gap), 0 * gap], 1), .3, 40),
        "hose-ends": tube(hose, .2 + .25 * ends),
        "spring-ends": tube(helix(30), .12 + .2 * ends, 24),
        "ripples": tube(rod, ripples(8)),
        "match": tube(.75 * rod, np.maximum(np.where(off > 0, 1e-4, .2), .32 * np.sqrt(np.maximum(0, 1 - off * off))), 16),
        "bolt": bolt(),
        "beads": tube(rod, np.sqrt(np.maximum(.15**2, .5**2 - (8 * s % 1 - .5) ** 2))),
        "grip": tube(rod, np.where(s < .35, .18, ripples(10)) * np.minimum(1, 20 * (1 - s) + .1)),
    }
    for name, mesh in tubes.items():
        stability.write_ply(out / f"{name}.ply", *mesh)


if __name__ == "__main__":
    main()
