"""Puts the answers of all batches together: tables of meshes and parts, and the list of failures."""

import json
from pathlib import Path

import polars

snakemake = globals()["snakemake"]
lines = [json.loads(line) for path in snakemake.input.batches for line in Path(path).read_text().splitlines()]
done = [line for line in lines if "error" not in line]
failed = [line for line in lines if "error" in line]

schema = {"name": str, "mesh": str, "batch": str, "faces": polars.Int64, "parts": polars.Int64, "seconds": float}
meshes = polars.DataFrame([{**line, "parts": len(line["parts"])} for line in done], schema=schema)
meshes.write_parquet(snakemake.output.meshes)
meshes.write_csv(snakemake.output.text, separator="\t", float_precision=3)

schema = {"name": str, "label": polars.Int64, "faces": polars.Int64, "area": float}
parts = polars.DataFrame([{"name": line["name"], **part} for line in done for part in line["parts"]], schema=schema)
parts.write_parquet(snakemake.output.parts)

columns = ("name", "mesh", "batch", "error")
failed = polars.DataFrame([{key: line[key] for key in columns} for line in failed], schema=dict.fromkeys(columns, str))
failed.write_csv(snakemake.output.failed, separator="\t")
Path(snakemake.log[0]).write_text(f"{len(done)} meshes done, {failed.height} failed\n")
