"""Converts meshes of all kinds to the library's."""

from __future__ import annotations

import copyreg
import operator
import os
from typing import Any, Callable, Optional, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

# A path, a result of this package, (vertices, faces), or a mesh of trimesh, PyVista, Open3D or meshio: their classes have nothing in
# common, and none of these packages need be installed.
MeshLike = Any
Path = Union[str, "os.PathLike[str]"]
# Called with the stage, the amount done, and the total.
Progress = Optional[Callable[[str, int, int], object]]

# How a call runs, checked: threads, bytes of memory, the folder for temporary files, and progress.
Run = tuple[Optional[int], Optional[int], Optional[Path], Progress]
DEFAULT: Run = (None, None, None, None)

# One label per face, or a file of labels.
Labels = Union[ArrayLike, Path]

# The greatest number of a vertex or a part; of a label it says that a face has none.
MOST = 2**32 - 1
# Up to here labels are numbers of parts, whatever the mesh: there is a colour for each up to the greatest.
MANY = 2**20


def whole(name: str, value: Any, least: int = 0, most: int = 2**63 - 1) -> int:
    """The number that option `name` has, which must be whole and within `least` and `most`."""
    try:
        number = int(value) if isinstance(value, (float, np.floating)) and value == int(value) else operator.index(value)
    except (TypeError, ValueError, OverflowError):
        raise (ValueError if isinstance(value, (float, np.floating)) else TypeError)(f"{name}: {value!r} is not a whole number") from None
    if number < least:
        raise ValueError(f"{name}: {number} is too small; choose {least} or more")
    if number > most:
        raise ValueError(f"{name}: {number} is too large; choose {most} or less")
    return number


def part_number(part: Any, parts: int) -> int:
    """The number of a part of `parts`, which counts from the end if it is negative, as an index does."""
    number = operator.index(part)
    if not -parts <= number < parts:
        raise IndexError(f"there is no part {number}; the {parts} parts are counted from 0")
    return number % parts


def real(name: str, value: Any) -> float:
    """The number that option `name` has, which must be finite."""
    try:
        number = float(value)
    except OverflowError:
        raise ValueError(f"{name}: the number is out of range") from None
    except (TypeError, ValueError):
        raise TypeError(f"{name}: {value!r} is not a number") from None
    if not np.isfinite(number):
        raise ValueError(f"{name}: {value} is not a finite number")
    return number


def flag(name: str, value: Any) -> bool:
    """Whether option `name` is set, which must be True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name}: {value!r} is neither True nor False")
    return bool(value)


def pair(name: str, value: Any) -> tuple[int, int]:
    """The two numbers, from 1 on, that option `name` has."""
    try:
        first, second = value
    except (TypeError, ValueError):
        raise TypeError(f"{name}: {value!r} is not a pair of numbers") from None
    return whole(name, first, 1), whole(name, second, 1)


def as_path(name: str, value: Any) -> str:
    """The path that option `name` has: a text, bytes, or anything with a path."""
    try:
        path = os.fsdecode(value)
    except TypeError:
        raise TypeError(f"{name}: {value!r} is not a path") from None
    if not path:
        raise ValueError(f"{name}: an empty text is no path; leave it out, or give one")
    return path


def unmasked(name: str, values: Any, instead: Optional[int] = None) -> Any:
    """`values` without a mask: whole numbers with `instead` where they are masked; refused where there is nothing to put there."""
    if not isinstance(values, np.ma.MaskedArray):
        return values
    if not np.ma.getmaskarray(values).any():
        return values.data
    if instead is None:
        raise ValueError(f"{name}: some values are masked; leave them out")
    return np.ma.filled(values.astype(np.int64), instead)


def packed(values: NDArray[Any], kind: Any = None) -> NDArray[Any]:
    """`values` row by row and aligned, as the compiled module takes arrays: it counts strides in whole items, which fields of packed
    records do not have."""
    return np.require(values, kind, ["C", "A"])


def listed(name: str, values: Any) -> NDArray[Any]:
    """`values` as an array of any shape and type; refused if some are masked."""
    try:
        # `numpy.asarray` would drop the masks of rows.
        has_masks = isinstance(values, (list, tuple)) and any(isinstance(row, np.ma.MaskedArray) for row in values)
        table = np.ma.stack(values) if has_masks else values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
        if table.dtype == object and hasattr(values, "to_numpy"):
            # Tables of pandas whose types have missing values are objects, also where nothing is missing.
            table = np.asarray(table.tolist())
    except ValueError as error:
        raise ValueError(f"{name}: rows differ in length") from error
    plain: NDArray[Any] = unmasked(name, table)
    return plain


def array(name: str, values: Any, columns: Optional[int] = None) -> NDArray[Any]:
    """`values` as a two-dimensional array of numbers: of anything that NumPy takes, a pandas table or a tensor too."""
    if hasattr(values, "detach"):
        values = values.detach().cpu()
    table = listed(name, values)
    if table.dtype == object:
        raise TypeError(f"{name}: not an array of numbers")
    if table.ndim != 2 or (columns is not None and table.shape[1] != columns):
        shape = "×".join(map(str, table.shape)) or "a number"
        raise ValueError(f"{name}: an array of shape {shape}; give one row each, with {columns or 'at least 3'} columns")
    return table


def _positions(vertices: ArrayLike) -> NDArray[Any]:
    positions = array("vertices", vertices, 3)
    if positions.dtype not in (np.float32, np.float64):
        if not np.issubdtype(positions.dtype, np.number) or np.iscomplexobj(positions):
            raise TypeError(f"vertices: {positions.dtype} is not a real number type")
        positions = positions.astype(np.float64)
    return positions


def _corners(faces: Any) -> NDArray[np.int64]:
    """Numbers of vertices, of integers of any type: NumPy joins unsigned and signed ones to floating-point numbers."""
    corners = np.asarray(faces)
    if corners.size == 0:
        return corners.astype(np.int64)
    if not np.issubdtype(corners.dtype, np.integer):
        raise TypeError(f"faces: {corners.dtype} is not an integer type")
    if (corners < 0).any() or (corners > MOST).any():
        raise ValueError("faces: not vertex numbers, counted from 0")
    return corners.astype(np.int64)


def from_arrays(vertices: ArrayLike, faces: Any) -> _native.Mesh:
    """A mesh of (v, 3) positions and (n, corners) faces, or of faces of different lengths as a list of lists. Masked corners at the end
    of a face are none."""
    vertices = _positions(vertices)
    if isinstance(faces, np.ma.MaskedArray) and faces.ndim == 2 and np.ma.getmaskarray(faces).any():
        faces = list(faces)
    if isinstance(faces, (list, tuple)):
        faces = [face.compressed() if isinstance(face, np.ma.MaskedArray) else face for face in faces]
    if not isinstance(faces, (list, tuple)) and np.ndim(faces) == 0:
        raise TypeError(f"faces: a {type(faces).__name__}; give an array, or a list of the corners of each face")
    if isinstance(faces, (list, tuple)):
        if not all(hasattr(face, "__len__") and not isinstance(face, (str, bytes)) for face in faces):
            raise TypeError("faces: give the corners of each face")
        counts = [len(face) for face in faces]
        if len(set(counts)) > 1:
            return _of_polygons(vertices, counts, np.concatenate([_corners(face) for face in faces]))
    if len(faces) == 0:
        faces = np.empty((0, 3), np.uint32)
    faces = array("faces", faces)
    if not np.issubdtype(faces.dtype, np.integer):
        raise TypeError(f"faces: {faces.dtype} is not an integer type")
    if faces.dtype not in (np.int32, np.int64, np.uint32, np.uint64):
        faces = faces.astype(np.int64)
    return _native.Mesh.from_arrays(packed(vertices), packed(faces))


def _of_polygons(vertices: NDArray[Any], counts: Any, corners: NDArray[Any]) -> _native.Mesh:
    """A mesh of faces with `counts` corners each, one face after the other in `corners`."""
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint64)
    return _native.Mesh.from_polygons(packed(vertices, np.float64), starts, packed(corners, np.uint32))


def _of_vtk(faces: Any) -> Any:
    """Faces of a VTK array: a count, then so many corners, again and again."""
    faces = np.asarray(faces)
    if len(faces) and len(faces) % (faces[0] + 1) == 0:
        table = faces.reshape(-1, faces[0] + 1)
        if (table[:, 0] == faces[0]).all():
            return table[:, 1:]
    rows, at = [], 0
    while at < len(faces):
        rows.append(faces[at + 1 : at + 1 + faces[at]])
        at += 1 + faces[at]
    return rows


def _of_blocks(mesh: Any) -> _native.Mesh:
    """The triangles, quads and polygons of a mesh of meshio, block after block; of curved ones the corners. Points, lines and volumes
    are no faces."""
    blocks: list[NDArray[Any]] = []
    for block in mesh.cells:
        kind = block.type.rstrip("0123456789")
        if kind in ("triangle", "quad", "polygon"):
            data = [np.asarray(face)[None] for face in block.data] if kind == "polygon" else [np.asarray(block.data)]
            blocks.extend(faces[:, : {"triangle": 3, "quad": 4}.get(kind)] for faces in data)
    blocks = [block for block in blocks if len(block)]
    if not blocks:
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "nothing"
        raise ValueError(f"mesh: no triangles, quads or polygons among its cells ({kinds}); give its surface")
    if len({block.shape[1] for block in blocks}) == 1:
        return from_arrays(mesh.points, np.concatenate([_corners(block) for block in blocks]))
    counts = np.concatenate([np.full(len(block), block.shape[1], np.uint64) for block in blocks])
    return _of_polygons(_positions(mesh.points), counts, np.concatenate([_corners(block).ravel() for block in blocks]))


def as_mesh(mesh: MeshLike, faces: Any = None, run: Run = DEFAULT) -> _native.Mesh:
    """The mesh that `mesh` is: a path, which is read as `run` says, a result of this package, (vertices, faces), or a mesh of trimesh,
    PyVista, Open3D, meshio. With `faces`, `mesh` is the positions."""
    if isinstance(faces, (int, float, np.number)):
        raise TypeError(f"faces: {faces} is a number; give the corners of each face, or leave them out")
    if faces is not None:
        return from_arrays(mesh, faces)
    if isinstance(mesh, _native.Mesh):
        return mesh
    if hasattr(mesh, "_as_mesh"):
        own: _native.Mesh = mesh._as_mesh()
        return own
    if isinstance(mesh, (str, bytes, os.PathLike)):
        # Absolute, since the file is looked at again later, wherever the process is by then; dots stay, as links may precede them.
        path = os.fsdecode(mesh)
        return _native.Mesh.open(path if os.path.isabs(path) else os.path.join(os.getcwd(), path), *run)
    if isinstance(mesh, (tuple, list)) and len(mesh) == 2:
        return from_arrays(*mesh)
    if hasattr(mesh, "geometry") and hasattr(mesh, "dump"):
        raise TypeError("a trimesh.Scene holds several meshes; give scene.to_geometry() or one of scene.geometry")
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        return from_arrays(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    if hasattr(mesh, "points") and hasattr(mesh, "faces"):
        if hasattr(mesh, "n_strips") and mesh.n_strips:
            mesh = mesh.triangulate()
        return from_arrays(np.asarray(mesh.points), _of_vtk(mesh.faces))
    if hasattr(mesh, "vertices") and hasattr(mesh, "triangles"):
        return from_arrays(np.asarray(mesh.vertices), np.asarray(mesh.triangles))
    if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):
        if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
            raise ValueError("mesh: without vertices or triangles")
        return from_arrays(mesh.vertex.positions.cpu().numpy(), mesh.triangle.indices.cpu().numpy())
    if hasattr(mesh, "points") and hasattr(mesh, "celltypes"):
        # VTK's numbers of a triangle, a polygon and a quad.
        if len(mesh.celltypes) and np.isin(mesh.celltypes, (5, 7, 9)).all():
            return from_arrays(np.asarray(mesh.points), _of_vtk(mesh.cells))
        raise TypeError("the grid has cells other than triangles, quads and polygons; give its surface, mesh.extract_surface()")
    if hasattr(mesh, "points") and hasattr(mesh, "extract_surface"):
        raise TypeError(f"a {type(mesh).__name__} is not a surface; give mesh.extract_surface()")
    if hasattr(mesh, "points") and hasattr(mesh, "cells"):
        return _of_blocks(mesh)
    if isinstance(mesh, list) or getattr(mesh, "ndim", 0) == 2:
        raise TypeError("faces: missing; vertices alone are no mesh")
    raise TypeError(
        f"a {type(mesh).__name__} is not a mesh; give a path, vertices and faces, or a mesh of trimesh, PyVista, Open3D or meshio"
    )


def as_labels(labels: Any, faces: int, name: str = "labels", partial: bool = False) -> NDArray[np.uint32]:
    """One label per face as uint32, of an array or of a file; where they may be `partial`, a negative one says that a face has none, and
    becomes `MOST`."""
    if isinstance(labels, (str, bytes, os.PathLike)):
        path = as_path(name, labels)
        labels = _native.read_labels(path)
        if not partial and (labels == MOST).any():
            raise ValueError(f"{name}: {path} has faces without a label")
    labels = listed(name, unmasked(name, getattr(labels, "labels", labels), -1 if partial else None))
    if labels.ndim == 0:
        raise TypeError(f"{name}: {labels.item()!r}; give one per face")
    if labels.ndim != 1 or len(labels) != faces:
        raise ValueError(f"{name}: {'×'.join(map(str, labels.shape))} for {faces} faces; give one per face")
    if not np.issubdtype(labels.dtype, np.integer):
        remedy = f"; give {name}.astype(int)" if np.issubdtype(labels.dtype, np.floating) else ""
        raise TypeError(f"{name}: {labels.dtype} is not an integer type{remedy}")
    if len(labels) and labels.min() < 0:
        if partial:
            return np.where(labels < 0, np.uint32(MOST), as_labels(np.maximum(labels, 0), faces, name))
        raise ValueError(f"{name}: {labels.min()} is negative; number parts from 0")
    if len(labels) and labels.max() > MOST:
        raise ValueError(f"{name}: {labels.max()} exceeds 32 bits; number parts from 0")
    return packed(labels, np.uint32)


def as_quality(quality: Any, faces: int) -> NDArray[np.float32]:
    """One confidence per face as float32."""
    quality = listed("quality", quality)
    if quality.ndim != 1 or len(quality) != faces:
        raise ValueError(f"quality: {'×'.join(map(str, quality.shape))} for {faces} faces; give one per face")
    return packed(quality, np.float32)


def number_parts(labels: NDArray[Any]) -> bool:
    """Whether labels are numbers of parts: greater ones than there are faces name parts in another way."""
    return int(labels.max(initial=0, where=labels != MOST)) < max(MANY, len(labels))


def as_colours(colours: Any, parts: int) -> NDArray[np.uint8]:
    """One colour per part, (parts or more, 3) uint8: of whole numbers from 0 to 255, or of real ones from 0 to 1."""
    colours = listed("colours", colours)
    if colours.ndim != 2 or colours.shape[1] != 3:
        raise ValueError(f"colours: an array of shape {'×'.join(map(str, colours.shape))}; give red, green and blue per part")
    is_real = np.issubdtype(colours.dtype, np.floating)
    if not is_real and not np.issubdtype(colours.dtype, np.integer):
        raise TypeError(f"colours: {colours.dtype} is not a real number type")
    if not ((colours >= 0) & (colours <= (1 if is_real else 255))).all():
        raise ValueError("colours: out of range; give integers from 0 to 255, or floats from 0 to 1")
    if len(colours) < parts:
        raise ValueError(f"colours: {len(colours)} for {parts} parts; give one per part")
    return packed(np.rint(colours * 255) if is_real else colours, np.uint8)


def as_bytes(size: Union[int, str, None]) -> Optional[int]:
    """Bytes of a number, or of words such as "2GiB", which the program takes too."""
    if size is None:
        return None
    if not isinstance(size, str):
        return whole("max_memory", size, 1)
    units = {"": 1, "B": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40,
             "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
    digits = size.strip().rstrip("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ ")
    unit = size.strip()[len(digits):].strip().upper()
    try:
        number = int(float(digits) * units[unit])
    except (KeyError, ValueError, OverflowError):
        raise ValueError(f"max_memory: {size!r} is not a size; write 512MiB or 2GiB") from None
    return whole("max_memory", number, 1)


def run_options(threads: Optional[int], max_memory: Union[int, str, None], tmp: Optional[Path], progress: Progress) -> Run:
    """These options, checked."""
    if progress is not None and not callable(progress):
        raise TypeError(f"progress: {progress!r} cannot be called")
    return (None if threads is None else whole("threads", threads, 1, 65535), as_bytes(max_memory),
            None if tmp is None else os.path.abspath(as_path("tmp", tmp)), progress)


def _pickled(mesh: _native.Mesh) -> tuple[Any, ...]:
    starts, corners = mesh.polygons()
    counts = np.diff(starts)
    alike = len(counts) > 0 and (counts == counts[0]).all()
    return _unpickled, (mesh.vertices(), None if alike else starts, corners.reshape(len(counts), -1) if alike else corners, mesh.file)


def _unpickled(vertices: NDArray[Any], starts: Optional[NDArray[np.uint64]], corners: NDArray[np.uint32],
               file: Optional[tuple[Any, ...]]) -> _native.Mesh:
    """The file's mesh where that is as it was, since a work directory knows a mesh by its file; else the same of arrays: of faces with
    as many corners each, or of those between `starts`."""
    # A pipe in its place would be waited for.
    if file is not None and os.path.isfile(file[0]):
        try:
            mesh = _native.Mesh.open(file[0], *DEFAULT)
            if mesh.file == file:
                return mesh
        except (OSError, ValueError):
            pass
    if starts is None:
        return _native.Mesh.from_arrays(vertices, corners)
    return _native.Mesh.from_polygons(vertices.astype(np.float64), starts, corners)


copyreg.pickle(_native.Mesh, _pickled)
