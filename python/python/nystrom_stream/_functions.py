"""The functions of the package. Options have the same names as those of the program, with underscores."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from typing import Any, Literal, Optional, Union, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._edits import Edits, Names, as_edits, as_hints, as_names, protects, read_names, started_from
from ._meshes import (DEFAULT, MOST, Labels, MeshLike, Path, Progress, as_colours, as_labels, as_mesh, as_path, flag, number_parts, pair,
                      real, run_options, whole)
from ._results import Correspondence, Segmentation, Sequence, Transfer, cut_mesh

Bytes = Union[int, str, None]
# The values that options accept, for type checkers and for validation.
Cluster = Literal["parts", "kmeans", "k-means", "two-means", "components"]
Decision = Literal["soft-trees", "consensus", "single"]
TinyComponents = Literal["join", "own"]
Walls = Literal["follow", "own"]
Boundaries = Literal["front", "embedding"]
Sampling = Literal["farthest", "distance-weighted", "random", "uniform", "geodesic-farthest", "centroids", "cholesky", "greedy",
                   "pooled-greedy"]
Metric = Literal["scale-free", "paper", "geodesic"]
Order = Literal["auto", "keep", "hilbert"]
Kernel = Literal["gaussian", "exponential", "polynomial", "inverse-multiquadric", "matern", "cauchy"]
Normalise = Literal["none", "degree", "anchor"]
Distance = Literal["edges", "march"]
Matching = Literal["all", "mutual", "one-to-one"]
Refine = Literal["nystrom", "laplacian", "none"]
StreamOrder = Literal["spectral", "pca", "bfs", "rcm", "hilbert", "random", "keep"]
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]

_METHODS = {"parts": "parts", "kmeans": "k-means", "k-means": "k-means", "two-means": "two-means", "components": "components"}


def _choose(name: str, value: Any, words: Any) -> str:
    """`value`, which must be one of `words`."""
    choices = [str(word) for word in get_args(words)]
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name}: {value!r}; choose {', '.join(choices[:-1])} or {choices[-1]}")
    return str(value)


def _metric(metric: str, beta: Optional[float], eta: Optional[float], delta: Optional[float]) -> dict[str, Any]:
    known = {"scale-free": {"beta": 5.0, "eta": 0.05}, "paper": {"delta": 0.03, "eta": 0.1}, "geodesic": {}}
    constants = known[_choose("metric", metric, Metric)]
    for name, value in {"beta": beta, "eta": eta, "delta": delta}.items():
        if value is not None and name not in constants:
            raise ValueError(f"{name}: has no effect with metric={metric!r}")
        if value is not None:
            constants[name] = real(name, value)
    return {"form": metric, **constants}


def _kernel(kernel: str) -> dict[str, Any]:
    return {"kernel": _choose("kernel", kernel, Kernel), **({"degree": 3} if kernel == "polynomial" else {})}


def _params(parts: Optional[int], parts_range: Optional[tuple[int, int]], detail: float, cluster: str, decision: Optional[str],
            tiny_components: Optional[str], walls: Optional[str], boundaries: Optional[str], landmarks: Optional[int],
            sampling: Optional[str], exact: bool, metric: dict[str, Any], order: str, kernel: Optional[str], sigma: Optional[float],
            normalise: Optional[str], unit_rows: Optional[bool]) -> str:
    params = json.loads(_native.default_params())
    method = _METHODS[_choose("cluster", cluster, Cluster)]
    for name, word, words in [("decision", decision, Decision), ("tiny_components", tiny_components, TinyComponents),
                              ("walls", walls, Walls), ("boundaries", boundaries, Boundaries), ("sampling", sampling, Sampling),
                              ("kernel", kernel, Kernel), ("normalise", normalise, Normalise)]:
        if word is not None:
            _choose(name, word, words)
    own = {"decision": decision, "tiny_components": tiny_components, "walls": walls, "boundaries": boundaries}
    given = [name for name, value in own.items() if value is not None and (name != "tiny_components" or method != "components")]
    if method != "parts" and given:
        raise ValueError(f"{given[0]}: requires cluster='parts'")
    means = {"kernel": kernel, "sigma": sigma, "normalise": normalise, "unit_rows": unit_rows}
    wanted = [name for name, value in means.items() if value is not None]
    if method in ("parts", "components") and wanted:
        raise ValueError(f"{wanted[0]}: requires cluster='kmeans' or 'two-means'")
    weights = None if metric == _metric("scale-free", None, None, None) else metric
    distances = {"landmarks": landmarks, "sampling": sampling, "exact": exact or None, "metric": weights}
    unused = [name for name, value in distances.items() if value is not None]
    if method == "components" and unused:
        raise ValueError(f"{unused[0]}: has no effect with cluster='components'")
    if parts is not None and parts_range is not None:
        raise ValueError("parts and parts_range exclude each other; give one")
    if parts is not None:
        params["parts"]["count"] = {"exactly": parts}
    if parts_range is not None:
        params["parts"]["count"] = {"between": pair("parts_range", parts_range)}
    if landmarks is not None:
        params["landmarks"] = whole("landmarks", landmarks, 1)
    params["parts"]["detail"] = real("detail", detail)
    if sampling is not None:
        params["sampling"] = sampling
    params.update(cluster=method, exact=flag("exact", exact), metric=metric, order=_choose("order", order, Order))
    if decision is not None:
        params["parts"]["decision"] = decision
    params.update({name: value for name, value in own.items() if value is not None and name != "decision"})
    if wanted:
        embedding = params["embedding"] = json.loads(_native.default_embedding(10 if parts is None else parts))
        if kernel is not None:
            embedding["kernel"] = _kernel(kernel)
        if normalise not in (None, "anchor"):
            embedding.update(normalisation=normalise, width={"rule": "mean", "value": 1.0})
        if sigma is not None:
            embedding["width"] = {"rule": "mean", "value": real("sigma", sigma)}
        if unit_rows is not None:
            embedding["unit_rows"] = flag("unit_rows", unit_rows)
    text = json.dumps(params)
    _native.check_params(text)
    return text


def _seed(seed: int) -> int:
    return whole("seed", seed, 0, 2**64 - 1)


def _optional(name: str, value: Optional[int]) -> Optional[int]:
    """A number from 1 on, if given."""
    return None if value is None else whole(name, value, 1)


def segment(mesh: MeshLike, faces: Any = None, parts: Optional[int] = None, *, parts_range: Optional[tuple[int, int]] = None,
            detail: float = 0.0, cluster: Cluster = "parts", decision: Optional[Decision] = None,
            tiny_components: Optional[TinyComponents] = None, walls: Optional[Walls] = None, boundaries: Optional[Boundaries] = None,
            landmarks: Optional[int] = None, sampling: Optional[Sampling] = None, exact: bool = False, metric: Metric = "scale-free",
            beta: Optional[float] = None, eta: Optional[float] = None, delta: Optional[float] = None, order: Order = "auto",
            kernel: Optional[Kernel] = None, sigma: Optional[float] = None, normalise: Optional[Normalise] = None,
            unit_rows: Optional[bool] = None, edits: Optional[Edits] = None, hints: Union[ArrayLike, str, None] = None,
            names: Optional[Names] = None, seed: int = 0, threads: Optional[int] = None, max_memory: Bytes = None,
            work_dir: Optional[Path] = None, force: bool = False, tmp: Optional[Path] = None, progress: Progress = None) -> Segmentation:
    """Cuts a mesh into parts, and returns a Segmentation.

    mesh: a path (PLY, OBJ, OFF, STL, also .gz; the mesh need not fit into memory), a mesh of trimesh, PyVista, Open3D or meshio, or
        vertices (v, 3), as anything array-like. Faces keep their order: for meshio its blocks of triangles, quads and polygons one
        after the other, for a PyVista grid its cells, which must all be flat.
    faces: if `mesh` are vertices: (n, corners) integers from 0, or a list of faces of different lengths.
    parts: exact number of parts; by default it is found automatically, within `parts_range` if given.
    detail: -1 (coarse) to 1 (fine); shifts the automatic number of parts.
    cluster: "parts" (as people would cut), the paper's "kmeans" (needs `parts`) or "two-means", or "components" (connected
        components, by descending area).
    decision: how parts are decided: "soft-trees", "consensus" or "single".
    tiny_components: "join" (each joins the nearest part; with cluster="components" it is a part itself) or "own" (together they
        form one extra part).
    walls: inner walls of hollow bodies: "follow" (they get the labels of the outer surface behind them) or "own" (together they form
        one extra part).
    boundaries: "front" or "embedding".
    landmarks: number of sampled faces l; by default 120, above 300,000 faces 240, with `exact` 20 to 60 on a large mesh; of
        "kmeans" and "two-means" twice the parts, 10 to 60, above 60,000 faces 60.
    sampling: "farthest", "distance-weighted", "random", "uniform", "geodesic-farthest", "centroids", "cholesky", "greedy" or
        "pooled-greedy"; by default farthest, and distance-weighted if parts of a mesh above 60,000 faces are found on its contraction.
    exact: compute rows of distances over the faces of the mesh, neither over the contraction of a large mesh nor over the
        proxy of a small one (refined if triangles are long, denoised if it is rough).
    metric: "scale-free" (with `beta`, `eta`), "paper" (`delta`, `eta`) or "geodesic".
    order: in which faces are processed: "auto", "keep" or "hilbert".
    kernel, sigma, normalise, unit_rows: the embedding of "kmeans" and "two-means".
    edits: corrections of the parts: a list of dicts or a file, see `Segmentation.edit`.
    hints: an integer per face, or the name of such a property of the file: faces with equal values belong together, with different
        values apart; 0 means no hint.
    names: of parts: a list; or a dict by part or the path of a table, which leave the other names that `edits` give.
    seed: of all random choices; with the same options and seed, results do not depend on threads or memory.
    threads: worker threads; by default one per core.
    max_memory: maximum memory to allocate in bytes, or as "2GiB", "512M"; by default half of the free memory.
    work_dir: a folder in which intermediate results are kept and reused; one of another mesh is refused unless `force` is True, which
        empties it.
    tmp: the folder for data that do not fit in memory, and for meshes from files other than binary little-endian PLY of triangles,
        which are decoded there while a result refers to them; by default the system's.
    progress: called as progress(stage, done, total) on the calling thread, about ten times a second and at the ends of stages;
        an exception that it raises stops the work.

    Raises ValueError or TypeError for invalid arrays and options, FileNotFoundError, OSError if the disk fails,
    MemoryError, KeyboardInterrupt.
    """
    if isinstance(faces, (int, np.integer)):
        raise TypeError(f"faces: {faces} is a number; write parts={faces}")
    parts = _optional("parts", parts)
    params = _params(parts, parts_range, detail, cluster, decision, tiny_components, walls, boundaries, landmarks, sampling, exact,
                     _metric(metric, beta, eta, delta), order, kernel, sigma, normalise, unit_rows)
    told = None if edits is None else as_edits(edits)
    if told and _METHODS[cluster] != "parts":
        raise ValueError("edits: require cluster='parts'")
    if names is not None:
        # Edits and hints change the number of parts.
        names = read_names(names, parts if told is None and hints is None else None)
    run = run_options(threads, max_memory, tmp, progress)
    # Later edits mean the same folders, wherever the process is by then.
    folder = None if work_dir is None else os.path.abspath(as_path("work_dir", work_dir))
    options: dict[str, Any] = {"params": params, "work_dir": folder, "force": flag("force", force), "seed": _seed(seed),
                               "threads": run[0], "max_memory": run[1], "tmp": run[2]}
    if told and parts is None and parts_range is None and not detail:
        options = started_from(options, told)
    elif told and not protects(told):
        # Options given here take precedence over those of the file, in later edits too. Parts stay protected as the file's cut has them.
        told = {key: value for key, value in told.items() if key not in ("parts", "detail")}
    mesh = as_mesh(mesh, faces, run)
    options["hints"] = as_hints(hints, mesh)
    cut = cut_mesh(mesh, options, told, progress)
    if names is not None:
        cut.names = names
    return cut


def segment_file(path: Path, parts: Optional[int] = None, **options: Any) -> Segmentation:
    """Cuts the mesh in the file `path` into parts: `segment(path, parts=parts, …)`, with the options of `segment`."""
    return segment(path, parts=parts, **options)


def plan(mesh: MeshLike, faces: Any = None, parts: Optional[int] = None, *, calibrate: bool = True,
         parts_range: Optional[tuple[int, int]] = None, detail: float = 0.0, cluster: Cluster = "parts",
         decision: Optional[Decision] = None, tiny_components: Optional[TinyComponents] = None, walls: Optional[Walls] = None,
         boundaries: Optional[Boundaries] = None, landmarks: Optional[int] = None, sampling: Optional[Sampling] = None,
         exact: bool = False, metric: Metric = "scale-free", beta: Optional[float] = None, eta: Optional[float] = None,
         delta: Optional[float] = None, order: Order = "auto", kernel: Optional[Kernel] = None, sigma: Optional[float] = None,
         normalise: Optional[Normalise] = None, unit_rows: Optional[bool] = None, edits: Optional[Edits] = None,
         hints: Union[ArrayLike, str, None] = None, names: Optional[Names] = None, seed: int = 0, threads: Optional[int] = None,
         max_memory: Bytes = None, work_dir: Optional[Path] = None, force: bool = False, tmp: Optional[Path] = None,
         progress: Progress = None) -> dict[str, Any]:
    """Predicts what `segment` takes with the same arguments, before it starts: a dict, the report of `nystrom-stream plan --json`.

    Of a file only the header is read; of a text format its lines are counted.

    calibrate: measure the pace of this machine, in about the time of the run, at most some six seconds. Without, there are no seconds.
    edits, hints, names, force and progress change nothing.

    memory (peak bytes allocated), disk and disk_peak (bytes in the work directory at the end and at most; disk_peak_smooth for a smooth
    surface), random_access_bytes (what free memory should hold for full speed), seconds and seconds_rough (for a rough surface, such as
    a raw scan); stages, a list of dicts with the same by stage; mesh (its size), landmarks, and notes: a list of warnings, such as a
    disk that is too small.
    """
    if isinstance(faces, (int, np.integer)):
        raise TypeError(f"faces: {faces} is a number; write parts={faces}")
    params = _params(_optional("parts", parts), parts_range, detail, cluster, decision, tiny_components, walls, boundaries, landmarks,
                     sampling, exact, _metric(metric, beta, eta, delta), order, kernel, sigma, normalise, unit_rows)
    run = run_options(threads, max_memory, tmp, progress)
    is_file = faces is None and isinstance(mesh, (str, bytes, os.PathLike))
    known = None if is_file else as_mesh(mesh, faces, run)
    path = as_path("mesh", mesh) if known is None else known.path
    folder = None if work_dir is None else as_path("work_dir", work_dir)
    predicted: dict[str, Any] = json.loads(
        _native.plan(path, known, params, flag("calibrate", calibrate), folder, _seed(seed), *run[:3]))
    return predicted


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Reads a mesh file: vertices (v, 3) float64 and triangles (n, 3) uint32; polygons are split into triangles."""
    mesh = _native.Mesh.open(as_path("path", path), *DEFAULT)
    return np.asarray(mesh.vertices(), np.float64), mesh.triangles()[0]


def correspond(a: MeshLike, *others: Any, matching: Matching = "all", refine: Refine = "nystrom", partial: bool = False,
               transfer: bool = False, alternative: int = 0, vectors: Optional[int] = None, sigma: float = 1.0,
               landmarks: Optional[int] = None, sampling: Sampling = "farthest", distance: Distance = "march", seed: int = 0,
               threads: Optional[int] = None, max_memory: Bytes = None, work_dir: Optional[Path] = None, force: bool = False,
               tmp: Optional[Path] = None, progress: Progress = None) -> Correspondence:
    """Finds for every vertex of mesh A its match in mesh B, by their spectral embeddings: `correspond(a, b)` of two meshes as
    `segment` takes them, or `correspond(vertices_a, faces_a, vertices_b, faces_b)`. Returns a Correspondence.

    matching: "all", "mutual" (each other's nearest only), or "one-to-one" (no vertex of B twice).
    refine: how the first matches are refined: "nystrom" (in smooth functions of a local sample), "laplacian" (in eigenfunctions of the
        Laplace–Beltrami operator) or "none" (the paper's way).
    partial: one mesh is a part of the other, at the same scale; vertices without a counterpart stay unmatched.
    transfer: copy the landmarks of A to B by the first matches, and match again.
    alternative: which of the alignments that the report lists to use, if the shape is symmetric.
    vectors: number of leading eigenvectors, 2 to 8; by default 8. sigma: width of the kernel, in mean distances.
    landmarks: number of sampled vertices on each mesh; by default 50, for more than 300,000 vertices 20. sampling: as of `segment`.
    distance: how distances between vertices are measured: "march" (through triangles) or "edges" (along edges).
    work_dir: a folder in which graphs and rows of both meshes are kept and reused; one of other meshes is refused unless `force` is
        True, which empties it.
    seed, threads, max_memory, tmp, progress: as of `segment`.
    """
    run = run_options(threads, max_memory, tmp, progress)
    choices = (_choose("matching", matching, Matching), _choose("refine", refine, Refine), flag("partial", partial),
               flag("transfer", transfer), whole("alternative", alternative), _optional("vectors", vectors), real("sigma", sigma),
               _optional("landmarks", landmarks), _choose("sampling", sampling, Sampling), _choose("distance", distance, Distance),
               None if work_dir is None else as_path("work_dir", work_dir), flag("force", force), _seed(seed))
    if len(others) == 3:
        a, b = as_mesh(a, others[0], run), as_mesh(others[1], others[2], run)
    elif len(others) == 1:
        a, b = as_mesh(a, run=run), as_mesh(others[0], run=run)
    else:
        raise TypeError("give two meshes, or vertices and faces of both")
    matches, distances, confidence, report = _native.correspond(a, b, *choices, *run)
    return Correspondence(matches, distances, confidence, json.loads(report))


def transfer_labels(source: MeshLike, target: MeshLike, labels: Optional[Labels] = None, *, threads: Optional[int] = None,
                    max_memory: Bytes = None, tmp: Optional[Path] = None, progress: Progress = None) -> Transfer:
    """Copies labels from a mesh to another version of it: another resolution, decimated, remeshed. Returns a Transfer, which can be
    saved.

    source: a Segmentation, or a mesh with `labels`, (faces,) or a file of them as of `evaluate`; a negative label or 2**32 - 1 means
        that a face has none.
    target: the other mesh.
    """
    if labels is None and not hasattr(source, "labels"):
        raise TypeError("labels: missing; give one per face of the first mesh, or a Segmentation")
    run = run_options(threads, max_memory, tmp, progress)
    mesh = as_mesh(source, run=run)
    before = source if labels is None and isinstance(source, (Segmentation, Transfer)) else None
    labels = as_labels(source if labels is None else labels, mesh.faces, partial=True)
    target = as_mesh(target, run=run)
    carried, quality, report = _native.transfer_labels(mesh, labels, target, *run)
    return Transfer(target, carried, quality, json.loads(report), before)


def evaluate(labels: Any, truths: Any, mesh: MeshLike = None) -> dict[str, Any]:
    """Scores labels against human ones by the metrics of the Princeton Segmentation Benchmark: a dict, with 0 for equal labels.

    labels: a Segmentation, or labels of `mesh`: (faces,) integers, or a file of them: .seg, .npy, or a mesh with a property `label`.
    truths: one such labelling, or several, whose scores are averaged.

    rand (1 − Rand index; `rand_area` is weighted by area), cut_discrepancy, hamming with its two rates missing and false_alarm, and the
    consistency errors gce and lce. Raises ValueError for labels of another mesh.
    """
    if mesh is None and not hasattr(labels, "_as_mesh"):
        raise TypeError("mesh: missing; give the mesh of the labels, or a Segmentation")
    mesh = as_mesh(labels if mesh is None else mesh)
    def is_whole(truth: Any) -> bool:
        # A result and a path have a length too, and are one labelling all the same.
        return hasattr(truth, "labels") or isinstance(truth, (str, bytes, os.PathLike))

    # A column of a table is indexed by whatever names its rows.
    if not is_whole(truths) and (np.ndim(truths) == 0 if hasattr(truths, "__array__") else not hasattr(truths, "__iter__")):
        raise TypeError(f"truths: {truths!r}; give labels, a Segmentation, a file of labels, or several")
    if not is_whole(truths):
        truths = list(truths) if not hasattr(truths, "__array__") else \
            truths if isinstance(truths, np.ma.MaskedArray) else np.asarray(truths)
    if not is_whole(truths) and not len(truths):
        raise ValueError("truths: none is given; give at least one labelling")
    if is_whole(truths) or not is_whole(truths[0]) and np.ndim(truths[0]) == 0:
        truths = [truths]
    truths = [as_labels(truth, mesh.faces, "truths") for truth in truths]
    scores: dict[str, Any] = json.loads(_native.evaluate(mesh, as_labels(labels, mesh.faces), truths))
    return scores


def _numbered(labels: NDArray[np.uint32], names: Optional[Names]) -> tuple[NDArray[np.uint32], list[str]]:
    """Labels that name parts by any numbers as numbers of parts from 0, with what to call each."""
    known = np.unique(labels[labels != MOST])
    told = {} if names is None else read_names(names)
    told = told if isinstance(told, dict) else dict(enumerate(told))
    numbers = np.where(labels == MOST, np.uint32(MOST), np.searchsorted(known, labels).astype(np.uint32))
    return numbers, [told.get(label) or str(label) for label in known.tolist()]


def picture(mesh: MeshLike, labels: Optional[Labels] = None, *, colours: Optional[ArrayLike] = None, names: Optional[Names] = None,
            size: tuple[int, int] = (1600, 1200), views: int = 1, transparent: bool = False, legend: bool = True, lines: bool = True,
            up: Optional[Axis] = None, turn: float = 0.0, tilt: float = 0.0, max_memory: Bytes = None) -> NDArray[np.uint8]:
    """Draws a mesh and its parts, without a display: (height, width, 4) uint8, red, green, blue, opacity.

    mesh: a Segmentation, or a mesh, with `labels` or without.
    labels: (faces,) integers, or a file of them as of `evaluate`; a face whose label is negative or 2**32 - 1 is grey.
    colours: (parts, 3), whole numbers from 0 to 255 or real ones from 0 to 1. names: of the parts, for the legend; by
    default those of the Segmentation. up: "x", "-y" and so on; by default automatic.
    turn, tilt: additional rotation and elevation in degrees, relative to the automatic view. max_memory: as of `segment`.

    `PIL.Image.fromarray(image).save("parts.png")` or `matplotlib.pyplot.imsave("parts.png", image)` writes it to a file.
    """
    if labels is None and isinstance(mesh, (Segmentation, Transfer)):
        labels, colours = mesh.labels, mesh._colours if colours is None else colours
        names = mesh.names if names is None else names
    run = run_options(None, max_memory, None, None)
    mesh = as_mesh(mesh, None, run)
    if labels is not None:
        labels = as_labels(labels, mesh.faces, partial=True)
        if colours is None and not number_parts(labels):
            labels, names = _numbered(labels, names)
        if colours is None:
            colours = _native.part_colours(mesh, labels)
    parts = 0 if labels is None else int((labels[labels != MOST] + 1).max(initial=0))
    colours = as_colours(np.zeros((0, 3), np.uint8) if colours is None else colours, parts)
    told = [] if names is None else as_names(names, parts)
    width, height = pair("size", size)
    if up is not None:
        _choose("up", up, Axis)
    return _native.picture(mesh, labels, colours, told, width, height, whole("views", views, 1), flag("transparent", transparent),
                           flag("legend", legend), flag("lines", lines), up, real("turn", turn), real("tilt", tilt), run[1])


def sequence(mesh: MeshLike, faces: Any = None, *, order: StreamOrder = "spectral", smooth: int = 0, landmarks: Optional[int] = None,
             seed: int = 0, threads: Optional[int] = None, max_memory: Bytes = None, tmp: Optional[Path] = None,
             progress: Progress = None) -> Sequence:
    """Orders a mesh for streaming, and returns a Sequence.

    order: "spectral", "pca", "bfs", "rcm", "hilbert", "random" or "keep". smooth: sweeps over the graph, for spectral orders.
    """
    run = run_options(threads, max_memory, tmp, progress)
    choices = _choose("order", order, StreamOrder), whole("smooth", smooth), _optional("landmarks", landmarks), _seed(seed)
    mesh = as_mesh(mesh, faces, run)
    places, numbers, measures = _native.sequence(mesh, *choices, *run)
    return Sequence(mesh, places, numbers, json.loads(measures))


def quality(mesh: MeshLike, faces: Any = None, *, landmarks: Union[int, Iterable[int]] = (10,),
            samplings: Union[Sampling, Iterable[Sampling]] = ("farthest",), seeds: int = 1, kernel: Kernel = "exponential",
            sigma: float = 1.0, metric: Metric = "scale-free", beta: Optional[float] = None, eta: Optional[float] = None,
            delta: Optional[float] = None, seed: int = 0, threads: Optional[int] = None, max_memory: Bytes = None,
            tmp: Optional[Path] = None, progress: Progress = None) -> list[dict[str, Any]]:
    """Measures how well samples of landmarks represent a mesh (Γ, eq. 6 of the paper, and held-out columns): a list of dicts, one
    per number of landmarks, sampling and seed.

    landmarks: one number or several. samplings: one or several, as of `segment`. seeds: how many, counted from `seed`.
    kernel: from distance to affinity; sigma: its width, in mean distances.
    metric, beta, eta, delta: the weights of the graph, as of `segment`.

    Each dict has mesh, sampling, l, seed, nodes; gamma (and gamma_per_node, from 0 to 1: the more, the better), gamma_star; held_out, the
    error of the affinities of faces that are no landmarks, from 0; sigma, in the units of the distances.
    """
    several: Any = landmarks
    try:
        several = list(several)
    except TypeError:
        several = [several]
    counts = [whole("landmarks", count, 1) for count in several]
    if not hasattr(samplings, "__iter__"):
        raise TypeError(f"samplings: {samplings!r}; give one or several")
    chosen = [_choose("samplings", word, Sampling) for word in ([samplings] if isinstance(samplings, str) else samplings)]
    if not chosen:
        raise ValueError("samplings: none is given; give at least one")
    weights = json.dumps(_metric(metric, beta, eta, delta))
    choices = counts, chosen, whole("seeds", seeds, 1), json.dumps(_kernel(kernel)), real("sigma", sigma), weights, _seed(seed)
    run = run_options(threads, max_memory, tmp, progress)
    records: list[dict[str, Any]] = json.loads(_native.quality(as_mesh(mesh, faces, run), *choices, *run))
    return records


def measure(mesh: MeshLike, faces: Any = None) -> dict[str, Any]:
    """Measures a mesh: a dict with box, area, volume if it is closed (else None), centroid, axes, spread, as `Segmentation.measure` has
    them; components, boundary_loops; open, welded and non-manifold edges, degenerate and duplicate faces."""
    measures: dict[str, Any] = json.loads(_native.measure_mesh(as_mesh(mesh, faces)))
    return measures
