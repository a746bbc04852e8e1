#!/usr/bin/env python3
"""Times of the paper's Table 1 beside ours: the same numbers of faces and parts, on one thread.

    table1.py REAL OUT [--bin PROGRAM] [--runs 7]

REAL holds the meshes named below; the paper's own are not published but for the horse, so others are decimated to its
sizes into OUT (tools/decimate.py and its packages). Times are of whole processes, reading and writing included: the
median of the runs after a first one. The paper: 2.2 GHz Pentium, K-means, and iterative 2-means for the last two; ten
landmarks throughout.
"""

import argparse
import statistics
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from decimate import by_fast_simplification

# Model, faces, parts, seconds, way, our mesh.
TABLE = [
    ("Heart", 1619, 4, 0.03, "kmeans", "horse_4k"),
    ("Igea", 2000, 3, 0.07, "kmeans", "igea"),
    ("Headless", 32574, 7, 2.23, "kmeans", "lucy_100k_orig"),
    ("Smile", 34712, 5, 3.32, "kmeans", "igea"),
    ("Horse", 39698, 8, 6.86, "two-means", "horse_paper_39698"),
    ("Hand bone", 65001, 7, 9.67, "two-means", "horse_97k_orig_BE"),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("real", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--bin", default="target/release/nystrom-stream")
    parser.add_argument("--runs", type=int, default=7)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    print("| model | faces | parts | paper, s | our mesh | faces | as the paper, s | default parts, s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for model, faces, parts, paper, way, ours in TABLE:
        source, mesh = args.real / f"{ours}.ply", args.out / f"{model.replace(' ', '_')}.ply"
        if "39698" in ours:
            mesh, count = source, faces
        else:
            count = by_fast_simplification(source, faces, mesh)

        def run(*options: str) -> float:
            words = [args.bin, "segment", str(mesh), "-q", "-o", str(args.out / "out.seg"), "-k", str(parts), "--threads", "1"]
            times = []
            for _ in range(args.runs + 1):
                start = time.perf_counter()
                subprocess.run(words + list(options), check=True)
                times.append(time.perf_counter() - start)
            return statistics.median(times[1:])

        liu = run("--cluster", way, "-l", "10", "--metric", "paper", "--normalise", "none", "--exact")
        own = run()
        print(f"| {model} | {faces} | {parts} | {paper} | {ours} | {count} | {liu:.3f} ({way}) | {own:.3f} |", flush=True)


if __name__ == "__main__":
    main()
