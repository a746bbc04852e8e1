"""A tour in Python: cut a mesh, look at its parts, ask for others, save them.

    python tour.py mesh.ply
"""

# %% Cut it; the number of parts is found.
import sys

import numpy as np

import nystrom_stream

path = sys.argv[1]
cut = nystrom_stream.segment_file(path)
print(cut)

# %% Parts by size, with the share of the surface that each has.
parts = cut.report["parts"]
whole = sum(part["area"] for part in parts)
for part in sorted(parts, key=lambda part: -part["area"]):
    print(f"part {part['label']:3}: {part['faces']:9,} faces, {100 * part['area'] / whole:5.1f} % of the area")

# %% The same from arrays, as another library has them; finer, and exactly five parts.
vertices, faces = nystrom_stream.read_mesh(path)
finer = nystrom_stream.segment(vertices, faces, detail=0.5)
five = nystrom_stream.segment(vertices, faces, 5)
print(f"{len(finer.report['parts'])} parts in more detail, {len(np.unique(five.labels))} when asked for")

# %% Which parts would most people not cut out?
print("unsure parts:", [part["label"] for part in parts if part.get("unsure")] or "none")

# %% Correct it: the two smallest parts become one, which gets a name.
smallest = sorted(parts, key=lambda part: part["area"])[:2]
places = [cut.place(part["label"]) for part in smallest]
better = cut.edit([{"edit": "merge", "at": places}, {"edit": "name", "at": places[0], "name": "both"}])
print(f"{better.n_parts} parts after an edit, one of them called {max(better.names)!r}")

# %% Save the labels for anything that reads NumPy.
np.save("labels.npy", cut.labels)
