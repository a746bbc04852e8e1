"""A script as people write it, for type checkers alone: `mypy --strict typed.py` finds nothing wrong."""

from pathlib import Path

import numpy as np

import nystrom_stream as ns

cut = ns.segment("mesh.ply", parts=4, cluster="kmeans", max_memory="1GiB", progress=lambda stage, done, total: None)
labels: np.ndarray = cut.labels
cut.names = ["a", "b"]
cut.names = {0: "a"}
print(cut.n_parts, len(cut), cut[0].sum(), cut.cut(3).recut(2).max(), cut.report["parts"], cut.quality)
cut.save(Path("x.ply"), split_faces=True)
better = cut.edit([{"edit": "merge", "at": [cut.place(0), cut.place(1)]}]).edit("edits.json")
print(ns.evaluate(cut, [better.labels])["rand"], ns.measure(cut)["area"], cut.measure()[0]["area"], cut.tree)
vertices, faces = ns.read_mesh("mesh.ply")
found = ns.correspond(vertices, faces, vertices, faces, matching="mutual", refine="laplacian", partial=True)
ns.correspond(cut, cut, sampling="random", distance="edges", sigma=0.5, work_dir="work")
ns.evaluate(cut, ["a.seg", Path("b.npy")]), ns.picture("mesh.ply", Path("labels.seg")), cut.cells
print(ns.plan("mesh.ply", parts=4, calibrate=False, work_dir=Path("work"))["memory"])
carried = ns.transfer_labels(cut, (vertices, faces))
image = ns.picture(cut, size=(320, 200), up="-y")
order = ns.sequence(vertices, faces, order="hilbert").order
for record in ns.quality(cut, landmarks=[5, 10], samplings=["random", "farthest"], kernel="cauchy", metric="paper", delta=0.1):
    print(record["gamma"], found.matches[0], carried.labels, image.shape, order, ns.__version__)
cut.to_trimesh(), cut.to_pyvista(), cut.picture(views=2), carried.names, carried.colours
carried.save("carried.glb")
