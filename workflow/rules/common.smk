# The configuration, checked; what the program predicts of a mesh, and resources made of that; what is to be made.
import csv
import functools
import json
import math
import os
import shlex
import subprocess
from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.utils import validate

validate(config, "../schemas/config.schema.yaml")

PROGRAM = config["program"]


@functools.cache
def plan(mesh, options):
    """What `plan` predicts of `mesh` under `options`: bytes and seconds by stage. None for a mesh that it refuses."""
    words = [PROGRAM, "plan", mesh, "--json", "--max-memory", config["max_memory"]]
    words += ["--work-dir", "results", *shlex.split(options)]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise WorkflowError(
            f"{PROGRAM}: no such program; set program in the configuration"
        ) from error
    # Its exit code also says whether the disk suffices here and now, which is for the rule to find out.
    return json.loads(done.stdout) if done.stdout.lstrip().startswith("{") else None


def stages(mesh, options, names):
    """The stages `names` of the plan, all for None."""
    found = plan(mesh, options) if Path(mesh).exists() else None
    return (
        []
        if found is None
        else [s for s in found["stages"] if names is None or s["name"] in names]
    )


def mem_mb(mesh, options="", names=None, attempt=1):
    """Megabytes for the stages `names`: the greatest of them, a quarter more, and 256 for the program itself."""
    most = max((stage["memory"] for stage in stages(mesh, options, names)), default=0)
    return attempt * (math.ceil(1.25 * most / 1e6) + 256)


def disk_mb(mesh, options=""):
    """Megabytes that the work directory takes at most."""
    found = plan(mesh, options) if Path(mesh).exists() else None
    return math.ceil(found["disk_peak"] / 1e6) + 1 if found else 1


def runtime(mesh, options="", names=None, attempt=1, times=1):
    """Minutes for `times` the stages `names`: five times what was predicted here, and ten for a busy disk."""
    seconds = sum(stage["seconds"] or 0 for stage in stages(mesh, options, names))
    return attempt * (math.ceil(5 * times * seconds / 60) + 10)


def named(rows, section):
    """Meshes by name; the name is that of the file where none is given."""
    meshes = {}
    for row in rows:
        name = (
            row.get("name")
            or Path(row["mesh"]).name.removesuffix(".gz").rsplit(".", 1)[0]
        )
        if name in meshes:
            raise WorkflowError(
                f"{section}: two meshes have the name {name!r}; give one of them another"
            )
        meshes[name] = row["mesh"]
    return meshes


# Large meshes.
MESHES = named(config["mesh"], "mesh") if "mesh" in config else {}
SHARDS = config["shards"]
BEFORE_ROWS = ("read", "order", "graph", "surface", "weights")

# What is divided of a mesh that is cut by the default recipe, in this order: the stage of the plan, and the stages before.
SHARED = {
    "normals": ("surface",),
    "contraction": ("contraction",),
    "rows": ("rows",),
    "depths": ("labels",),
    "bands": ("labels",),
}
BEFORE_SHARES = {
    "normals": ("read", "order", "graph"),
    "contraction": ("read", "surface", "weights"),
    "rows": ("read", "contraction"),
    "depths": ("read", "rows", "labels"),
    "bands": ("read", "labels"),
}


def settings(name):
    return dict(zip(MESHES, config["mesh"]))[name]


def is_exact(name):
    return settings(name).get("exact", True)


def row_options(wildcards):
    """Options of the rows, which are over all faces unless `exact` is false: then the default method contracts a large mesh."""
    options = settings(wildcards.mesh).get("rows", "")
    return f"{options} --exact".strip() if is_exact(wildcards.mesh) else options


def cut_options(wildcards):
    return settings(wildcards.mesh).get("cut", "")


def steps(name):
    """What is divided of a mesh: its boundaries only where that is asked for."""
    boundaries = settings(name).get("boundaries", False)
    return [step for step in SHARED if boundaries or "labels" not in SHARED[step]]


def share_options(wildcards):
    """Options of a step: those of `cut` count from the decision on."""
    cut = cut_options(wildcards) if "labels" in SHARED[wildcards.step] else ""
    return f"{row_options(wildcards)} {cut}".strip()


def mesh_of(wildcards):
    return MESHES[wildcards.mesh]


def shares(name, step):
    """The answers of all shares of a step."""
    of = f"results/mesh/{name}/share/{step}"
    return [f"{of}/{i}-of-{SHARDS}.json" for i in range(SHARDS)]


def shares_before(wildcards):
    """The shares that a step waits for."""
    order = list(SHARED)
    before = order[: order.index(wildcards.step)][-1:]
    return [answer for step in before for answer in shares(wildcards.mesh, step)]


def divided(wildcards):
    """What `cut` waits for."""
    name = wildcards.mesh
    if is_exact(name):
        return f"results/mesh/{name}/merged.json"
    return shares(name, steps(name)[-1])


def jobs(name):
    """The jobs of a mesh by their benchmarks."""
    answers = [f"rows-{i}-of-{SHARDS}" for i in range(SHARDS)]
    if is_exact(name):
        return ["prepare", *answers, "merge", "cut"]
    shared = [f"{i}-of-{SHARDS}" for i in range(SHARDS)]
    return [
        *(
            f"share/{step}/{job}"
            for step in steps(name)
            for job in ["prepare", *shared]
        ),
        "cut",
    ]


def targets_of_meshes():
    if not MESHES:
        return []
    outputs = expand(
        "results/mesh/{mesh}/parts.{form}", mesh=MESHES, form=["seg", "png", "json"]
    )
    return [*outputs, "results/mesh/efficiency.tsv"]


# The archive.
def read_manifest():
    if "archive" not in config:
        return {}
    path = Path(config["archive"]["manifest"])
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    if not rows or "mesh" not in rows[0]:
        raise WorkflowError(
            f"{path}: needs a column mesh, separated by tabs, and a line per mesh"
        )
    # Paths are taken from the folder of the manifest.
    at = lambda mesh: os.path.normpath(path.parent / mesh)
    return named([{**row, "mesh": at(row["mesh"])} for row in rows], str(path))


ARCHIVE = read_manifest()
BATCHES = {}
for k, name in enumerate(ARCHIVE):
    BATCHES.setdefault(f"{k // config['archive']['batch']:04}", []).append(name)


def targets_of_archive():
    if not ARCHIVE:
        return []
    tables = expand(
        "results/archive/{table}",
        table=["meshes.parquet", "meshes.tsv", "parts.parquet", "failed.tsv"],
    )
    return [*tables, "results/archive/overview.png"]


def meshes_of(wildcards):
    return [ARCHIVE[name] for name in BATCHES[wildcards.batch]]


def largest(wildcards):
    """The largest file of a batch, whose plan stands for all: a plan for each would take longer than small meshes do."""
    there = [mesh for mesh in meshes_of(wildcards) if Path(mesh).exists()]
    return max(there, key=os.path.getsize, default="")


ARCHIVE_OPTIONS = config.get("archive", {}).get("options", "")


# The sweep.
SWEEP = config.get("sweep", {})
SWEEP_MESH = SWEEP.get("mesh", "")
SWEEP_ROWS = f"--cluster kmeans -l {SWEEP.get('landmarks', 0)} {SWEEP.get('rows', '')}"
# What is planned: rows are over all faces, and K-means needs the number of parts.
SWEEP_PLAN = f"{SWEEP_ROWS} --exact -k {max(SWEEP.get('k', [1]))}"


def targets_of_sweep():
    return (
        expand("results/sweep/{table}", table=["sweep.tsv", "sweep.png"])
        if SWEEP
        else []
    )
