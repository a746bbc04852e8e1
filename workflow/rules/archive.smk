# An archive: a manifest of meshes in; a data set of faces, a table of meshes and a list of failures out.
#
# Meshes are worked on in batches, so that a scheduler sees tens of jobs and not tens of thousands. A mesh that cannot be
# used goes on the list of failures and does not stop its batch; a batch that is cut short is run again as a whole.


rule batch:
    input:
        # One that is missing goes on the list of failures like one that is torn.
        meshes=lambda w: [mesh for mesh in meshes_of(w) if Path(mesh).exists()],
    output:
        faces=directory("results/archive/faces/batch={batch}"),
        meshes="results/archive/batches/{batch}.jsonl",
    log:
        "results/logs/archive/{batch}.log",
    benchmark:
        "results/benchmarks/archive/{batch}.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(largest(w), ARCHIVE_OPTIONS, None, attempt),
        disk_mb=lambda w: disk_mb(largest(w), ARCHIVE_OPTIONS),
        runtime=lambda w, attempt: runtime(
            largest(w), ARCHIVE_OPTIONS, None, attempt, len(BATCHES[w.batch])
        ),
    params:
        program=PROGRAM,
        names=lambda w: BATCHES[w.batch],
        meshes=meshes_of,
        options=ARCHIVE_OPTIONS,
        max_memory=config["max_memory"],
    script:
        "../scripts/batch.py"


rule tables:
    input:
        batches=expand("results/archive/batches/{batch}.jsonl", batch=BATCHES),
        faces=expand("results/archive/faces/batch={batch}", batch=BATCHES),
    output:
        meshes="results/archive/meshes.parquet",
        text=report(
            "results/archive/meshes.tsv",
            caption="../report/meshes.rst",
            category="Archive",
        ),
        parts="results/archive/parts.parquet",
        failed=report(
            "results/archive/failed.tsv",
            caption="../report/failed.rst",
            category="Archive",
        ),
    log:
        "results/logs/archive/tables.log",
    conda:
        "../envs/tables.yaml"
    resources:
        mem_mb=2000,
        runtime=60,
    script:
        "../scripts/tables.py"


rule overview:
    input:
        "results/archive/parts.parquet",
    output:
        report(
            "results/archive/overview.png",
            caption="../report/overview.rst",
            category="Archive",
        ),
    log:
        "results/logs/archive/overview.log",
    conda:
        "../envs/tables.yaml"
    resources:
        mem_mb=1000,
        runtime=20,
    script:
        "../scripts/overview.py"
