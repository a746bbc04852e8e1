"""Types of the compiled module. Lengths and areas are in the unit of the mesh and its square; indices count from 0."""

import os
from typing import Any, Callable, Dict, Optional, Tuple, Union

import numpy as np
import numpy.typing as npt

__version__: str

_Path = Union[str, "os.PathLike[str]"]

class Segmentation:
    """A mesh cut into parts. `len(cut)` is the number of parts, `cut[k]` the faces of part k."""

    @property
    def labels(self) -> npt.NDArray[np.uint32]:
        """One part per face: (faces,), from 0, in the order of the mesh."""
    @property
    def quality(self) -> npt.NDArray[np.float32]:
        """How sure each label is, 0 to 1: (faces,)."""
    @property
    def colours(self) -> npt.NDArray[np.uint8]:
        """One sRGB colour per part, neighbours unlike, safe for the colour-blind: (parts, 3), 0 to 255."""
    @property
    def tree(self) -> Optional[Dict[str, Any]]:
        """The hierarchy of parts over some two thousand cells; None for K-means and two-means."""
    @property
    def report(self) -> Dict[str, Any]:
        """The run's report: parts with their areas, landmarks, eigenvalues, Γ, seconds by stage, bytes."""
    def recut(self, parts: int) -> npt.NDArray[np.uint32]:
        """Labels of the same mesh in exactly `parts` parts, from the hierarchy: (faces,). Takes milliseconds; boundaries
        follow cells, so for boundaries as fine as those of `labels` cut again with the same `work_dir`.

        Raises ValueError for K-means and two-means, and for more parts than cells.
        """
    def save(self, path: _Path) -> None:
        """Writes the labelled mesh in the form that the ending names: .ply, .seg, .npy, .glb, or one PLY per part in a
        folder where `path` ends with a slash. Raises ValueError for another ending, OSError."""
    def __len__(self) -> int: ...
    def __getitem__(self, part: int) -> npt.NDArray[np.int64]:
        """The faces of a part: (faces of the part,), ascending. Raises IndexError."""

def segment(
    vertices: npt.NDArray[Any],
    faces: npt.NDArray[Any],
    parts: Optional[int] = None,
    *,
    parts_range: Optional[Tuple[int, int]] = None,
    detail: float = 0.0,
    cluster: str = "parts",
    landmarks: Optional[int] = None,
    coarse: bool = False,
    seed: int = 0,
    threads: Optional[int] = None,
    max_memory: Optional[int] = None,
    work_dir: Optional[_Path] = None,
    tmp: Optional[_Path] = None,
    progress: Optional[Callable[[str, int, int], object]] = None,
) -> Segmentation:
    """Cuts the mesh of `vertices` (v, 3), float32 or float64, and `faces` (n, corners), integers from 0, into parts.
    Arrays are copied once; nothing is written to disk where memory allows.

    parts: exactly so many; without, the number is found, within `parts_range` if given.
    detail: -1 (coarse) to 1 (fine); moves how many are found.
    cluster: "parts" (as people would cut), or the paper's "kmeans" (needs `parts`) or "two-means".
    landmarks: number of sampled faces l; by default 20 to 60, the fewer the larger the mesh.
    coarse: a preview by a contracted mesh.
    seed: of everything random; results depend on it and on nothing else of the run.
    threads: worker threads; by default one per core.
    max_memory: bytes that may be allocated, half of what is free by default; what is mapped does not count.
    work_dir: a folder that keeps intermediate results and reuses them.
    tmp: the folder for what does not fit in memory; by default the system's.
    progress: called as progress(stage, done, total), at most ten times a second and at the ends of stages;
        what it raises stops the work.

    Raises ValueError for arrays or options that make no sense, OSError where the disk fails, KeyboardInterrupt.
    """

def segment_file(
    path: _Path,
    parts: Optional[int] = None,
    *,
    parts_range: Optional[Tuple[int, int]] = None,
    detail: float = 0.0,
    cluster: str = "parts",
    landmarks: Optional[int] = None,
    coarse: bool = False,
    seed: int = 0,
    threads: Optional[int] = None,
    max_memory: Optional[int] = None,
    work_dir: Optional[_Path] = None,
    tmp: Optional[_Path] = None,
    progress: Optional[Callable[[str, int, int], object]] = None,
) -> Segmentation:
    """Cuts the mesh in the file `path` (PLY, OBJ, OFF, STL, .gz or not) into parts. Arguments as of `segment`; the mesh
    need not fit into memory, its labels do."""

class Correspondence:
    """Matches of the vertices of a mesh A in a mesh B."""

    @property
    def matches(self) -> npt.NDArray[np.int64]:
        """The vertex of B for each vertex of A, -1 without one: (vertices of A,)."""
    @property
    def distances(self) -> npt.NDArray[np.float32]:
        """Distances in the embedding, infinite without a match: (vertices of A,)."""
    @property
    def confidence(self) -> npt.NDArray[np.float32]:
        """How sure each match is, 0 to 1: (vertices of A,)."""
    @property
    def report(self) -> Dict[str, Any]:
        """The alignments that fit, whether the shape leaves a choice (`ambiguous`), and facts of both meshes."""
    def save(self, path: _Path) -> None:
        """Writes the matches as .npy or .csv. Raises ValueError for another ending, OSError."""

def correspond(
    vertices_a: npt.NDArray[Any],
    faces_a: npt.NDArray[Any],
    vertices_b: npt.NDArray[Any],
    faces_b: npt.NDArray[Any],
    *,
    matching: str = "all",
    transfer: bool = False,
    alternative: int = 0,
    vectors: Optional[int] = None,
    landmarks: Optional[int] = None,
    seed: int = 0,
    threads: Optional[int] = None,
    max_memory: Optional[int] = None,
    tmp: Optional[_Path] = None,
    progress: Optional[Callable[[str, int, int], object]] = None,
) -> Correspondence:
    """Finds for every vertex of mesh A its match in mesh B, by their spectral embeddings. Arrays as of `segment`.

    matching: "all", "mutual" (each other's nearest only), or "one-to-one" (no vertex of B twice).
    transfer: carry the landmarks of A to B by the first matches, and match again.
    alternative: another of the alignments that the report lists, where the shape is symmetric.
    vectors: leading eigenvectors, 2 to 8.
    landmarks: number of sampled vertices on each mesh; by default 50, for more than 300,000 vertices 20.

    Raises ValueError, MemoryError, OSError, KeyboardInterrupt.
    """

def read_mesh(path: _Path) -> Tuple[npt.NDArray[np.float64], npt.NDArray[np.uint32]]:
    """Reads a mesh file: vertices (v, 3) and triangles (n, 3); polygons are cut into fans."""
