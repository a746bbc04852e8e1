#!/usr/bin/env python3
"""What share of a surface is cut differently on its other side, by mirror planes and by maps of posed bodies: the tables of "Both
sides alike" and "Posed bodies" in docs/dev/segmentation-experiments.md.

    tools/both_sides.py [--posed | --standing MESH] OUT MESH... [-- OPTIONS of segment]

OUT keeps labels and maps, and what it has is not made again: each way needs its own. The program's own planes and maps are not used. By
default a plane is sought: one of the principal ones, moved to where it maps faces best onto faces. If their mean distance from their
images is at most .0126 √area, each face is compared with the eight nearest to its mirror image.

With `--posed` a map is sought along the surface, from signs of the first eight eigenfunctions of the Laplacian and from tips of limbs,
refined with more functions (ZoomOut), and then such that distances stay the same. Of those that reverse orientation in the middle of the
surface the best is taken. A face is compared with those within .03 √area of its image. With `--standing` the meshes share their numbering
with a mesh that stands symmetrically, and its plane gives the map.

Parts of both sides are paired by greatest overlap, by area. A face is cut differently if none of those that it is compared with is in the
twin of its part. A line per mesh: mean distance from images, or change of distances; orientation, -1 if it is reversed; the share that is
cut differently. Needs NumPy, SciPy and plyfile, and BIN or a release build. A second or two a plane, some ten a map.
"""
import argparse
import itertools
import os
import pathlib
import subprocess

import numpy as np
import scipy.sparse as sp
from plyfile import PlyData
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import eigsh
from scipy.spatial import cKDTree

from steadiness import split_words

BIN = os.environ.get("BIN", "target/release/nystrom-stream")
# Distances in √area: of planes, the two bounds of the tables; of maps, the greatest mean change of distances; around an image.
PLANES, STRETCH, NEAR = (0.006, 0.0126), 0.05, 0.03
# Greatest orientation of a map, samples, functions, and least area of a single piece.
TURNED, SAMPLES, FUNCTIONS, WHOLE = -0.4, 400, 40, 0.97


class Mesh:
    """A triangle mesh of area 1 around the origin, one vertex at each position."""

    def __init__(self, path):
        ply = PlyData.read(path, known_list_len={"face": {"vertex_indices": 3}})
        points = np.stack([np.asarray(ply["vertex"][axis], float) for axis in "xyz"], axis=1)
        corners = np.stack(list(ply["face"]["vertex_indices"]))
        points, place = np.unique(points, axis=0, return_inverse=True)
        self.corner = place.ravel()[corners]
        a, b, c = (points[self.corner[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        twice = np.linalg.norm(across, axis=1)
        self.normal, unit = across / np.maximum(twice, 1e-300)[:, None], np.sqrt(twice.sum() / 2)
        self.area = twice / 2 / unit**2
        middle = np.average((a + b + c) / 3, axis=0, weights=self.area)
        self.point, self.centre = (points - middle) / unit, ((a + b + c) / 3 - middle) / unit

    def edges(self):
        """Lengths of edges, and of the paths between the opposite corners of two triangles: a graph of the vertices."""
        ends = np.concatenate([self.corner[:, [k, (k + 1) % 3]] for k in range(3)])
        apex = np.concatenate([self.corner[:, (k + 2) % 3] for k in range(3)])
        low, high = ends.min(1), ends.max(1)
        order = np.lexsort((high, low))
        same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
        across = np.c_[apex[order][1:][same], apex[order][:-1][same]]
        pairs = np.unique(np.sort(np.concatenate([ends, across]), axis=1), axis=0)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        length = np.maximum(np.linalg.norm(self.point[pairs[:, 0]] - self.point[pairs[:, 1]], axis=1), 1e-12)
        return sp.csr_matrix((length, pairs.T), (len(self.point),) * 2)

    def functions(self, count):
        """The first eigenfunctions of the Laplacian (vertices × count), and the mass of each vertex."""
        n, weights = len(self.point), []
        for k in range(3):
            i, j, apex = (self.corner[:, (k + step) % 3] for step in range(3))
            u, v = self.point[i] - self.point[apex], self.point[j] - self.point[apex]
            sine = np.maximum(np.linalg.norm(np.cross(u, v), axis=1), 1e-9)
            weights.append(sp.coo_matrix(((u * v).sum(1) / sine / 2, (i, j)), (n, n)))
        weights = sum(weights).tocsr()
        weights = weights + weights.T
        mass = np.bincount(self.corner.ravel(), np.repeat(self.area / 3, 3), n) + 1e-12
        laplacian = sp.diags(np.asarray(weights.sum(1)).ravel()) - weights
        return eigsh(laplacian, count, sp.diags(mass), sigma=-0.01, which="LM", v0=np.ones(n))[1], mass


def plane(mesh):
    """The mirror image of each face's centroid, and the mean distance from it to the nearest face, of the best plane."""
    radius = 1 / np.sqrt(2000 * np.pi)
    where = lambda centre, normal: np.hstack([centre, 2 * radius * normal])
    tree, best = cKDTree(where(mesh.centre, mesh.normal)), None
    mirror = lambda x, axis, offset: x - 2 * np.outer(x @ axis - offset, axis)
    drawn = np.random.default_rng(0).choice(len(mesh.area), 2000, p=mesh.area / mesh.area.sum())
    mine = mesh.centre[drawn], mesh.normal[drawn]
    for axis in np.linalg.eigh((mesh.centre * mesh.area[:, None]).T @ mesh.centre)[1].T:
        offset = 0.0
        for _ in range(20):
            images = where(mirror(mine[0], axis, offset), mirror(mine[1], axis, 0.0))
            far, nearest = tree.query(images)
            score = np.minimum(np.linalg.norm(images[:, :3] - mesh.centre[nearest], axis=1), 0.1).mean()
            if best is None or score < best[0] - 1e-9:
                best = score, axis, offset
            # The plane that takes points to those now nearest to their images, in the sense of least squares.
            close = far < max(3 * radius, np.median(far))
            here, there, normals = mine[0][close], mesh.centre[nearest][close], (mine[1][close], mesh.normal[nearest][close])
            middle = (here.mean(0), there.mean(0))
            both = (here - middle[0]).T @ (there - middle[1]) + radius**2 * normals[0].T @ normals[1]
            new = np.linalg.eigh(both + both.T)[1][:, 0]
            new *= np.sign(new @ axis)
            moved, axis, offset = abs(1 - new @ axis), new, (middle[0] + middle[1]) @ new / 2
            if moved < 1e-9:
                break
    images = where(mirror(mesh.centre, *best[1:]), mirror(mesh.normal, best[1], 0.0))
    far = np.linalg.norm(images[:, :3] - mesh.centre[tree.query(images)[1]], axis=1)
    return images[:, :3], np.average(np.minimum(far, 0.1), weights=mesh.area)


class Maps:
    """Maps of a surface onto itself, by functions on its vertices."""

    def __init__(self, mesh):
        self.mesh, self.graph = mesh, mesh.edges()
        self.function, self.mass = mesh.functions(FUNCTIONS)
        # Farthest points, each with the mass that is nearest to it, and their distances.
        rows, self.sample = [], [int(np.argmax(np.linalg.norm(mesh.point, axis=1)))]
        near, self.owner = np.full(len(mesh.point), np.inf), np.zeros(len(mesh.point), int)
        while True:
            row = dijkstra(self.graph, False, self.sample[-1])
            self.owner[row < near] = len(rows)
            near = np.minimum(near, row)
            rows.append(row)
            if len(rows) == min(SAMPLES, len(mesh.point) // 2):
                break
            self.sample.append(int(np.argmax(np.where(np.isfinite(near), near, -1))))
        self.row, self.sample = np.minimum(rows, 10.0), np.array(self.sample)
        self.share = np.bincount(self.owner, self.mass, len(rows)) / self.mass.sum()
        self.apart = self.row[:, self.sample]
        # Limbs may turn about themselves: orientation is that of the half of the surface that is nearest to all of it.
        mean = self.share @ self.row
        order = np.argsort(mean)
        self.is_middle = mean <= mean[order[np.searchsorted(np.cumsum(self.mass[order]), self.mass.sum() / 2)]]

    def stretch(self, image):
        """The mean change of distances between samples."""
        return self.share @ np.abs(self.apart - self.apart[np.ix_(image, image)]) @ self.share

    def refined(self, image, low, high):
        """A map of the samples, refined with more and more functions."""
        values = self.function[self.sample]
        for k in range(low, high + 1, 2 if low < 12 else 4):
            here, there = values[:, :k], values[image, :k]
            c = np.linalg.lstsq(here * self.share[:, None] ** 0.5, there * self.share[:, None] ** 0.5, rcond=None)[0]
            image = nearest(here @ c, here)
        return image

    def by_signs(self):
        """Maps of the samples by signs of the second to the eighth function."""
        values = self.function[self.sample, :8]
        for signs in itertools.product([1.0, -1.0], repeat=7):
            if min(signs) < 0:
                yield nearest(values * np.array([1.0, *signs]), values)

    def by_tips(self):
        """Maps of the samples by involutions of the tips: local maxima of the mean distance."""
        mean = self.share @ self.apart
        tips = [i for i in np.argsort(-mean) if mean[i] >= mean[self.apart[i] < 0.12].max()][:12]
        apart, found = self.apart[np.ix_(tips, tips)], []

        def visit(i, image):
            if len(found) > 20000:
                return
            while i < len(tips) and i in image:
                i += 1
            if i == len(tips):
                if any(b not in (a, None) for a, b in image.items()):
                    found.append(dict(image))
                return
            for j in range(i, len(tips)):
                fits = all(abs(apart[i, a] - apart[j, b]) < 0.12 + 0.12 * apart[i, a] for a, b in image.items() if b is not None)
                if j not in image and fits and abs(mean[tips[i]] - mean[tips[j]]) < 0.12:
                    visit(i + 1, {**image, i: j, j: i})
            visit(i + 1, {**image, i: None})

        visit(0, {})
        cost = lambda image: (np.mean([abs(apart[a, c] - apart[b, d]) for (a, b), (c, d) in itertools.product(
            [pair for pair in image.items() if pair[1] is not None], repeat=2)]) + 0.05 * sum(b is None for b in image.values()))
        for image in sorted(found, key=cost)[:24]:
            pairs = [(tips[a], tips[b]) for a, b in image.items() if b is not None]
            there = self.apart[[a for a, _ in pairs]].T
            yield nearest(there, self.apart[[b for _, b in pairs]].T)

    def likeliest(self, maps, count):
        """Those of the maps of samples that preserve distances best, no two of them nearly equal, which move the surface."""
        kept = []
        for image in sorted(maps, key=self.stretch):
            moves = self.share @ (self.apart[np.arange(len(image)), image] > 0.15) > 0.4
            if moves and all(self.share @ (self.apart[image, other] > 0.1) > 0.1 for other in kept):
                kept.append(image)
            if len(kept) == count:
                break
        return kept

    def settled(self, image):
        """A map of the samples whose images preserve distances best, one by one, above all those from samples nearby."""
        weight = self.share / (self.apart + 0.05)
        for _ in range(6):
            image = np.array([np.argmin(np.abs(self.apart[:, image] - row) @ w) for row, w in zip(self.apart, weight)])
        return image

    def best(self):
        """The image of each vertex, the change of distances, and the orientation; `None` for no image."""
        starts = [*self.likeliest(self.by_signs(), 24), *self.likeliest(self.by_tips(), 12)]
        maps = self.likeliest([self.refined(image, 8, 14) for image in starts], 8)
        best = None, np.inf, 1.0
        for image in self.likeliest([self.settled(self.refined(image, 14, FUNCTIONS)) for image in maps], 8):
            whole, stretch = self.completed(image), self.stretch(image)
            turn = self.orientation(whole)
            if turn <= TURNED and stretch < best[1]:
                best = whole, stretch, turn
        return best if best[1] <= STRETCH else (None, *best[1:])

    def completed(self, image):
        """The map of all vertices that a map of the samples gives: they are as far from the images of samples nearby."""
        whole = np.zeros(len(self.owner), int)
        for k, row in enumerate(self.row):
            mine = np.flatnonzero(self.owner == k)
            near = np.argsort(self.apart[k])[:24]
            there = np.flatnonzero(self.row[image[k]] < row[mine].max() + 0.05)
            weight = 1 / (self.apart[k, near] + 0.05)
            far = sum(w * np.abs(self.row[s, mine][:, None] - self.row[image[s], there]) for w, s in zip(weight, near))
            whole[mine] = there[far.argmin(1)]
        return whole

    def orientation(self, image):
        """1 if triangles in the middle keep their orientation, -1 if all are reversed; images are smoothed first."""
        corner = self.mesh.corner
        ends = np.concatenate([corner[:, [k, (k + 1) % 3]] for k in range(3)])
        ring = sp.csr_matrix((np.ones(len(ends)), ends.T), (len(image),) * 2)
        ring = ring + ring.T + sp.identity(len(image))
        ring = sp.diags(1 / np.asarray(ring.sum(1)).ravel()) @ ring
        normal = np.zeros_like(self.mesh.point)
        np.add.at(normal, corner.ravel(), np.repeat(self.mesh.normal * self.mesh.area[:, None], 3, axis=0))
        there, normal = self.mesh.point[image], normal[image]
        for _ in range(20):
            there, normal = ring @ there, ring @ normal
        a, b, c = (there[corner[:, k]] for k in range(3))
        normal = normal[corner].sum(1)
        spin = (np.cross(b - a, c - a) * normal).sum(1) / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
        spin *= self.is_middle[corner].all(1)
        return spin.sum() / max(np.abs(spin).sum(), 1e-300)


def nearest(points, among):
    """The number of the nearest row of `among` for each row of `points`."""
    points, among = (np.asarray(x, np.float32) for x in (points, among))
    half = (among * among).sum(1) / 2
    return np.concatenate([np.argmin(half - block @ among.T, axis=1) for block in np.array_split(points, max(1, len(points) // 512))])


def symmetry(mesh, posed, standing):
    """`plane`, `map`, or `none`; images of the faces' centroids, change of distances, orientation."""
    if standing is not None:
        images, far = plane(standing)
        return "map", mesh.centre[cKDTree(standing.centre).query(images)[1]], far, -1.0
    if not posed:
        images, far = plane(mesh)
        return "plane" if far <= PLANES[1] else "none", images, far, -1.0
    pieces = connected_components(mesh.edges(), False)[1][mesh.corner[:, 0]]
    if np.bincount(pieces, mesh.area).max() < WHOLE:
        return "none", np.full_like(mesh.centre, np.nan), np.nan, 1.0
    image, stretch, turn = Maps(mesh).best()
    if image is None:
        return "none", np.full_like(mesh.centre, np.nan), stretch, turn
    return "map", mesh.point[image][mesh.corner].mean(1), stretch, turn


def differently(mesh, images, labels, kind):
    """The share of the area that is cut differently on the other side."""
    tree, count = cKDTree(mesh.centre), labels.max() + 1
    if kind == "plane":
        there = [list(row) for row in tree.query(images, 8)[1]]
    else:
        there = tree.query_ball_point(images, NEAR)
    nearest = tree.query(images)[1]
    overlap = np.bincount(labels * count + labels[nearest], mesh.area, count * count).reshape(count, count)
    twin = (overlap + overlap.T).argmax(1)
    other = np.array([twin[label] not in labels[[*near, at]] for label, near, at in zip(labels, there, nearest)])
    return mesh.area[other].sum()


def main():
    words, options = split_words()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("meshes", nargs="+", type=pathlib.Path)
    parser.add_argument("--posed", action="store_true")
    parser.add_argument("--standing", type=pathlib.Path, metavar="MESH")
    arg = parser.parse_args(words)
    arg.out.mkdir(parents=True, exist_ok=True)
    standing = arg.standing and Mesh(arg.standing)
    rows = []
    print(f"{'mesh':28} {'':6} {'change':>7} {'turned':>7} {'differently':>11}")
    for path in arg.meshes:
        labels, kept = arg.out / f"{path.stem}.npy", arg.out / f"{path.stem}.map.npz"
        if not labels.exists():
            subprocess.run([BIN, "segment", path, "-q", "-o", labels, *options], check=True)
        mesh = Mesh(path)
        if not kept.exists():
            kind, images, change, turned = symmetry(mesh, arg.posed, standing)
            np.savez(kept, kind=kind, images=images, change=change, turned=turned)
        found = np.load(kept)
        kind, change, turned = str(found["kind"]), float(found["change"]), float(found["turned"])
        share = differently(mesh, found["images"], np.load(labels).astype(int), kind) if kind in ("plane", "map") else np.nan
        rows.append((kind, change, share))
        print(f"{path.stem[:28]:28} {kind:6} {change:7.4f} {turned:7.2f} {share:11.4f}", flush=True)
    for name, kind, most in (("planes", "plane", PLANES[0]), ("planes", "plane", PLANES[1]), ("maps", "map", STRETCH)):
        shares = np.array([share for at, change, share in rows if at == kind and change <= most])
        if len(shares):
            print(f"{len(shares)} {name} up to {most}: {shares.mean():.4f} cut differently, more than .05 on {(shares > 0.05).sum()}")


if __name__ == "__main__":
    main()
