#!/usr/bin/env python3
"""Makes a copy of a benchmark with a quarter of the faces, for fitting to triangles that differ (tools/fit/boost.py).

    pip install numpy scipy plyfile fast-simplification
    tools/fit/decimated.py BENCHMARK OUT

OUT gets models.tsv, N.ply by quadric decimation, and N_j.seg: each face has the label that the person gave the nearest face of the
original. A third of a second a model.
"""

import pathlib
import shutil
import sys

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))
import stability


def main():
    source, out = map(pathlib.Path, sys.argv[1:3])
    out.mkdir(parents=True, exist_ok=True)
    shutil.copy(source / "models.tsv", out)
    for line in (source / "models.tsv").read_text().split("\n")[1:]:
        model = line.split("\t")[0]
        if not model:
            continue
        stability.decimate(source / f"{model}.ply", out / f"{model}.ply")
        middle = [v[f].mean(1) for v, f in (stability.read_ply(folder / f"{model}.ply") for folder in (source, out))]
        near = cKDTree(middle[0]).query(middle[1])[1]
        for person in source.glob(f"{model}_*.seg"):
            np.savetxt(out / person.name, stability.read_seg(person)[near], "%d")


if __name__ == "__main__":
    main()
