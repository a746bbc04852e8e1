# One large mesh over several machines: rows by shards in a work directory that all of them see.
#
# The work directory itself is no output: shards write into it side by side. Each rule's output is the program's answer,
# and a rule that is repeated finds what is there. `--force`: where the file of a mesh was replaced, its work directory is made
# anew.


rule prepare:
    input:
        mesh=mesh_of,
    output:
        "results/mesh/{mesh}/prepared.json",
    log:
        "results/logs/mesh/{mesh}/prepare.log",
    benchmark:
        "results/benchmarks/mesh/{mesh}/prepare.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(
            mesh_of(w), row_options(w), BEFORE_ROWS, attempt
        ),
        disk_mb=lambda w: disk_mb(mesh_of(w), row_options(w)),
        runtime=lambda w, attempt: runtime(
            mesh_of(w), row_options(w), BEFORE_ROWS, attempt
        ),
    params:
        program=PROGRAM,
        memory=config["max_memory"],
        work="results/mesh/{mesh}/work",
        options=row_options,
    shell:
        "{params.program:q} rows {input.mesh:q} --work-dir {params.work:q} --force --prepare {params.options}"
        " --threads {threads} --max-memory {params.memory:q} --progress lines --json={output:q} 2> {log:q}"


rule rows:
    input:
        mesh=mesh_of,
        prepared=rules.prepare.output,
    output:
        "results/mesh/{mesh}/rows-{i}-of-{of}.json",
    log:
        "results/logs/mesh/{mesh}/rows-{i}-of-{of}.log",
    benchmark:
        "results/benchmarks/mesh/{mesh}/rows-{i}-of-{of}.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(mesh_of(w), row_options(w), ("rows",), attempt),
        runtime=lambda w, attempt: runtime(
            mesh_of(w), row_options(w), ("rows",), attempt
        ),
    params:
        program=PROGRAM,
        memory=config["max_memory"],
        work="results/mesh/{mesh}/work",
        options=row_options,
    shell:
        "{params.program:q} rows {input.mesh:q} --work-dir {params.work:q} --shard {wildcards.i}/{wildcards.of}"
        " {params.options} --threads {threads} --max-memory {params.memory:q} --progress lines"
        " --json={output:q} 2> {log:q}"


rule merge:
    input:
        expand(
            "results/mesh/{{mesh}}/rows-{i}-of-{of}.json", i=range(SHARDS), of=SHARDS
        ),
    output:
        "results/mesh/{mesh}/merged.json",
    log:
        "results/logs/mesh/{mesh}/merge.log",
    benchmark:
        "results/benchmarks/mesh/{mesh}/merge.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    resources:
        mem_mb=256,
        runtime=lambda w, attempt: runtime(
            mesh_of(w), row_options(w), ("rows",), attempt
        ),
    params:
        program=PROGRAM,
        work="results/mesh/{mesh}/work",
    shell:
        "{params.program:q} merge --work-dir {params.work:q} --progress lines --json={output:q} 2> {log:q}"


rule cut:
    input:
        mesh=mesh_of,
        divided=divided,
    output:
        labels="results/mesh/{mesh}/parts.seg",
        picture=report(
            "results/mesh/{mesh}/parts.png",
            caption="../report/picture.rst",
            category="Meshes",
            labels={"mesh": "{mesh}", "what": "picture"},
        ),
        answer=report(
            "results/mesh/{mesh}/parts.json",
            caption="../report/parts.rst",
            category="Meshes",
            labels={"mesh": "{mesh}", "what": "parts"},
        ),
    log:
        "results/logs/mesh/{mesh}/cut.log",
    benchmark:
        "results/benchmarks/mesh/{mesh}/cut.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(
            mesh_of(w), row_options(w), ("labels",), attempt
        ),
        runtime=lambda w, attempt: runtime(
            mesh_of(w), row_options(w), ("labels",), attempt
        ),
    params:
        program=PROGRAM,
        memory=config["max_memory"],
        work="results/mesh/{mesh}/work",
        options=cut_options,
    shell:
        "{params.program:q} cluster --work-dir {params.work:q} {params.options} -o {output.labels:q} -o {output.picture:q}"
        " --threads {threads} --max-memory {params.memory:q} --progress lines --json={output.answer:q} 2> {log:q}"


rule efficiency:
    input:
        cut=expand(rules.cut.output.answer, mesh=MESHES),
    output:
        report(
            "results/mesh/efficiency.tsv",
            caption="../report/efficiency.rst",
            category="Meshes",
        ),
    log:
        "results/logs/mesh/efficiency.log",
    conda:
        "../envs/tables.yaml"
    resources:
        mem_mb=500,
        runtime=10,
    params:
        benchmarks="results/benchmarks/mesh",
        jobs={name: jobs(name) for name in MESHES},
        threads=config["threads"],
    script:
        "../scripts/efficiency.py"
