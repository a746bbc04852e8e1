"""Cuts triangle meshes of any size into their meaningful parts.

>>> import nystrom_stream
>>> cut = nystrom_stream.segment_file("mesh.ply")
>>> cut.labels          # one part per face
>>> cut.report["parts"] # faces, area and colour of each part
>>> cut.recut(3)        # another number of parts, at once

`segment` takes NumPy arrays, `segment_file` a file, `correspond` matches two meshes; all give up Python's lock while they work, tell a callback how far
they are, and stop at Ctrl-C.
"""

from ._native import Correspondence, Segmentation, __version__, correspond, read_mesh, segment, segment_file

__all__ = ["Correspondence", "Segmentation", "__version__", "correspond", "read_mesh", "segment", "segment_file"]
