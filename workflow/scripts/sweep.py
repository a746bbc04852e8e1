"""One line per point of the sweep, and a plot: parts found or asked for against what they score, or their seconds."""

import json
from pathlib import Path

import matplotlib
import polars

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402  the backend comes first

snakemake = globals()["snakemake"]
rows = []
for path in map(Path, snakemake.input.answers):
    told = json.loads(path.read_text())
    sampling, seed = path.parts[-3].rsplit("-", 1)
    kernel, k = path.parts[-2].rsplit("-", 1)
    row = {"sampling": sampling, "seed": int(seed), "kernel": kernel, "k": int(k)}
    row |= {"parts": len(told["parts"]), "seconds": round(told["seconds"]["total"], 3)}
    score = path.with_name("score.json")
    if snakemake.input.scores:
        row["one_minus_rand"] = json.loads(score.read_text())["scores"]["rand"]
    rows.append(row)
table = polars.DataFrame(rows)
table.write_csv(snakemake.output.table, separator="\t")
value = "one_minus_rand" if snakemake.input.scores else "seconds"
figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
for (sampling, kernel), group in table.sort("k").group_by("sampling", "kernel", maintain_order=True):
    mean = group.group_by("k", maintain_order=True).agg(polars.col(value).mean())
    axes.plot(mean["k"], mean[value], marker="o", label=f"{sampling}, {kernel}")
axes.set(xlabel="parts", ylabel={"one_minus_rand": "1 − Rand"}.get(value, "seconds"))
axes.legend()
figure.savefig(snakemake.output.plot, dpi=120)
Path(snakemake.log[0]).write_text(f"{table.height} points\n")
