"""Draws how many parts the meshes of an archive have, and how large parts are."""

from pathlib import Path

import matplotlib
import polars

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402  the backend comes first

snakemake = globals()["snakemake"]
parts = polars.read_parquet(snakemake.input[0])
counts = parts.group_by("name").len()["len"]
shares = parts.select(polars.col("area") / polars.col("area").sum().over("name"))["area"]
figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
left.hist(counts, bins=range(1, int(counts.max() or 1) + 2), align="left")
left.set(xlabel="parts", ylabel="meshes")
right.hist(shares, bins=40, range=(0, 1))
right.set(xlabel="share of the surface", ylabel="parts")
figure.savefig(snakemake.output[0], dpi=120)
Path(snakemake.log[0]).write_text(f"{len(counts)} meshes, {parts.height} parts\n")
