#!/usr/bin/env python3
"""Reads an archive's results as one data set, with DuckDB and with Polars, and compares what both find.

    tools/check_dataset.py RESULTS/archive

The data set is faces/batch=…/mesh=…/part-0.parquet; batch and mesh are columns that the paths give.
"""

import sys
from pathlib import Path

import duckdb
import polars

archive = Path(sys.argv[1])
pattern = f"{archive}/faces/*/*/*.parquet"
faces = f"read_parquet('{pattern}', hive_partitioning = true, hive_types = {{'batch': varchar, 'mesh': varchar}})"
by_duckdb = duckdb.sql(
    f"select mesh, count(*), count(distinct label), round(sum(area), 6) from {faces} group by mesh order by mesh"
).fetchall()
columns = {"batch": polars.String, "mesh": polars.String}
lazy = polars.scan_parquet(pattern, hive_partitioning=True, hive_schema=columns)
by_polars = (
    lazy.group_by("mesh")
    .agg(polars.len(), polars.col("label").n_unique(), polars.col("area").cast(polars.Float64).sum().round(6))
    .sort("mesh")
    .collect()
    .rows()
)
assert [row[:3] for row in by_duckdb] == [row[:3] for row in by_polars], "DuckDB and Polars count differently"
assert all(abs(a[3] - b[3]) <= 1e-5 * abs(a[3]) for a, b in zip(by_duckdb, by_polars, strict=True)), "areas differ"

meshes = polars.read_parquet(archive / "meshes.parquet").sort("name")
assert [row[:3] for row in by_duckdb] == meshes.select("name", "faces", "parts").rows(), "the table of meshes differs"
joined = duckdb.sql(
    f"""select count(*) from {faces} f join '{archive}/parts.parquet' p on f.mesh = p.name and f.label = p.label"""
).fetchall()[0]
assert joined[0] == meshes["faces"].sum(), "faces without a part"
# One mesh alone reads one file, not all of them.
name = by_duckdb[0][0]
one = duckdb.sql(f"explain analyze select sum(area) from {faces} where mesh = '{name}'").fetchall()[0][1]
assert f"1/{len(by_duckdb)}" in one, "a partition is not pruned"
failed = polars.read_csv(archive / "failed.tsv", separator="\t").height
print(f"{len(by_duckdb)} meshes of {meshes['faces'].sum()} faces, the same to DuckDB and Polars; {failed} failed")
