"""Segments a batch of meshes: one Parquet file per mesh, in the partition mesh=NAME, and one line of JSON per mesh.

In the name of the partition, characters that have a meaning there are escaped as by Hive: readers find no column in mesh=a=b.

A mesh that the program refuses is a line with an error; it is tried twice, in case that a network folder failed it. Where
the folder itself fails, such as on a full disk, the batch fails, to be run again. The folder is made under another name and
renamed when whole.
"""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

SPECIAL = re.compile(r"""[\x00-\x1f\x7f"#%'*/:=?\\{[\]^]""")

snakemake = globals()["snakemake"]
log = open(snakemake.log[0], "w", encoding="utf-8")
out, answers = Path(snakemake.output.faces), Path(snakemake.output.meshes)
partial = out.with_name(out.name + ".partial")
shutil.rmtree(partial, ignore_errors=True)


def segment(name, mesh):
    """The program's answer for one mesh."""
    folder = partial / f"mesh={SPECIAL.sub(lambda found: f'%{ord(found[0]):02X}', name)}"
    folder.mkdir(parents=True, exist_ok=True)
    report = folder / "report.json"
    words = [snakemake.params.program, "segment", mesh, *shlex.split(snakemake.params.options)]
    words += ["-o", str(folder / "part-0.parquet"), f"--json={report}", "--progress", "none"]
    words += ["--threads", str(snakemake.threads), "--max-memory", snakemake.params.max_memory]
    done = subprocess.run(words, stderr=subprocess.PIPE, text=True, check=False)
    log.write(done.stderr)
    log.flush()
    line = {"name": name, "mesh": mesh, "batch": snakemake.wildcards.batch}
    if done.returncode == 0:
        told = json.loads(report.read_text())
        report.unlink()
        keys = ("label", "faces", "area")
        parts = [{key: part[key] for key in keys} for part in told["parts"]]
        return {**line, "faces": told["input"]["faces"], "seconds": told["seconds"]["total"], "parts": parts}
    shutil.rmtree(folder)
    error = done.stderr.strip().removeprefix("nystrom-stream: ")
    # The batch's own folder, such as one on a full disk, is no fault of the mesh.
    is_of_folder = str(partial) in error and ("(os error " in error or "of disk space" in error)
    if done.returncode == 1 and not is_of_folder:
        return {**line, "error": error}
    # Misused, killed, or nowhere to write: nothing that another mesh would do better.
    sys.exit(f"{words[0]} ended with {done.returncode}: {done.stderr}")


lines = []
for name, mesh in zip(snakemake.params.names, snakemake.params.meshes, strict=True):
    line = segment(name, mesh)
    lines.append(segment(name, mesh) if "error" in line else line)
partial.mkdir(parents=True, exist_ok=True)
shutil.rmtree(out, ignore_errors=True)
partial.rename(out)
answers.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
