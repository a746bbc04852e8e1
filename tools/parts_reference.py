#!/usr/bin/env python3
"""Reference numbers for the decisions over cells, from the prototype of the recipe.

  parts_reference.py dump RECIPE.py PSB OUT [--models 2,4] [--full 2,4] [--seed 0]
  parts_reference.py score RECIPE.py PSB OUT [--names proto_found,found,...] [--refine] [--table]

`dump` writes a folder a model: the cell graph and the rows averaged to cells (what the library's
`cluster::parts` is given), the prototype's decisions, what is needed to carry labels of cells to
faces, and for the models of --full every intermediate result that tests/library/parts_reference.rs
compares. `score` reads `NAME.npy` (a label a cell) from each folder and prints the mean 1 - Rand
against the human segmentations. PSB holds N.ply, N_j.seg and models.tsv.
"""
import argparse
import glob
import importlib.util
import json
import os
import time

import numpy as np


def load_recipe(path):
    spec = importlib.util.spec_from_file_location("recipe", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def models_of(psb, chosen):
    with open(os.path.join(psb, "models.tsv")) as f:
        table = [line.split("\t") for line in f.read().split("\n")[1:] if line]
    rows = [(m, c, int(p)) for m, c, _, p, *_ in table]
    return [r for r in rows if not chosen or int(r[0]) in chosen]


def save(folder, **arrays):
    for name, x in arrays.items():
        x = np.asarray(x)
        kind = np.float64 if x.dtype.kind == "f" else np.uint32
        np.save(os.path.join(folder, name + ".npy"), np.ascontiguousarray(x, kind))


def cells_of(R, V, F, rows, seed):
    """The prototype's floors below: cells, rows, and what carries labels to faces."""
    rng = np.random.RandomState(seed)
    keep, comp = R.drop_dust(V, F)
    g, _ = R.dual_graph(V, F[keep])
    theta = [R.turning(g, R.micro_cell_normals(g, r, rng)) for r in R.RADII]
    chosen, _ = R.choose_radius(g, theta)
    g.weight = R.edge_weights(g.gd, theta[chosen])
    t04 = R.turning(g, R.micro_cell_normals(g, .04, rng))
    s, cell = R.cells(g, theta[1], theta[2], t04, rng)
    B = R.farthest_point_rows(g, cell, rows)
    x = V[F].mean(1)
    source = np.cumsum(keep) - 1                        # node of each face; dust: of the nearest real face
    if not keep.all():
        count = np.bincount(comp)
        centroid = R.sums(comp, x, len(count)) / count[:, None]
        near = R.cKDTree(x[keep]).query(centroid[comp[~keep]])[1]
        source[~keep] = near
    return g, s, cell, B, source, rng


def objective(C, area, label, threshold=.5):
    Z = np.eye(label.max() + 1)[label]
    gain = np.outer(area, area) * (C - threshold)
    np.fill_diagonal(gain, 0)
    return float(np.trace(Z.T @ gain @ Z)) / 2


def full_dump(R, s, B, folder, rng):
    """Intermediate results on fixed inputs, for a comparison number by number."""
    a = s.area / s.area.sum()
    X12 = R.anchor_embedding(B, a, 12, .2)
    X28 = R.anchor_embedding(B, a, 28, .25)
    region = R.over_segment(s, B, 28, .25, rng)
    other = R.over_segment(s, B[: max(len(B) // 2, 1)], 22, .3, rng)
    atom = np.unique(np.stack([region, other], 1), axis=0, return_inverse=True)[1].ravel()
    Q, P = R.atom_sums(s, region, X12)
    VT = R.convexity(s, atom)
    VTr = R.convexity(s, region)
    V, T = VTr[1]
    i, j = np.nonzero(P[1])
    save(folder, x12=X12, x28=X28, region=region, atom2=atom, q=Q, p=P,
         v=np.array([v for v, _ in VT]), t=np.array([t for _, t in VT]), vr=V, tr=T,
         cost_i=i, cost_j=j, cost=R.log_cost(Q, P, V, T, i, j), tree=R.merge_tree(Q, P, V, T))


def dump(args):
    R = load_recipe(args.recipe)
    for model, _, parts in models_of(args.psb, args.models):
        folder = os.path.join(args.out, model)
        if os.path.exists(os.path.join(folder, "info.json")):
            continue
        os.makedirs(folder, exist_ok=True)
        start = time.time()
        V, F = R.read_ply(os.path.join(args.psb, model + ".ply"))
        g, s, cell, B, source, rng = cells_of(R, V, F, args.rows, args.seed)
        save(folder, area=s.area, centre=s.centre, normal=s.normal, pairs=s.pair, length=s.length,
             concave=s.concave, convex=s.convex, convex04=s.convex04, rows=B, cell=cell, source=source)
        np.savez(os.path.join(folder, "nodes.npz"), area=g.area, pair=g.pair, length=g.length, gd=g.gd,
                 weight=g.weight)
        atom, C, area, touch = R.co_association(s, B, rng)
        found = R.expected_rand_labelling(C, area)
        given = R.expected_rand_labelling(C, area, parts, touch)
        save(folder, proto_found=R.small_parts(s, found[atom], True),
             proto_given=R.small_parts(s, given[atom], False))
        info = dict(model=int(model), parts=parts, rows=len(B), cells=s.n, atoms=len(area),
                    objective=objective(C, area, found), objective_given=objective(C, area, given))
        if args.full and int(model) in args.full:
            save(folder, atom=atom, c=C, atom_area=area, touch=touch, found=found, given=given)
            full_dump(R, s, B, folder, rng)
            info["full"] = True
        with open(os.path.join(folder, "info.json"), "w") as f:
            json.dump(info, f)
        print(model, f"{time.time() - start:.1f} s", flush=True)


def score(args):
    R = load_recipe(args.recipe)
    names, table = args.names.split(","), {}
    for model, category, _ in models_of(args.psb, args.models):
        folder = os.path.join(args.out, model)
        if not os.path.exists(os.path.join(folder, names[-1] + ".npy")):
            continue
        read = lambda name: np.load(os.path.join(folder, name + ".npy")).astype(np.int64)
        cell, source = read("cell"), read("source")
        truths = [R.read_seg(p) for p in sorted(glob.glob(os.path.join(args.psb, model + "_*.seg")))]
        g = None
        if args.refine:
            z = np.load(os.path.join(folder, "nodes.npz"))
            none = np.zeros((len(z["area"]), 3))
            g = R.Graph(z["area"], none, none, z["pair"], z["length"], z["gd"], z["weight"])
        row = []
        for name in names:
            label = R.compact(read(name))[cell]
            label = R.compact((R.refine_band(g, label) if args.refine else label)[source])
            row += [R.rand_distance(label, truths), label.max() + 1]
        table.setdefault(category, []).append((int(model), row))
    groups = dict(table) if args.table else {}
    groups["all"] = sum(table.values(), [])
    print(f"{'':<10} {'n':>4}  " + "  ".join(f"{n:>18}" for n in names))
    for category, rows in groups.items():
        m = np.mean([r for _, r in rows], 0)
        print(f"{category:<10} {len(rows):>4}  " + "  ".join(f"{a:>10.4f} ({b:5.1f})" for a, b in m.reshape(-1, 2)))
    if args.save:
        with open(args.save, "w") as f:
            json.dump(dict(names=names, rows=[(c, m, r) for c, v in table.items() for m, r in v]), f)


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    numbers = lambda x: {int(i) for i in x.split(",")}
    sub = ap.add_subparsers(required=True)
    for name, run in (("dump", dump), ("score", score)):
        p = sub.add_parser(name)
        p.set_defaults(run=run)
        p.add_argument("recipe")
        p.add_argument("psb")
        p.add_argument("out")
        p.add_argument("--models", type=numbers)
        if name == "dump":
            p.add_argument("--full", type=numbers)
            p.add_argument("--rows", type=int, default=60)
            p.add_argument("--seed", type=int, default=0)
        else:
            p.add_argument("--names", default="proto_found,proto_given")
            p.add_argument("--refine", action="store_true")
            p.add_argument("--table", action="store_true")
            p.add_argument("--save")
    args = ap.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
