# One large mesh cut by the default recipe over several machines, with `exact: false`: the normals, the contraction, the rows over
# it, and where asked for the two fronts of boundaries, each by shards in a work directory that all of them see.
#
# Each step waits for all shares of the one before. `cut` (mesh.smk) does the rest. `--force`: where the file of a mesh was
# replaced, its work directory is made anew.


rule share_prepare:
    input:
        mesh=mesh_of,
        before=shares_before,
    output:
        "results/mesh/{mesh}/share/{step}/prepared.json",
    log:
        "results/logs/mesh/{mesh}/share/{step}/prepare.log",
    benchmark:
        "results/benchmarks/mesh/{mesh}/share/{step}/prepare.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(
            mesh_of(w), row_options(w), BEFORE_SHARES[w.step], attempt
        ),
        disk_mb=lambda w: disk_mb(mesh_of(w), row_options(w)),
        runtime=lambda w, attempt: runtime(
            mesh_of(w), row_options(w), BEFORE_SHARES[w.step], attempt
        ),
    params:
        program=PROGRAM,
        memory=config["max_memory"],
        work="results/mesh/{mesh}/work",
        options=share_options,
    shell:
        "{params.program:q} share {wildcards.step} {input.mesh:q} --work-dir {params.work:q} --force --prepare {params.options}"
        " --threads {threads} --max-memory {params.memory:q} --progress lines --json={output:q} 2> {log:q}"


rule share:
    input:
        mesh=mesh_of,
        prepared=rules.share_prepare.output,
    output:
        "results/mesh/{mesh}/share/{step}/{i}-of-{of}.json",
    log:
        "results/logs/mesh/{mesh}/share/{step}/{i}-of-{of}.log",
    benchmark:
        "results/benchmarks/mesh/{mesh}/share/{step}/{i}-of-{of}.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(
            mesh_of(w), row_options(w), SHARED[w.step], attempt
        ),
        runtime=lambda w, attempt: runtime(
            mesh_of(w), row_options(w), SHARED[w.step], attempt
        ),
    params:
        program=PROGRAM,
        memory=config["max_memory"],
        work="results/mesh/{mesh}/work",
        options=share_options,
    shell:
        "{params.program:q} share {wildcards.step} {input.mesh:q} --work-dir {params.work:q}"
        " --shard {wildcards.i}/{wildcards.of} {params.options} --threads {threads} --max-memory {params.memory:q}"
        " --progress lines --json={output:q} 2> {log:q}"
