"""The results of the functions. All can be copied and pickled: copies share the mesh, which never changes; a pickle contains its
arrays."""

from __future__ import annotations

import copy
import html
import json
import os
import tempfile
from collections.abc import Mapping, Sequence as Several
from typing import TYPE_CHECKING, Any, Optional

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._edits import Edits, Names, as_edits, as_names, protects, started, started_from, text_of
from ._meshes import (
    MOST, Path, Progress, as_colours, as_labels, as_path, as_quality, flag, listed, number_parts, packed, part_number, unmasked, whole
)

if TYPE_CHECKING:
    import pyvista
    import trimesh


def publish(path: str, text: str) -> None:
    """Writes `text` to the file `path`, which is as it was if that fails; directly to what is no file, as a pipe."""
    if os.path.exists(path) and not os.path.isfile(path):
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
        return
    _native.publish(os.path.realpath(path), text)


class _OfMesh:
    """A result that holds its mesh."""

    _mesh: _native.Mesh

    def _as_mesh(self) -> _native.Mesh:
        return self._mesh

    @property
    def vertices(self) -> NDArray[Any]:
        """Positions of the mesh: (vertices, 3)."""
        return self._mesh.vertices()

    @property
    def triangles(self) -> NDArray[np.uint32]:
        """Its faces as triangles, with polygons split: (triangles, 3) uint32."""
        return self._mesh.triangles()[0]


class _Labelled(_OfMesh):
    """A result with labels, which can be saved and shown."""

    labels: NDArray[np.uint32]
    quality: Optional[NDArray[np.float32]]
    report: dict[str, Any]
    _names: list[str]
    # Found when they are asked for: labels may be any numbers, and there is a colour for each up to the greatest.
    _colours: Optional[NDArray[np.uint8]] = None
    # Labels on the finer triangles of a proxy, for `split_faces`.
    _fine: Optional[tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32], int, int]] = None
    # What the labels were cut from, for a page.
    _cells: Optional[NDArray[np.uint32]] = None
    _decision: Optional[_native.Decision] = None
    _edits: Optional[dict[str, Any]] = None

    @property
    def colours(self) -> NDArray[np.uint8]:
        if self._colours is None:
            if not number_parts(self.labels):
                remedy = "number the parts from 0, as numpy.unique(labels, return_inverse=True)[1] does"
                raise ValueError(f"labels: {self.labels.max()} is too great for a colour by label; {remedy}")
            self._colours = _native.part_colours(self._mesh, self.labels)
        return self._colours

    @colours.setter
    def colours(self, colours: ArrayLike) -> None:
        # There are as many parts as before, however many colours a palette has.
        parts = None if self._colours is None else len(self._colours)
        # A copy: whoever gave the palette may change it.
        self._colours = as_colours(colours, parts or 0)[:parts].copy()

    def save(self, path: Path, *, vertex_labels: bool = False, split_vertices: bool = False, split_faces: bool = False, cap: bool = False,
             part_form: str = "ply") -> None:
        """Writes the labelled mesh in the format of the extension: .ply, .seg, .npy, .obj, .glb, .parquet, .csv, .png, .html, or one file
        per part in a folder where `path` ends with a slash, is a folder, or is a pathlib.Path without extension. A .csv has one row per
        part, with what `Segmentation.measure` returns; .seg and .npy have the labels alone.

        For .ply: `vertex_labels` labels and colours vertices too, `split_vertices` gives each part its own vertices, `split_faces` splits
        triangles where smooth boundaries cross them (not with the other two). For a folder: `cap` closes the parts where they were cut
        off, `part_form` is "ply" or "stl". Raises ValueError for another extension, or an option that the format does not have;
        OSError. Warns of what the format loses."""
        edits = text_of(self._edits) if self._edits else None
        choices = (flag("vertex_labels", vertex_labels), flag("split_vertices", split_vertices), flag("split_faces", split_faces),
                   flag("cap", cap), part_form)
        if not isinstance(part_form, str):
            raise TypeError(f"part_form: {part_form!r}; choose ply or stl")
        # A pathlib.Path has no slash at its end.
        if isinstance(path, os.PathLike) and not os.path.splitext(path)[1]:
            path = os.path.join(path, "")
        labels, names = as_labels(self.labels, self._mesh.faces), self._names if any(self._names) else []
        quality = None if self.quality is None else as_quality(self.quality, self._mesh.faces)
        # Labels alone may be any numbers.
        bare = self._colours is None and as_path("path", path).lower().endswith((".npy", ".seg"))
        # Labels may have been assigned; the other formats check them as they are written.
        least = int(labels.max()) + 1 if as_path("path", path).lower().endswith((".csv", ".html")) else 0
        colours = np.zeros((0, 3), np.uint8) if bare else as_colours(self.colours, least)
        _native.save(self._mesh, labels, colours, quality, names, as_path("path", path), json.dumps(self.report),
                     self._fine, self._cells, self._decision, edits, choices)

    def picture(self, **options: Any) -> NDArray[np.uint8]:
        """A picture of the parts: see `nystrom_stream.picture`."""
        from ._functions import picture

        return picture(self, **options)

    def to_trimesh(self) -> trimesh.Trimesh:
        """A trimesh.Trimesh with the colours of the parts, and their numbers as `face_attributes["label"]`, their names as `metadata["part_names"]`."""
        import trimesh

        triangles, face = self._mesh.triangles()
        labels = as_labels(self.labels, self._mesh.faces)[face]
        mesh = trimesh.Trimesh(self.vertices, triangles, face_colors=self.colours[labels], process=False,
                               face_attributes={"label": labels})
        mesh.metadata["part_names"] = list(self._names)
        return mesh

    def to_pyvista(self) -> pyvista.PolyData:
        """A pyvista.PolyData with `label`, `quality` and `RGB` on its cells, and the names of the parts in `field_data["part_names"]`; letters
        beyond ASCII, which VTK does not take there, are escaped."""
        import pyvista

        labels = as_labels(self.labels, self._mesh.faces)

        starts, corners = self._mesh.polygons()
        counts = np.diff(starts).astype(np.int64)
        mesh = pyvista.PolyData(self.vertices, np.insert(corners.astype(np.int64), starts[:-1].astype(np.int64), counts))
        mesh.cell_data["label"] = labels
        mesh.cell_data["RGB"] = self.colours[labels]
        if self.quality is not None:
            mesh.cell_data["quality"] = self.quality
        if any(self._names):
            mesh.field_data["part_names"] = [name.encode("ascii", "backslashreplace").decode() for name in self._names]
        return mesh


class Segmentation(_Labelled):
    """A mesh cut into parts. `len(cut)` is the number of parts, `cut[k]` the faces of part k.

    labels: (faces,) uint32, the part of each face, from 0, in the order of the mesh.
    quality: (faces,) float32, the confidence of each label, 0 to 1; None for a cut from the hierarchy.
    colours: (parts, 3) uint8, one sRGB colour per part, different for parts that touch.
    report: a dict with counts of the mesh, parts with their areas, landmarks, eigenvalues, seconds by stage; of a cut from the
        hierarchy the parts without areas, and no more.
    names: a name per part, "" for none. Assign a list; or a dict by part, `cut.names = {0: "left arm"}`, or the path of a table, which
        leave the other names as they are.

    Whatever needs the mesh raises ValueError if its file has changed since.
    """

    def __init__(self, mesh: _native.Mesh, arrays: Several[Any], report: dict[str, Any], options: dict[str, Any],
                 edits: Optional[dict[str, Any]] = None) -> None:
        self._mesh, self.report, self._options, self._edits = mesh, report, options, edits
        self.labels, self.quality, self.colours, self._fine, self._cells, self._decision, names = arrays
        self.names = names

    @property
    def n_parts(self) -> int:
        """Number of parts."""
        return len(self.colours)

    @property
    def names(self) -> list[str]:
        return list(self._names)

    @names.setter
    def names(self, names: Names) -> None:
        self._names = as_names(names, self.n_parts, getattr(self, "_names", ()))
        # A copy has the same report, but names of its own.
        parts = [{key: value for key, value in part.items() if key != "name"} for part in self.report["parts"]]
        for part, name in zip(parts, self._names):
            part.update({"name": name} if name else {})
        self.report = {**self.report, "parts": parts}

    @property
    def edits(self) -> list[dict[str, Any]]:
        """The edits that were applied: a list of dicts."""
        return copy.deepcopy(self._edits["edits"]) if self._edits else []

    def edit(self, edits: Edits, progress: Progress = None) -> Segmentation:
        """Returns another Segmentation with corrected parts; this one is unchanged.

        edits: a list, which is added to the edits applied so far, or the path of a file, such as one saved by the page, which
            replaces them. An edit is a dict: {"edit": "merge", "at": [place, place]}, {"edit": "split", "at": place, "into": 3},
            {"edit": "cut", "between": [place, place]}, "together" and "apart" like "merge", {"edit": "name", "at": place,
            "name": "left arm"}, {"edit": "colour", "at": place, "colour": "#e69f00"}, {"edit": "drop", "at": place},
            {"edit": "protect", "at": place}. A place is a point (x, y, z) on the surface or the number of a face; `place(part)` returns
            one in the middle of a part.

        With the `work_dir` of the cut, only the parts and their boundaries are recomputed; otherwise everything is. Parts have the
        names of "name" edits; names that were assigned are dropped, since numbers of parts change. Raises ValueError for an edit that
        cannot be applied, naming it, and unless cluster="parts".
        """
        whole = isinstance(edits, (str, bytes, os.PathLike)) or isinstance(edits, Mapping) and "edits" in edits
        told = as_edits(edits)
        if whole:
            return cut_mesh(self._mesh, started_from(self._options, told), told, progress)
        told = {**(self._edits or {}), **told, "edits": self.edits + told["edits"]}
        if (protects(told) or self._is_ranged()) and told.get("parts") is None and told.get("detail") is None:
            told.update(self._start())
        return cut_mesh(self._mesh, self._options, told, progress)

    def _start(self) -> dict[str, Any]:
        """The cut that places are on, as in a file of edits: parts found within a range are as many as there are."""
        return {"parts": self.n_parts} if self._is_ranged() and not self._edits else started(self._options)

    def _is_ranged(self) -> bool:
        """Whether a number of parts was found within a range, which a file of edits cannot state."""
        count = json.loads(self._options["params"])["parts"]["count"]
        return isinstance(count, dict) and "between" in count

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "file": self._mesh.file}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        # The work directory belongs to the file, which has changed or is not here.
        if self.__dict__.pop("file") != self._mesh.file:
            self._options = {**self._options, "work_dir": None}

    def place(self, part: int) -> list[float]:
        """A place well inside a part, for edits: the point (x, y, z) in the middle of a face. Raises IndexError, and ValueError for
        a part without a face with finite coordinates."""
        part = part_number(part, self.n_parts)
        triangles, face = self._mesh.triangles()
        vertices = self.vertices
        own = self.labels[face] == part
        reached = np.zeros(len(vertices), bool)
        reached[triangles[~own]] = True
        triangles = triangles[own & np.isfinite(vertices).all(axis=1)[triangles].all(axis=1)]
        if not len(triangles):
            raise ValueError(f"part {part} has no face with finite coordinates")
        centres = np.asarray(vertices, np.float64)[triangles[farthest(triangles, reached)]].mean(axis=1)
        x, y, z = centres[np.argmin(np.linalg.norm(centres - centres.mean(axis=0), axis=1))].tolist()
        return [x, y, z]

    def save_edits(self, path: Path) -> None:
        """Writes the edits as a file for `nystrom-stream segment --edits` and `edit`. Names are in it if "name" edits gave them."""
        box = _native.edits_box(self._mesh)
        head: dict[str, Any] = {} if box is None else {"box": box}
        publish(as_path("path", path), text_of({**head, **self._start(), **as_edits(self._edits or [])}) + "\n")

    @property
    def tree(self) -> Optional[dict[str, Any]]:
        """The hierarchy of parts over some two thousand `cells`, as a dict: `unions` of cells, finest first, and the `level` of each; None
        unless cluster="parts"."""
        tree: Optional[dict[str, Any]] = None if self._decision is None else json.loads(self._decision.tree())
        return tree

    @property
    def cells(self) -> Optional[NDArray[np.uint32]]:
        """The cell of each face, over which `tree` is: (faces,) uint32; None unless cluster="parts"."""
        return None if self._cells is None else self._cells.copy()

    def recut(self, parts: int) -> NDArray[np.uint32]:
        """Labels of the same mesh in exactly `parts` parts, from the hierarchy: (faces,). Takes milliseconds; boundaries follow
        cells, so for boundaries as fine as those of `labels`, cut again with the same `work_dir`.

        Raises ValueError unless cluster="parts", and for more parts than cells.
        """
        if self._decision is None or self._cells is None:
            raise ValueError("there is no hierarchy of parts; cut with cluster='parts'")
        return self._decision.labels(self._cells, whole("parts", parts, 1))

    def cut(self, parts: int) -> Segmentation:
        """The same mesh in exactly `parts` parts, as `recut` finds them, with colours; confidences are unknown. Edits, hints and
        names are dropped."""
        labels = self.recut(parts)
        colours = _native.part_colours(self._mesh, labels)
        # That the page starts edits from this cut, too.
        asked = {**self.report["options"]["parts"], "count": {"exactly": whole("parts", parts, 1)}, "detail": 0.0}
        report = {"input": self.report["input"], "options": {**self.report["options"], "parts": asked}}
        counts = np.bincount(labels, minlength=len(colours))
        report["parts"] = [{"label": k, "faces": int(n), "colour": colours[k].tolist()} for k, n in enumerate(counts)]
        decision = self._decision and self._decision.without_start()
        arrays = (labels, None, colours, None, self._cells, decision, list[str]())
        options = {**started_from(self._options, {"parts": parts}), "hints": None}
        return Segmentation(self._mesh, arrays, report, options)

    def measure(self) -> list[dict[str, Any]]:
        """Measures each part, in the units of the mesh: a list with one dict per part.

        label, and name if there is one. faces: their number. area. volume: None unless the part is closed. box: the lowest and the
        highest corner. centroid: (x, y, z), by area. axes: three principal axes (x, y, z), the longest first, and spread: the standard
        deviation of the area along each. open_edges: edges of the part at holes of the mesh. neighbours: for each part that it touches
        its label and the length of the common border.

        `pandas.DataFrame(cut.measure())` is a table of the parts; `save("parts.csv")` writes one with a column per coordinate.
        """
        labels = as_labels(self.labels, self._mesh.faces)
        measures: list[dict[str, Any]] = json.loads(_native.measure_parts(self._mesh, labels, self.n_parts))
        names = [{"name": name} if name else {} for name in [*self._names, *[""] * len(measures)]]
        return [{"label": part, **name, **measured} for part, (name, measured) in enumerate(zip(names, measures))]

    def __len__(self) -> int:
        return self.n_parts

    def __getitem__(self, part: int) -> NDArray[np.intp]:
        """The faces of a part: (faces of the part,), ascending. Raises IndexError."""
        return np.flatnonzero(self.labels == part_number(part, self.n_parts))

    def __repr__(self) -> str:
        return f"Segmentation({len(self.labels)} faces, {self.n_parts} parts)"

    def _repr_html_(self) -> str:
        """The page that turns, as Jupyter shows it; some 4 MB at most."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "page.html")
            self.save(path)
            with open(path, encoding="utf-8") as page:
                text = page.read()
        return (f'<iframe srcdoc="{html.escape(text, quote=True)}" width="100%" height="600" '
                f'style="border:0" title="{html.escape(repr(self))}"></iframe>')


def cut_mesh(mesh: _native.Mesh, options: dict[str, Any], edits: Optional[dict[str, Any]], progress: Progress) -> Segmentation:
    """Cuts a mesh with complete `options`, and corrects it."""
    text = None if edits is None else text_of(edits)
    *arrays, report = _native.segment(
        mesh, options["params"], text, options["hints"], options["work_dir"], options["force"], options["seed"], options["threads"],
        options["max_memory"], options["tmp"], progress)
    # A work directory that was emptied for this mesh belongs to it from now on.
    options = {**options, "force": False}
    told: dict[str, Any] = {} if text is None else json.loads(text)
    if text is not None and told.get("box") is not None:
        # Of a mesh in other units, perhaps; places of further edits will be in those of this one.
        told.update(json.loads(_native.edits_on(mesh, text)))
    return Segmentation(mesh, arrays, json.loads(report), options, told or None)


def farthest(triangles: NDArray[np.uint32], reached: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Those of the triangles that are farthest from the vertices `reached`, in steps from triangle to triangle over vertices; what
    they do not lead to is farther still. Each triangle is taken once, when the first of its vertices is reached."""
    by_vertex = np.argsort(triangles.ravel(), kind="stable") // 3
    starts = np.concatenate([[0], np.cumsum(np.bincount(triangles.ravel(), minlength=len(reached)))])
    fresh = np.ones(len(triangles), bool)
    front, last = np.flatnonzero(reached), np.arange(len(triangles))
    while True:
        counts = starts[front + 1] - starts[front]
        around = by_vertex[np.repeat(starts[front + 1] - np.cumsum(counts), counts) + np.arange(counts.sum())]
        ring = np.unique(around[fresh[around]])
        if not len(ring):
            left = np.flatnonzero(fresh)
            return left if len(left) else last
        fresh[ring] = False
        corners = np.unique(triangles[ring])
        front, last = corners[~reached[corners]], ring
        reached[front] = True


class Correspondence:
    """Matches of the vertices of a mesh A in a mesh B.

    matches: (vertices of A,) int64, the vertex of B, -1 without a match.
    distances: (vertices of A,) float32, in the embedding, infinite without a match.
    confidence: (vertices of A,) float32, the confidence of each match, 0 to 1.
    report: the alignments that fit, whether the choice between them is `ambiguous`, and facts about both meshes.
    """

    def __init__(self, matches: NDArray[np.int64], distances: NDArray[np.float32], confidence: NDArray[np.float32],
                 report: dict[str, Any]) -> None:
        self.matches, self.distances, self.confidence, self.report = matches, distances, confidence, report

    def save(self, path: Path) -> None:
        """Writes the matches as .npy, .csv or .parquet. Raises ValueError for another extension, OSError."""
        if not len(self.matches) == len(self.distances) == len(self.confidence):
            raise ValueError("matches, distances and confidence differ in length")
        matches = listed("matches", unmasked("matches", self.matches, -1))
        if matches.ndim != 1 or not np.issubdtype(matches.dtype, np.integer):
            raise TypeError(f"matches: {matches.ndim} dimensions of {matches.dtype}; give a vertex of B for each of A, or -1")
        if len(matches) and (matches.min() < -1 or matches.max() >= MOST):
            wrong = matches.min() if matches.min() < -1 else matches.max()
            raise ValueError(f"matches: {wrong} is no vertex of B; give -1 for none")
        _native.save_matches(packed(matches, np.int64), packed(self.distances, np.float32), packed(self.confidence, np.float32),
                             as_path("path", path))

    def __repr__(self) -> str:
        return f"Correspondence({len(self.matches)} vertices)"


class Transfer(_Labelled):
    """Labels copied to another mesh.

    labels: (faces,) uint32. quality: (faces,) float32, 1 for a certain label. report: counts, such as of `uncertain` faces.
    colours: (parts, 3) uint8. names: a name per part, "" for none. Both are those of the Segmentation that was copied, if it was one.
    """

    def __init__(self, mesh: _native.Mesh, labels: NDArray[np.uint32], quality: NDArray[np.float32], report: dict[str, Any],
                 source: Optional[_Labelled]) -> None:
        self._mesh, self.labels, self.quality, self.report = mesh, labels, quality, report
        self._names = [] if source is None else list(source._names)
        self._colours = None if source is None else source.colours.copy()

    @property
    def names(self) -> list[str]:
        return list(self._names)

    def __repr__(self) -> str:
        return f"Transfer({len(self.labels)} faces, {self.report['uncertain']} uncertain)"


class Sequence(_OfMesh):
    """An order of the faces of a mesh, and of its vertices by first use.

    places: (faces,) uint32, the position of each face in it. vertex_numbers: (vertices,) uint32, the new number of each vertex.
    measures: how well the order streams; a dict.
    """

    def __init__(self, mesh: _native.Mesh, places: NDArray[np.uint32], vertex_numbers: NDArray[np.uint32],
                 measures: dict[str, Any]) -> None:
        self._mesh, self.places, self.vertex_numbers, self.measures = mesh, places, vertex_numbers, measures

    @property
    def order(self) -> NDArray[np.intp]:
        """The faces in their new order: (faces,) int64. The mesh to stream has the faces `vertex_numbers[faces[order]]`, and the
        vertices `vertices[np.argsort(vertex_numbers)]`."""
        return np.argsort(self.places, kind="stable")

    def __repr__(self) -> str:
        return f"Sequence({len(self.places)} faces)"
