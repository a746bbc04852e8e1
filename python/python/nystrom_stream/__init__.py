"""Cuts triangle and polygon meshes of any size into their meaningful parts.

>>> import nystrom_stream
>>> cut = nystrom_stream.segment("mesh.ply")    # or (vertices, faces), a trimesh, PyVista or Open3D mesh
>>> cut.n_parts, cut.labels                     # one part per face
>>> cut.cut(3)                                  # another number of parts, at once
>>> cut.save("parts.glb")

Besides cutting, `plan` predicts what a cut takes, `correspond` matches two meshes, `transfer_labels` copies labels to another version of a mesh, `evaluate` scores
labels against human ones, `picture` draws, `sequence` orders a mesh for streaming, `quality` measures samples of landmarks, and
`measure` measures a mesh. All release the GIL while they work and stop on Ctrl-C; those with a `progress` argument report progress
to it.
"""

from ._functions import (
    correspond,
    evaluate,
    measure,
    picture,
    plan,
    quality,
    read_mesh,
    segment,
    segment_file,
    sequence,
    transfer_labels,
)
from ._native import __version__
from ._results import Correspondence, Segmentation, Sequence, Transfer

__all__ = [
    "Correspondence",
    "Segmentation",
    "Sequence",
    "Transfer",
    "__version__",
    "correspond",
    "evaluate",
    "measure",
    "picture",
    "plan",
    "quality",
    "read_mesh",
    "segment",
    "segment_file",
    "sequence",
    "transfer_labels",
]
