#!/usr/bin/env python3
"""Fits the trees that say how probably people keep two regions in one part (src/cluster/parts/merge_odds.rs).

tools/fit/boost.py -o FOLDER EXAMPLES.npy... [--copies COPIES.npy...] [--copy-weight .2] [--categories]

EXAMPLES.npy comes from `cargo run --release -p nystrom-stream-tools --bin fit -- BENCHMARK --examples EXAMPLES.npy --seeds 4`,
COPIES.npy from the same with the benchmark that tools/fit/decimated.py makes: the same models in other triangles, which count a fifth
(--copy-weight). Several files of either have the same models merged in other orders (`--odds-power`), and share that weight. FOLDER
gets all.json, fitted to all models, half-0.json and half-1.json, for judging one half of each category by the other, and fold-0.json
to fold-4.json, for judging categories by four fifths of them. With --categories, also category-0.json, category-1.json, …, each
fitted to all categories but that one. Needs LightGBM and NumPy; one thread, so that the same examples give the same trees.
"""

import argparse
import json
import pathlib

import lightgbm
import numpy as np

KEYS = 6  # model, category, position, seed, share of people who join, pairs
DEPTH, ROUNDS = 3, 300
COPY = 0.2  # weight of a copy
POWER = 0.6  # of the pairs in the weight of a merge
PARAMS = {
    "objective": "cross_entropy",
    "max_depth": DEPTH,
    "num_leaves": 1 << DEPTH,
    "learning_rate": 0.05,
    "lambda_l2": 50,
    "min_data_in_leaf": 400,
    "feature_fraction": 0.5,
    "bagging_fraction": 0.5,
    "bagging_freq": 1,
    "seed": 1,
    "deterministic": True,
    "num_threads": 1,
    "verbosity": -1,
}


def full(tree):
    """A tree's features, thresholds and leaves with every leaf at the same depth: those higher up are repeated."""
    feature, threshold, leaf = [], [], []
    level = [tree]
    for _ in range(DEPTH):
        below = []
        for node in level:
            split = "split_feature" in node
            feature.append(node["split_feature"] if split else 0)
            threshold.append(node["threshold"] if split else 0.0)
            below += [node["left_child"], node["right_child"]] if split else [node, node]
        level = below
    return feature, threshold, [node["leaf_value"] for node in level]


def fit(features, together, pairs, share, chosen):
    weight = np.abs(2 * together - 1) * pairs**POWER * share
    data = lightgbm.Dataset(features[chosen], together[chosen] > 0.5, weight=weight[chosen] / weight[chosen].mean())
    model = lightgbm.train(PARAMS, data, ROUNDS).dump_model()
    trees = [full(info["tree_structure"]) for info in model["tree_info"]]
    rounded = lambda values, digits: [float(f"{x:.{digits}g}") for x in values]
    return {
        "depth": DEPTH,
        "feature": [x for tree in trees for x in tree[0]],
        "threshold": rounded([x for tree in trees for x in tree[1]], 7),
        "leaf": rounded([x for tree in trees for x in tree[2]], 5),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=pathlib.Path, required=True, metavar="FOLDER")
    parser.add_argument("examples", nargs="+")
    parser.add_argument("--copies", nargs="+", default=[])
    parser.add_argument("--copy-weight", type=float, default=COPY)
    parser.add_argument("--categories", action="store_true")
    args = parser.parse_args()
    tables = [np.load(path) for path in args.examples + args.copies]
    examples = np.concatenate([table.reshape(len(table), -1) for table in tables])
    weights = [1 / len(args.examples)] * len(args.examples) + [args.copy_weight / len(args.copies) for _ in args.copies]
    share = np.repeat(weights, [len(table) for table in tables])
    category, position = examples[:, 1].astype(int), examples[:, 2].astype(int)
    together, pairs, features = examples[:, 4].astype(float), examples[:, 5].astype(float), examples[:, KEYS:]
    wanted = {"all": np.ones(len(examples), bool)}
    wanted |= {f"half-{k}": position % 2 != k for k in range(2)}
    wanted |= {f"fold-{k}": category % 5 != k for k in range(5)}
    if args.categories:
        wanted |= {f"category-{k}": category != k for k in range(category.max() + 1)}
    args.out.mkdir(parents=True, exist_ok=True)
    for name, chosen in wanted.items():
        text = json.dumps(fit(features, together, pairs, share, chosen), separators=(",", ":"))
        (args.out / f"{name}.json").write_text(text + "\n")
        print(name, chosen.sum(), "examples", len(text), "bytes", flush=True)


if __name__ == "__main__":
    main()
