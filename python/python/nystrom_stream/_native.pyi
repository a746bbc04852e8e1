"""The compiled module, which the package's own functions call; what it has may change."""

import os
from collections.abc import Callable, Sequence
from typing import Any, Optional, Union, final

import numpy as np
from numpy.typing import NDArray

_Path = Union[str, os.PathLike[str]]
_Progress = Optional[Callable[[str, int, int], object]]
_Labels = NDArray[np.uint32]

__all__ = [
    "Decision",
    "Mesh",
    "__version__",
    "correspond",
    "cut_tree",
    "default_embedding",
    "default_params",
    "evaluate",
    "measure_mesh",
    "measure_parts",
    "part_colours",
    "picture",
    "quality",
    "read_names",
    "save",
    "save_matches",
    "segment",
    "sequence",
    "transfer_labels",
]
__version__: str

@final
class Mesh:
    @staticmethod
    def from_arrays(vertices: NDArray[Any], faces: NDArray[Any]) -> Mesh: ...
    @staticmethod
    def from_polygons(vertices: NDArray[np.float64], starts: NDArray[np.uint64], corners: NDArray[np.uint32]) -> Mesh: ...
    @staticmethod
    def open(path: _Path) -> Mesh: ...
    def face_property(self, name: str) -> _Labels: ...
    @property
    def faces(self) -> int: ...
    @property
    def path(self) -> str: ...
    def vertices(self) -> NDArray[Any]: ...
    def polygons(self) -> tuple[NDArray[np.uint64], NDArray[np.uint32]]: ...
    def triangles(self) -> tuple[NDArray[np.uint32], NDArray[np.int64]]: ...

@final
class Decision:
    def __new__(cls, text: str, start: Sequence[int]) -> Decision: ...
    def __getnewargs__(self) -> tuple[str, list[int]]: ...
    def without_start(self) -> Decision: ...

def default_params() -> str: ...
def default_embedding(dimensions: int) -> str: ...
def segment(
    mesh: Mesh, params: str, edits: Optional[str], hints: Optional[_Labels], seed: int, threads: Optional[int],
    max_memory: Optional[int], work_dir: Optional[_Path], force: bool, tmp: Optional[_Path], progress: _Progress,
) -> tuple[_Labels, NDArray[np.float32], NDArray[np.uint8], Optional[str], Optional[_Labels], Optional[Decision], list[str], str]: ...
def correspond(
    a: Mesh, b: Mesh, matching: str, transfer: bool, alternative: int, vectors: Optional[int], landmarks: Optional[int], seed: int,
    threads: Optional[int], max_memory: Optional[int], tmp: Optional[_Path], progress: _Progress,
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32], str]: ...
def save_matches(
    matches: NDArray[np.int64], distances: NDArray[np.float32], confidence: NDArray[np.float32], path: _Path
) -> None: ...
def cut_tree(tree: str, cells: _Labels, parts: int) -> _Labels: ...
def read_names(path: _Path) -> list[str]: ...
def part_colours(mesh: Mesh, labels: _Labels) -> NDArray[np.uint8]: ...
def save(
    mesh: Mesh, labels: _Labels, colours: NDArray[np.uint8], quality: Optional[NDArray[np.float32]], names: Sequence[str], path: _Path,
    report: str, tree: Optional[str], cells: Optional[_Labels], decision: Optional[Decision], edits: Optional[str],
    options: tuple[bool, bool, bool, bool, str],
) -> None: ...
def picture(
    mesh: Mesh, labels: Optional[_Labels], colours: NDArray[np.uint8], width: int, height: int, views: int, transparent: bool,
    legend: bool, lines: bool, up: Optional[str], turn: float, tilt: float,
) -> NDArray[np.uint8]: ...
def measure_parts(mesh: Mesh, labels: _Labels, parts: int) -> str: ...
def measure_mesh(mesh: Mesh) -> str: ...
def evaluate(mesh: Mesh, labels: _Labels, truths: Sequence[_Labels]) -> str: ...
def transfer_labels(
    from_mesh: Mesh, labels: _Labels, to_mesh: Mesh, threads: Optional[int], max_memory: Optional[int], tmp: Optional[_Path],
    progress: _Progress,
) -> tuple[_Labels, NDArray[np.float32], str]: ...
def sequence(
    mesh: Mesh, order: str, sweeps: int, landmarks: Optional[int], seed: int, threads: Optional[int], max_memory: Optional[int],
    tmp: Optional[_Path], progress: _Progress,
) -> tuple[_Labels, _Labels, str]: ...
def quality(
    mesh: Mesh, landmarks: Sequence[int], samplings: Sequence[str], seeds: int, seed: int, threads: Optional[int],
    max_memory: Optional[int], tmp: Optional[_Path], progress: _Progress,
) -> str: ...
