#!/usr/bin/env python3
"""Makes isosurfaces of volumes: bodies with noise, tunnels, folds, an inside and an outside, with known large parts.

  isosurfaces.py [--scale 1] [--only NAME,...] FOLDER

Writes FOLDER/NAME.ply (binary) and FOLDER/NAME.truth.npy, the part of each face. A volume is a signed distance in a box, from balls,
ellipsoids and tapered capsules, that noise, folds, walls and tunnels change; a face's part is the body nearest to it. `--scale` is
the share of voxels along an edge; 1 gives 107,000 to 7.3 million faces. The same versions of the libraries give the same bytes.
Needs NumPy, SciPy and scikit-image; up to 5 GB of memory.
"""
import argparse
import os

import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

F = np.float32


def ball(centre, radius):
    return lambda p: np.sqrt(sum((x - F(c)) ** 2 for x, c in zip(p, centre))) - F(radius)


def ellipsoid(centre, radii):
    least = F(min(radii))
    return lambda p: (np.sqrt(sum(((x - F(c)) / F(r)) ** 2 for x, c, r in zip(p, centre, radii))) - F(1)) * least


def capsule(a, b, ra, rb):
    """From `a` to `b`, its radius from `ra` to `rb`."""
    way = np.subtract(b, a)
    square = float(way @ way)

    def distance(p):
        t = np.clip(sum((x - F(c)) * F(w / square) for x, c, w in zip(p, a, way)), 0, 1)
        return np.sqrt(sum((x - F(c) - t * F(w)) ** 2 for x, c, w in zip(p, a, way))) - (F(ra) + t * F(rb - ra))

    return distance


def chain(points, radii):
    pieces = [capsule(*ends, *r) for ends, r in zip(zip(points, points[1:]), zip(radii, radii[1:]))]
    return lambda p: least(piece(p) for piece in pieces)


def least(fields):
    fields = iter(fields)
    out = next(fields)
    for field in fields:
        out = np.minimum(out, field)
    return out


class Volume:
    """A signed distance on a grid of a box, negative inside."""

    def __init__(self, low, high, voxels, seed):
        self.h = max(b - a for a, b in zip(low, high)) / voxels
        self.low = np.array(low)
        self.shape = tuple(int(np.ceil((b - a) / self.h)) + 1 for a, b in zip(low, high))
        axes = [F(a) + F(self.h) * np.arange(n, dtype=F) for a, n in zip(low, self.shape)]
        self.p = np.meshgrid(*axes, indexing="ij", sparse=True)
        self.random = np.random.default_rng(seed)

    def of(self, parts):
        self.d = least(part(self.p) for part in parts)
        return self

    def noise(self, wavelength):
        """A random field of deviation 1 that changes over `wavelength`."""
        if wavelength < 2 * self.h:
            return self.random.standard_normal(self.shape, dtype=F)
        coarse = [int(np.ceil(n * self.h / wavelength)) + 2 for n in self.shape]
        knots = self.random.standard_normal(coarse, dtype=F)
        field = knots
        # One axis after another: linear between knots.
        for axis, n in enumerate(self.shape):
            at = np.arange(n) * (self.h / wavelength)
            k, t = at.astype(int), (at % 1).astype(F)
            t = t.reshape([-1 if a == axis else 1 for a in range(3)])
            field = field.take(k, axis) * (1 - t) + field.take(k + 1, axis) * t
        return field * F(1.8)

    def rough(self, *waves):
        """Adds noise: (wavelength, amplitude), a wavelength of 0 for single voxels."""
        for wavelength, amplitude in waves:
            self.d = self.d + F(amplitude) * self.noise(wavelength)
        return self

    def hollow(self, thickness):
        self.d = np.abs(self.d + F(thickness / 2)) - F(thickness / 2)
        return self

    def cut(self, *bodies):
        for body in bodies:
            np.maximum(self.d, -body(self.p), out=self.d)
        return self

    def gyroid(self, period, warp):
        """Minimal surfaces of `period`, bent by noise; a distance near them."""
        w = 2 * np.pi / period
        x, y, z = (F(w) * (x + F(warp) * self.noise(3 * period)) for x in self.p)
        value = np.sin(x) * np.cos(y)
        value += np.sin(y) * np.cos(z)
        value += np.sin(z) * np.cos(x)
        return value * F(0.7 / w)

    def fold(self, body, period, depth, width):
        """Cuts sulci of some `depth` and `width` into `body` (a distance on the grid)."""
        sulcus = np.abs(self.gyroid(period, 0.25 * period)) - F(width / 2)
        np.maximum(sulcus, -body - F(depth), out=sulcus)
        return np.maximum(body, -sulcus)

    def tunnels(self, count, inside, length, radius):
        """Cuts tunnels of some `length` in random directions, from places where the distance is about `inside`."""
        places = np.argwhere(np.abs(self.d - F(inside)) < F(self.h))
        for k in self.random.choice(len(places), count, replace=False):
            a = self.low + places[k] * self.h
            way = self.random.standard_normal(3)
            b = a + way * (length / np.linalg.norm(way))
            # In its box alone.
            low, high = (np.clip((f(a, b) + s * (radius + 4 * self.h) - self.low) / self.h, 0, self.shape).astype(int)
                         for f, s in ((np.minimum, -1), (np.maximum, 1)))
            box = tuple(slice(i, j) for i, j in zip(low, high))
            p = [x[tuple(s if x.shape[k] > 1 else slice(None) for k, s in enumerate(box))] for x in self.p]
            self.d[box] = np.maximum(self.d[box], -capsule(a, b, radius, radius)(p))
        return self

    def surface(self, smooth=0.7):
        field = ndimage.gaussian_filter(self.d, smooth, truncate=3) if smooth else self.d
        for axis in range(3):
            end = np.moveaxis(field, axis, 0)
            end[0], end[-1] = F(1), F(1)
        vertices, faces, _, _ = marching_cubes(field, 0)
        return (vertices * self.h + self.low).astype(F), np.ascontiguousarray(faces, dtype=np.int32)


def spheres():
    return [ball((-0.75, 0, 0), 0.5), ball((0.07, 0.05, 0), 0.38), ball((0.72, 0.1, 0.1), 0.32)]


def animal():
    body = chain([(-0.6, 0, 0), (0, 0, 0.04), (0.55, 0, 0)], [0.27, 0.24, 0.28])
    head = chain([(0.72, 0, 0.3), (0.86, 0, 0.55), (1.15, 0, 0.5)], [0.1, 0.17, 0.1])
    legs = [chain([(x, y, -0.15), (x + 0.03, 1.15 * y, -0.55), (x, 1.2 * y, -0.95)], [0.12, 0.09, 0.08])
            for x in (-0.62, 0.55) for y in (-0.19, 0.19)]
    return [body, head, *legs, chain([(-0.85, 0, 0.1), (-1.2, 0, 0), (-1.35, 0, -0.35)], [0.06, 0.05, 0.04])]


def octopus():
    arms = []
    for k in range(8):
        c, s = np.cos(k * np.pi / 4 + 0.2), np.sin(k * np.pi / 4 + 0.2)
        bend = 0.1 * (-1) ** k
        points = [(r * c - b * s, r * s + b * c, z) for r, b, z in
                  [(0.25, 0, -0.2), (0.55, bend, -0.35), (0.85, 0, -0.3), (1.15, -bend, -0.4)]]
        arms.append(chain(points, [0.11, 0.09, 0.07, 0.04]))
    return [ellipsoid((0, 0, 0.25), (0.4, 0.4, 0.5)), *arms]


HEMISPHERES = [ellipsoid((0, s * 0.36, 0.15), (0.85, 0.34, 0.55)) for s in (-1, 1)]
CEREBELLUM = ellipsoid((-0.5, 0, -0.52), (0.34, 0.46, 0.24))
STEM = capsule((-0.1, 0, -0.2), (-0.3, 0, -0.95), 0.13, 0.1)


def brain(voxels, seed):
    volume = Volume((-1, -0.85, -1.1), (1, 0.85, 0.85), voxels, seed)
    halves = [volume.fold(half(volume.p), 0.3, 0.17, 0.02) for half in HEMISPHERES]
    small = volume.fold(CEREBELLUM(volume.p), 0.1, 0.07, 0.012)
    bridge = ellipsoid((-0.05, 0, 0.08), (0.35, 0.1, 0.12))
    volume.d = least([*halves, small, STEM(volume.p), bridge(volume.p)])
    del halves, small
    volume.rough((0.2, 0.01), (0.05, 0.004), (0, 0.5 * volume.h))
    return volume, [*HEMISPHERES, CEREBELLUM, STEM]


def cortex(voxels):
    volume = Volume((-1, -0.5, -0.6), (1, 0.5, 0.85), voxels, 5)
    half = ellipsoid((0, 0, 0.1), (0.85, 0.36, 0.58))
    volume.d = volume.fold(half(volume.p), 0.27, 0.2, 0.03)
    return volume.rough((0.2, 0.01), (0, 0.3 * volume.h)), [half]


def head(voxels):
    """Skin and skull with a brain within, which noise ties to it."""
    volume = Volume((-0.85, -0.8, -1.25), (0.95, 0.8, 0.95), voxels, 8)
    skin = [ellipsoid((0, 0, 0), (0.75, 0.62, 0.82)), capsule((-0.15, 0, -0.5), (-0.2, 0, -1.3), 0.36, 0.4),
            capsule((0.68, 0, 0.05), (0.8, 0, -0.1), 0.06, 0.1), ellipsoid((-0.05, 0.64, -0.05), (0.12, 0.08, 0.2)),
            ellipsoid((-0.05, -0.64, -0.05), (0.12, 0.08, 0.2))]
    within = ellipsoid((-0.05, 0, 0.12), (0.56, 0.46, 0.55))
    volume.of(skin).rough((0.3, 0.01), (0.06, 0.006))
    shell = np.maximum(volume.d, -(ellipsoid((-0.02, 0, 0.1), (0.64, 0.53, 0.64))(volume.p)))
    matter = volume.fold(within(volume.p), 0.24, 0.14, 0.02)
    # The nose and the throat.
    air = [capsule((0.78, 0, -0.1), (0.3, 0, -0.35), 0.05, 0.12), capsule((0.3, 0, -0.35), (0, 0, -1.3), 0.1, 0.06)]
    volume.d = shell
    volume.cut(*air)
    np.minimum(volume.d, matter, out=volume.d)
    volume.rough((0.1, 0.014), (0.03, 0.01), (0, 0.8 * volume.h))
    volume.tunnels(200, -0.03, 0.2, 0.012)
    inner = lambda p: within(p) - F(0.03)
    outer = lambda p: -inner(p)
    return volume, [outer, inner]


def bone(voxels):
    """The upper end of a thigh bone: a wall, and within it a fine net."""
    volume = Volume((-0.5, -0.5, -1.1), (0.85, 0.5, 0.95), voxels, 9)
    parts = [capsule((0, 0, -1.05), (0, 0, 0.2), 0.19, 0.24), chain([(0.1, 0, 0.3), (0.42, 0, 0.55)], [0.17, 0.3]),
             ellipsoid((-0.17, 0, 0.42), (0.2, 0.22, 0.27))]
    volume.of(parts).rough((0.2, 0.01))
    net = np.abs(volume.gyroid(0.09, 0.02)) - F(0.011)
    # The net fills the end alone.
    np.maximum(net, F(-0.15) - volume.p[2] + 0 * volume.d, out=net)
    np.maximum(net, volume.d, out=net)
    volume.hollow(0.035)
    np.minimum(volume.d, net, out=volume.d)
    del net
    volume.rough((0.03, 0.003), (0, 0.4 * volume.h))
    return volume.tunnels(300, 0, 0.09, 0.012), parts


def noisy(parts, box, voxels, seed, waves, wall=0, tunnels=None):
    volume = Volume(*box, voxels, seed).of(parts).rough(*waves)
    if wall:
        volume.hollow(wall)
    volume.rough((0, 0.5 * volume.h))
    if tunnels:
        volume.tunnels(*tunnels)
    return volume, parts


BLOBS = (-1.4, -0.7, -0.7), (1.2, 0.7, 0.7)
ANIMAL = (-1.6, -0.6, -1.15), (1.4, 0.6, 0.9)
OCTOPUS = (-1.4, -1.4, -0.65), (1.4, 1.4, 0.9)
WAVES = (0.3, 0.025), (0.1, 0.012), (0.04, 0.006)
FAINT = (0.3, 0.01), (0.1, 0.005)
FINE = (0.3, 0.012), (0.08, 0.008), (0.03, 0.005)
# `v` scales the number of voxels along the longest edge.
SHAPES = {
    "blobs": lambda v: noisy(spheres(), BLOBS, v(190), 0, WAVES),
    "blobs-hollow": lambda v: noisy(spheres(), BLOBS, v(250), 1, WAVES, 0.09, (60, -0.03, 0.25, 0.02)),
    "animal-tunnels": lambda v: noisy(animal(), ANIMAL, v(420), 2, WAVES, 0, (250, -0.02, 0.3, 0.012)),
    "animal-hollow": lambda v: noisy(animal(), ANIMAL, v(460), 3, FAINT, 0.035, (150, -0.01, 0.1, 0.012)),
    "octopus": lambda v: noisy(octopus(), OCTOPUS, v(520), 4, FINE, 0, (100, -0.01, 0.1, 0.01)),
    "cortex": lambda v: cortex(v(260)),
    "brain": lambda v: brain(v(300), 6),
    "brain-fine": lambda v: brain(v(560), 7),
    "head": lambda v: head(v(300)),
    "bone": lambda v: bone(v(600)),
}


def write_ply(path, vertices, faces):
    header = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
              f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("v", "<i4", 3)])
    rows["n"], rows["v"] = 3, faces
    with open(path, "wb") as file:
        file.write(header.encode())
        vertices.astype("<f4").tofile(file)
        rows.tofile(file)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--scale", type=float, default=1)
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(SHAPES))
    arg = parser.parse_args()
    os.makedirs(arg.folder, exist_ok=True)
    for name in arg.only:
        volume, parts = SHAPES[name](lambda voxels: round(voxels * arg.scale))
        vertices, faces = volume.surface()
        centroids = vertices[faces].mean(axis=1).T
        truth = np.argmin([part(centroids) for part in parts], axis=0).astype(np.uint32)
        write_ply(f"{arg.folder}/{name}.ply", vertices, faces)
        np.save(f"{arg.folder}/{name}.truth.npy", truth)
        print(f"{name:16} {volume.shape} voxels, {len(faces):9,} faces, {truth.max() + 1} parts", flush=True)


if __name__ == "__main__":
    main()
