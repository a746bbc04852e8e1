"""Seconds of every job of every mesh, and how much of its cores it used, from Snakemake's benchmarks."""

import csv
from pathlib import Path

snakemake = globals()["snakemake"]
jobs, threads = snakemake.params.jobs, snakemake.params.threads
with open(snakemake.output[0], "w", newline="", encoding="utf-8") as out:
    table = csv.writer(out, delimiter="\t", lineterminator="\n")
    table.writerow(["mesh", "job", "seconds", "cpu_seconds", "cores", "efficiency"])
    for mesh, steps in jobs.items():
        for step in steps:
            with (Path(snakemake.params.benchmarks) / mesh / f"{step}.tsv").open(newline="") as file:
                (row,) = csv.DictReader(file, delimiter="\t")
            cores = 1 if step == "merge" else threads
            # Jobs that end before they are looked at have no seconds of processor.
            wall, cpu = float(row["s"]), row["cpu_time"]
            known = cpu not in ("NA", "-") and float(cpu) > 0
            share = f"{float(cpu) / (wall * cores):.2f}" if known else "NA"
            table.writerow([mesh, step, f"{wall:.2f}", cpu if known else "NA", cores, share])
Path(snakemake.log[0]).write_text(f"{len(jobs)} meshes, {sum(map(len, jobs.values()))} jobs\n")
