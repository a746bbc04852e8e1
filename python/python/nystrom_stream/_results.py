"""What the functions return. All of it can be pickled: a mesh goes with its arrays."""

import html
import json
import os
import tempfile

import numpy as np

from . import _native


def _pickled(mesh):
    return {"vertices": np.asarray(mesh.vertices(), np.float64), "polygons": mesh.polygons(),
            "single": mesh.vertices().dtype == np.float32}


def _unpickled(state):
    starts, corners = state["polygons"]
    counts = np.diff(starts)
    vertices = state["vertices"].astype(np.float32) if state["single"] else state["vertices"]
    if len(counts) and (counts == counts[0]).all():
        return _native.Mesh.from_arrays(vertices, corners.reshape(len(counts), -1))
    return _native.Mesh.from_polygons(vertices.astype(np.float64), starts, corners)


class _OfMesh:
    """A result that holds its mesh."""

    def __getstate__(self):
        return {**self.__dict__, "_mesh": _pickled(self._mesh)}

    def __setstate__(self, state):
        self.__dict__.update(state)
        self._mesh = _unpickled(state["_mesh"])

    def _as_mesh(self):
        return self._mesh

    @property
    def vertices(self):
        """Positions of the mesh: (vertices, 3)."""
        return self._mesh.vertices()

    @property
    def triangles(self):
        """Its faces as triangles, polygons as fans: (triangles, 3) uint32."""
        return self._mesh.triangles()[0]


class Segmentation(_OfMesh):
    """A mesh cut into parts. `len(cut)` is the number of parts, `cut[k]` the faces of part k.

    labels: (faces,) uint32, the part of each face, from 0, in the order of the mesh.
    quality: (faces,) float32, how sure each label is, 0 to 1; None for a cut from the hierarchy.
    colours: (parts, 3) uint8, one sRGB colour per part, unlike where parts touch.
    report: a dict with counts of the mesh, parts with their areas, landmarks, eigenvalues, seconds by stage.
    """

    def __init__(self, mesh, labels, quality, colours, tree, cells, report):
        self._mesh, self.labels, self.quality, self.colours = mesh, labels, quality, colours
        self._tree, self._cells, self.report = tree, cells, report

    @property
    def n_parts(self):
        """Number of parts."""
        return len(self.colours)

    @property
    def tree(self):
        """The hierarchy of parts over some two thousand cells, as a dict; None for K-means and 2-means."""
        return None if self._tree is None else json.loads(self._tree)

    def recut(self, parts):
        """Labels of the same mesh in exactly `parts` parts, from the hierarchy: (faces,). Takes milliseconds; boundaries follow
        cells, so for boundaries as fine as those of `labels` cut again with the same `work_dir`.

        Raises ValueError for K-means and 2-means, and for more parts than cells.
        """
        if self._tree is None:
            raise ValueError("K-means and 2-means have no hierarchy")
        return _native.cut_tree(self._tree, self._cells, parts)

    def cut(self, parts):
        """The same mesh in exactly `parts` parts, as `recut` finds them, with colours; confidences are not known."""
        labels = self.recut(parts)
        colours = _native.part_colours(self._mesh, labels)
        report = {"input": self.report["input"], "options": self.report["options"]}
        counts = np.bincount(labels, minlength=len(colours))
        report["parts"] = [{"label": k, "faces": int(n), "colour": colours[k].tolist()} for k, n in enumerate(counts)]
        return Segmentation(self._mesh, labels, None, colours, self._tree, self._cells, report)

    def measure(self):
        """What each part measures: a list of dicts with area, volume (of closed parts), box, centroid, axes, spread, open_edges and
        neighbours with the length of the common border."""
        return json.loads(_native.measure_parts(self._mesh, self.labels, self.n_parts))

    def save(self, path):
        """Writes the labelled mesh in the form that the ending names: .ply, .seg, .npy, .glb, .parquet, .png, .html, or one PLY per
        part in a folder where `path` ends with a slash. Raises ValueError for another ending, OSError."""
        report = json.dumps(self.report)
        _native.save(self._mesh, self.labels, self.colours, self.quality, path, report, self._tree, self._cells)

    def picture(self, **options):
        """A picture of the parts: see `nystrom_stream.picture`."""
        from ._functions import picture

        return picture(self, **options)

    def to_trimesh(self):
        """A trimesh.Trimesh with the colours of the parts, and their numbers as `face_attributes["label"]`."""
        import trimesh

        triangles, face = self._mesh.triangles()
        labels = self.labels[face]
        mesh = trimesh.Trimesh(self.vertices, triangles, process=False, face_attributes={"label": labels})
        mesh.visual.face_colors = self.colours[labels]
        return mesh

    def to_pyvista(self):
        """A pyvista.PolyData with `label`, `quality` and `RGB` on its cells."""
        import pyvista

        starts, corners = self._mesh.polygons()
        counts = np.diff(starts).astype(np.int64)
        mesh = pyvista.PolyData(self.vertices, np.insert(corners.astype(np.int64), starts[:-1].astype(np.int64), counts))
        mesh.cell_data["label"] = self.labels
        mesh.cell_data["RGB"] = self.colours[self.labels]
        if self.quality is not None:
            mesh.cell_data["quality"] = self.quality
        return mesh

    def __len__(self):
        return self.n_parts

    def __getitem__(self, part):
        """The faces of a part: (faces of the part,), ascending. Raises IndexError."""
        part = range(self.n_parts)[part]
        return np.flatnonzero(self.labels == part)

    def __repr__(self):
        return f"Segmentation({len(self.labels)} faces, {self.n_parts} parts)"

    def _repr_html_(self):
        """The page that turns, as Jupyter shows it; some 4 MB at most."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "page.html")
            self.save(path)
            with open(path, encoding="utf-8") as page:
                text = page.read()
        return (f'<iframe srcdoc="{html.escape(text, quote=True)}" width="100%" height="600" '
                f'style="border:0" title="{html.escape(repr(self))}"></iframe>')


class Correspondence:
    """Matches of the vertices of a mesh A in a mesh B.

    matches: (vertices of A,) int64, the vertex of B, -1 without one.
    distances: (vertices of A,) float32, in the embedding, infinite without a match.
    confidence: (vertices of A,) float32, how sure each match is, 0 to 1.
    report: the alignments that fit, whether the shape leaves a choice (`ambiguous`), and facts of both meshes.
    """

    def __init__(self, matches, distances, confidence, report):
        self.matches, self.distances, self.confidence, self.report = matches, distances, confidence, report

    def save(self, path):
        """Writes the matches as .npy, .csv or .parquet. Raises ValueError for another ending, OSError."""
        _native.save_matches(self.matches, self.distances, self.confidence, path)

    def __repr__(self):
        return f"Correspondence({len(self.matches)} vertices)"


class Transfer(_OfMesh):
    """Labels carried to another mesh.

    labels: (faces,) uint32. quality: (faces,) float32, 1 where a label is sure. report: counts, with `uncertain` faces.
    """

    def __init__(self, mesh, labels, quality, report):
        self._mesh, self.labels, self.quality, self.report = mesh, labels, quality, report

    def __repr__(self):
        return f"Transfer({len(self.labels)} faces, {self.report['uncertain']} uncertain)"


class Sequence(_OfMesh):
    """An order of the faces of a mesh, and of its vertices by first use.

    places: (faces,) uint32, the place of each face. vertex_numbers: (vertices,) uint32, the new number of each vertex.
    measures: how well the order streams, a dict.
    """

    def __init__(self, mesh, places, vertex_numbers, measures):
        self._mesh, self.places, self.vertex_numbers, self.measures = mesh, places, vertex_numbers, measures

    @property
    def order(self):
        """The faces in their new order: (faces,) int64; `faces[order]` is the mesh to stream."""
        return np.argsort(self.places, kind="stable")

    def __repr__(self):
        return f"Sequence({len(self.places)} faces)"
