"""What the functions return. All of it can be pickled: a mesh goes with its arrays."""

import html
import json
import os
import tempfile

import numpy as np

from . import _native
from ._edits import as_edits, as_names, started, started_from, text_of


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
    names: a name per part, "" where it has none. Assign a list, or a dict by part: `cut.names = {0: "left arm"}`.
    """

    def __init__(self, mesh, arrays, report, options, edits=None):
        self._mesh, self.report, self._options, self._edits = mesh, report, options, edits
        self.labels, self.quality, self.colours, self._tree, self._cells, self._decision, names = arrays
        self.names = names

    @property
    def n_parts(self):
        """Number of parts."""
        return len(self.colours)

    @property
    def names(self):
        return list(self._names)

    @names.setter
    def names(self, names):
        self._names = as_names(names, self.n_parts, getattr(self, "_names", ()))
        for part, name in zip(self.report["parts"], self._names):
            part.pop("name", None)
            part.update({"name": name} if name else {})

    @property
    def edits(self):
        """The edits that the parts are of: a list of dicts."""
        return list(self._edits["edits"]) if self._edits else []

    def edit(self, edits, progress=None):
        """The mesh with its parts corrected: another Segmentation; this one stays.

        edits: a list, which is added to the edits that the parts are of, or the path of a file, such as the page saves, which
            replaces them. An edit is a dict: {"edit": "merge", "at": [place, place]}, {"edit": "split", "at": place, "into": 3},
            {"edit": "cut", "between": [place, place]}, "together" and "apart" like "merge", {"edit": "name", "at": place,
            "name": "left arm"}, {"edit": "colour", "at": place, "colour": "#e69f00"}, {"edit": "drop", "at": place},
            {"edit": "protect", "at": place}. A place is a point (x, y, z) on the surface or the number of a face; `place(part)` is
            one in the middle of a part.

        With the `work_dir` of the cut, only the parts and their boundaries are computed again; else all is. Raises ValueError for
        an edit that cannot be followed, naming it, and for K-means and 2-means.
        """
        whole = isinstance(edits, (str, os.PathLike)) or isinstance(edits, dict) and "edits" in edits
        told = as_edits(edits)
        if not whole:
            told = {**(self._edits or {}), **told, "edits": self.edits + told["edits"]}
        return cut_mesh(self._mesh, started_from(self._options, told), told, progress)

    def place(self, part):
        """A place well inside a part, for edits: the point (x, y, z) in the middle of a face. Raises IndexError."""
        part = range(self.n_parts)[part]
        triangles, face = self._mesh.triangles()
        own = self.labels[face] == part
        reached = np.zeros(len(self.vertices), bool)
        reached[triangles[~own]] = True
        left = np.flatnonzero(own)
        while True:
            near = reached[triangles[left]].any(axis=1)
            if near.all() or not near.any():
                break
            reached[triangles[left[near]]] = True
            left = left[~near]
        centres = np.asarray(self.vertices, np.float64)[triangles[left]].mean(axis=1)
        return centres[np.argmin(np.linalg.norm(centres - centres.mean(axis=0), axis=1))].tolist()

    def save_edits(self, path):
        """Writes the edits as a file that `nystrom-stream segment --edits` and `edit` take."""
        vertices = self.vertices
        box = [vertices.min(axis=0), vertices.max(axis=0)] if len(vertices) else None
        head = {"box": box} if box and np.isfinite(box).all() else {}
        with open(path, "w", encoding="utf-8") as file:
            file.write(text_of({**head, **started(self._options), **as_edits(self._edits or [])}) + "\n")

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
        """The same mesh in exactly `parts` parts, as `recut` finds them, with colours; confidences are not known. Edits, hints and
        names are left behind."""
        labels = self.recut(parts)
        colours = _native.part_colours(self._mesh, labels)
        report = {"input": self.report["input"], "options": self.report["options"]}
        counts = np.bincount(labels, minlength=len(colours))
        report["parts"] = [{"label": k, "faces": int(n), "colour": colours[k].tolist()} for k, n in enumerate(counts)]
        decision = self._decision and self._decision.without_start()
        arrays = labels, None, colours, self._tree, self._cells, decision, []
        options = {**started_from(self._options, {"parts": parts}), "hints": None}
        return Segmentation(self._mesh, arrays, report, options)

    def measure(self):
        """What each part measures: a list of dicts with area, volume (of closed parts), box, centroid, axes, spread, open_edges and
        neighbours with the length of the common border."""
        return json.loads(_native.measure_parts(self._mesh, self.labels, self.n_parts))

    def save(self, path, *, vertex_labels=False, split_vertices=False, split_faces=False, cap=False, part_form="ply"):
        """Writes the labelled mesh in the form that the ending names: .ply, .seg, .npy, .obj, .glb, .parquet, .png, .html, or one file
        per part in a folder where `path` ends with a slash.

        Of a .ply: `vertex_labels` gives vertices labels and colours too, `split_vertices` gives each part vertices of its own,
        `split_faces` splits triangles where smooth boundaries cross them (not with the other two). Of a folder: `cap` closes the parts where
        they were cut off, `part_form` is "ply" or "stl". Raises ValueError for another ending, or an option that the form does not have;
        OSError."""
        edits = text_of(self._edits) if self._edits else None
        _native.save(self._mesh, self.labels, self.colours, self.quality, self.names, path, json.dumps(self.report), self._tree,
                     self._cells, self._decision, edits, (vertex_labels, split_vertices, split_faces, cap, part_form))

    def picture(self, **options):
        """A picture of the parts: see `nystrom_stream.picture`."""
        from ._functions import picture

        return picture(self, **options)

    def to_trimesh(self):
        """A trimesh.Trimesh with the colours of the parts, and their numbers as `face_attributes["label"]`, their names as `metadata["part_names"]`."""
        import trimesh

        triangles, face = self._mesh.triangles()
        labels = self.labels[face]
        mesh = trimesh.Trimesh(self.vertices, triangles, process=False, face_attributes={"label": labels})
        mesh.visual.face_colors = self.colours[labels]
        mesh.metadata["part_names"] = self.names
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
        if any(self.names):
            mesh.field_data["part_names"] = self.names
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


def cut_mesh(mesh, options, edits, progress):
    """Cuts a mesh with all `options` told, and corrects it."""
    order = ("hints", "seed", "threads", "max_memory", "work_dir", "force", "tmp")
    text = None if edits is None else text_of(edits)
    *arrays, report = _native.segment(mesh, options["params"], text, *(options[name] for name in order), progress)
    # A work directory that was made anew for this mesh is its own from now on.
    options = {**options, "force": False}
    return Segmentation(mesh, arrays, json.loads(report), options, json.loads(text) if text else None)


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
